"""Geometries turned, moved, scaled and mirrored."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays


def transformed(geometry: MeshArrays | PointArrays, transformation: Float64Array) -> MeshArrays | PointArrays:
    """Return a geometry under a similarity (4, 4); normals turn with it, and a mirrored mesh still faces outward."""
    linear, shift = transformation[:3, :3], transformation[:3, 3]
    determinant = float(np.linalg.det(linear))
    if isinstance(geometry, MeshArrays):
        triangles = geometry.triangles[:, ::-1] if determinant < 0 else geometry.triangles
        return MeshArrays(geometry.vertices @ linear.T + shift, triangles)
    turned = None if geometry.normals is None else geometry.normals @ (linear / np.cbrt(abs(determinant))).T
    return PointArrays(geometry.points @ linear.T + shift, turned, geometry.colors)
