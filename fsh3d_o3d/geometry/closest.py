"""Closest points on a surface in float64."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.rays import UnitScene

_CHUNK = 2**15  # points at a time, so that their triangles stay in the cache


def closest_points(scene: UnitScene, points: Float64Array) -> Float64Array:
    """Return the point (n, 3) closest to each point (n, 3) on the triangle that float32 says is the closest."""
    parts = [points[start : start + _CHUNK] for start in range(0, len(points), _CHUNK)]
    corners = scene.vertices[scene.triangles]
    return np.concatenate([_on_triangle(part, corners[scene.closest(part)]) for part in parts])


def _on_triangle(points: Float64Array, corners: Float64Array) -> Float64Array:
    """Return the closest point (n, 3) of each point's triangle (n, 3, 3)."""
    a, b, c = np.moveaxis(corners - points[:, None], 1, 0)
    best = _on_segment(a, b)
    least = np.einsum("ij,ij->i", best, best)
    for one, other in ((b, c), (c, a)):
        place = _on_segment(one, other)
        square = np.einsum("ij,ij->i", place, place)
        best = np.where((square < least)[:, None], place, best)
        least = np.minimum(square, least)
    normal = np.cross(b - a, c - a)
    length = np.einsum("ij,ij->i", normal, normal)
    inside = length > 0
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(one, other), normal) >= 0
    height = np.einsum("ij,ij->i", a, normal) / np.where(inside, length, 1.0)
    return np.asarray(points + np.where(inside[:, None], height[:, None] * normal, best))


def _on_segment(start: Float64Array, end: Float64Array) -> Float64Array:
    along = end - start
    length = np.einsum("ij,ij->i", along, along)
    place = np.clip(-np.einsum("ij,ij->i", start, along) / np.where(length > 0, length, 1.0), 0, 1)
    return np.asarray(start + place[:, None] * along)
