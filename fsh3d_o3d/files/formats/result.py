"""Geometry from the numbers of a file: what formats have in common once they are parsed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.polygons import cut_polygons
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import RESERVED_NAMES, MeshArrays, PointArrays


@dataclass(frozen=True, eq=False)
class VertexValues:
    """What a file says of its vertices besides where they are.

    A file is read for its surface: what of this is not finite, or has another number of items, is left out with a note.
    """

    normals: Float64Array | None = None
    """(v, 3), or None."""
    colors: Float64Array | None = None
    """(v, 3) in [0, 1], or None."""
    uvs: Float64Array | None = None
    """(v, 2) texture coordinates, or None."""
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """(v,) or (v, k) by name."""

    def usable(self, source: Source, count: int, kept: NDArray[np.bool_] | None) -> VertexValues:
        """Return those of ``count`` vertices that can be used, of the vertices that are kept (None: all)."""

        def checked(name: str, array: Float64Array | None) -> Float64Array | None:
            if array is None or len(array) != count:
                return None
            array = array if kept is None else array[kept]
            if not np.isfinite(array).all():
                source.note(f"{name} of some vertices are not finite; all of them were left out")
                return None
            return array

        named = {
            name: checked(f"'{name}'", array)
            for name, array in self.attributes.items()
            if name.isprintable() and name.strip() and name not in RESERVED_NAMES
        }
        return VertexValues(
            checked("normals", self.normals),
            checked("colours", self.colors),
            checked("texture coordinates", self.uvs),
            {name: array for name, array in named.items() if array is not None},
        )


def mesh_of(
    source: Source,
    vertices: Float64Array,
    triangles: IntArray,
    values: VertexValues | None = None,
    corner_uvs: Float64Array | None = None,
) -> MeshArrays:
    """Return triangles over ``vertices``; vertices that are not finite are left out where no triangle uses them.

    Args:
        source: The file, for notes.
        vertices: (v, 3).
        triangles: (t, 3).
        values: What else it says of its vertices.
        corner_uvs: (t, 3, 2) texture coordinates, where each corner has its own.

    Raises:
        GeometryError: There are no triangles, they are out of range, or use what is not finite.
    """
    finite = _finite_rows(vertices)
    count, kept = len(vertices), None
    in_range = len(triangles) > 0 and triangles.min() >= 0 and triangles.max() < len(vertices)
    if not finite.all() and in_range and finite[triangles].all():
        missing = int(len(finite) - finite.sum())
        source.note(f"{missing} vertices that no face uses are NaN or infinite; they were left out")
        triangles = (np.cumsum(finite) - 1)[triangles]
        vertices, kept = vertices[finite], finite
    if values is None and corner_uvs is None:
        return MeshArrays(vertices, triangles)
    own = (values or VertexValues()).usable(source, count, kept)
    mesh = MeshArrays(vertices, triangles, own.normals, own.colors, attributes=own.attributes)
    if corner_uvs is not None and np.isfinite(corner_uvs).all():
        return replace(mesh, texture_uvs=corner_uvs)
    return mesh if own.uvs is None else replace(mesh, texture_uvs=own.uvs[mesh.triangles])


def polygon_mesh_of(
    source: Source,
    vertices: Float64Array,
    polygons: IntArray,
    starts: IntArray,
    counts: IntArray,
    values: VertexValues | None = None,
    corner_uvs: Float64Array | None = None,
) -> MeshArrays:
    """Return polygons over ``vertices`` as triangles.

    Args:
        source: The file, for notes.
        vertices: (v, 3).
        polygons: (m,) vertex indices, one polygon after another, possibly with other values between them.
        starts: (p,) where each polygon begins in ``polygons``.
        counts: (p,) vertices of each polygon; those of one or two have no area and give no triangle.
        values: What the file says of its vertices besides.
        corner_uvs: (m, 2) texture coordinates of the corners in ``polygons``, where each has its own.

    Raises:
        GeometryError: As for ``mesh_of``.
    """
    triangles = cut_polygons(source, vertices, polygons, starts, counts)
    uvs = None
    if corner_uvs is not None and len(triangles):
        uvs = corner_uvs[_corners_in_polygons(triangles, polygons, starts, counts)]
    return mesh_of(source, vertices, triangles, values, uvs)


def _corners_in_polygons(triangles: IntArray, polygons: IntArray, starts: IntArray, counts: IntArray) -> IntArray:
    """Return where (t, 3) in ``polygons`` the corners of the triangles stand that they were cut into, in order."""
    whole = counts >= 3  # each of k corners gives k − 2 triangles
    starts, counts = starts[whole], counts[whole]
    places = np.repeat(starts - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    polygon = np.repeat(np.arange(len(counts)), counts)
    size = int(max(polygons[places].max(), triangles.max())) + 1
    key = polygon * size + polygons[places]
    order = np.argsort(key, kind="stable")
    owner = np.repeat(np.arange(len(counts)), counts - 2)
    found = np.searchsorted(key[order], owner[:, None] * size + triangles)
    return cast(IntArray, places[order[np.minimum(found, len(order) - 1)]])


def cloud_of(
    source: Source,
    points: Float64Array,
    normals: Float64Array | None = None,
    colors: Float64Array | None = None,
    attributes: Mapping[str, Float64Array] | None = None,
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
    named = VertexValues(attributes=attributes or {}).usable(source, len(finite), finite if finite.any() else None)
    return PointArrays(points, normals, colors, named.attributes)


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
