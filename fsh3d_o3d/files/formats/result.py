"""Geometry from the numbers of a file: what formats have in common once they are parsed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.polygons import cut_polygons
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import MeshArrays, PointArrays


def mesh_of(source: Source, vertices: Float64Array, triangles: IntArray) -> MeshArrays:
    """Return triangles over ``vertices``; vertices that are not finite are left out where no triangle uses them.

    Raises:
        GeometryError: There are no triangles, they are out of range, or use what is not finite.
    """
    finite = _finite_rows(vertices)
    in_range = len(triangles) > 0 and triangles.min() >= 0 and triangles.max() < len(vertices)
    if not finite.all() and in_range and finite[triangles].all():
        missing = int(len(finite) - finite.sum())
        source.note(f"{missing} vertices that no face uses are NaN or infinite; they were left out")
        triangles = (np.cumsum(finite) - 1)[triangles]
        vertices = vertices[finite]
    return MeshArrays(vertices, triangles)


def polygon_mesh_of(
    source: Source, vertices: Float64Array, polygons: IntArray, starts: IntArray, counts: IntArray
) -> MeshArrays:
    """Return polygons over ``vertices`` as triangles.

    Args:
        source: The file, for notes.
        vertices: (v, 3).
        polygons: (m,) vertex indices, one polygon after another, possibly with other values between them.
        starts: (p,) where each polygon begins in ``polygons``.
        counts: (p,) vertices of each polygon; those of one or two have no area and give no triangle.

    Raises:
        GeometryError: As for ``mesh_of``.
    """
    return mesh_of(source, vertices, cut_polygons(source, vertices, polygons, starts, counts))


def cloud_of(
    source: Source, points: Float64Array, normals: Float64Array | None = None, colors: Float64Array | None = None
) -> PointArrays:
    """Return a cloud without the points that are NaN, PCL's mark for what was not seen, or infinite.

    Raises:
        GeometryError: No point is left.
    """
    finite = _finite_rows(points)
    if not finite.all() and finite.any():
        source.note(f"{len(finite) - finite.sum()} of {len(finite)} points are NaN or infinite; they were left out")
        points = points[finite]
        normals = None if normals is None else normals[finite]
        colors = None if colors is None else colors[finite]
    return PointArrays(points, normals, colors)


def welded(corners: Float64Array) -> tuple[Float64Array, IntArray]:
    """Return loose triangles (3 t, 3) as vertices and triangles: corners are one where equal to the last bit.

    Raises:
        GeometryReadError: There are none.
    """
    if not len(corners):
        raise GeometryReadError("the file holds 0 triangles")
    # Adding 0 turns −0 into +0; then equal numbers have equal bytes, and one comparison sorts a whole corner.
    bits = np.ascontiguousarray(corners + 0.0)
    keys = bits.view(np.dtype((np.void, bits.dtype.itemsize * 3))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)  # vertices in the order of the file, not of their bytes
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners[first[order]], rank[inverse.ravel()].reshape(-1, 3)


def _finite_rows(points: Float64Array) -> NDArray[np.bool_]:
    return np.isfinite(points[:, 0]) & np.isfinite(points[:, 1]) & np.isfinite(points[:, 2])
