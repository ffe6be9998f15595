"""Polygons into triangles (private)."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError


def cut_polygons(vertices: Float64Array, polygons: IntArray, starts: IntArray, counts: IntArray) -> IntArray:
    """Cut polygons into fans around their first vertex, keeping their sense of rotation.

    Args:
        vertices: (v, 3) positions.
        polygons: (m,) vertex indices, one polygon after another, possibly with other values between them.
        starts: (p,) where each polygon begins in ``polygons``.
        counts: (p,) vertices of each polygon; those of one or two have no area and give no triangle.

    Returns:
        (Σ max(0, counts − 2), 3) triangles in the order of the polygons.
    """
    if len(counts) and counts.min() < 1:
        raise GeometryReadError(f"a face with {counts.min()} vertices")
    fans = np.maximum(counts - 2, 0)
    corner = np.repeat(starts, fans)
    step = np.arange(len(corner)) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack([polygons[corner], polygons[corner + step + 1], polygons[corner + step + 2]], axis=1)
