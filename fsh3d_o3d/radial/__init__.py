"""Radial functions of meshes and clouds: rays, the test for star-shaped surfaces, centres, robust fits."""

from __future__ import annotations

from fsh3d_o3d.radial.cloud import cloud_center, fit_radial_cloud, usable_bandwidth
from fsh3d_o3d.radial.mesh import ACCEPTED_DIRECTIONS, HIDDEN_AREA, Behaviour, sample_radial
from fsh3d_o3d.radial.one_sided import fit_one_sided
from fsh3d_o3d.radial.star import StarReport, star_center

__all__ = [
    "ACCEPTED_DIRECTIONS",
    "Behaviour",
    "HIDDEN_AREA",
    "StarReport",
    "cloud_center",
    "fit_one_sided",
    "fit_radial_cloud",
    "sample_radial",
    "star_center",
    "usable_bandwidth",
]
