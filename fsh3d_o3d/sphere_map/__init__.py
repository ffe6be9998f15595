"""Sphere maps of closed surfaces of genus 0: conformal, or balanced between angles and areas."""

from __future__ import annotations

from fsh3d_o3d.sphere_map.conformal_map import ConformalMapOption, conformal_map
from fsh3d_o3d.sphere_map.diagnosis import mapping_obstacles
from fsh3d_o3d.sphere_map.point_location import locate
from fsh3d_o3d.sphere_map.spherical_map import MapMethod, SphericalMap

__all__ = [
    "ConformalMapOption",
    "MapMethod",
    "SphericalMap",
    "conformal_map",
    "locate",
    "mapping_obstacles",
]
