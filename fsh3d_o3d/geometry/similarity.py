"""Geometries turned, moved, scaled and mirrored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays, turned_over


def transformed(geometry: MeshArrays | PointArrays, transformation: Float64Array) -> MeshArrays | PointArrays:
    """Return a geometry under a similarity (4, 4); normals turn with it, and a mirrored mesh still faces outward."""
    linear, shift = transformation[:3, :3], transformation[:3, 3]
    determinant = float(np.linalg.det(linear))
    turned = None if geometry.normals is None else geometry.normals @ (linear / np.cbrt(abs(determinant))).T
    if isinstance(geometry, PointArrays):
        return replace(geometry, points=geometry.points @ linear.T + shift, normals=turned)
    moved = replace(geometry, vertices=geometry.vertices @ linear.T + shift, normals=turned)
    return turned_over(moved, np.full(len(moved.triangles), fill_value=True)) if determinant < 0 else moved
