"""Closest points on a surface in float64."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.rays import UnitScene
from fsh3d_o3d.geometry.triangles import point_triangle_offsets

_CHUNK = 2**15  # points at a time, a choice, so that their triangles stay in the cache


def closest_points(scene: UnitScene, points: Float64Array) -> Float64Array:
    """Return the point (n, 3) closest to each point (n, 3) of the surface of a scene."""
    parts = [points[start : start + _CHUNK] for start in range(0, len(points), _CHUNK)]
    return np.concatenate([part + point_triangle_offsets(part, scene.corners[scene.closest(part)]) for part in parts])
