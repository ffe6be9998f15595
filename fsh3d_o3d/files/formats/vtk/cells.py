"""Cells of VTK into triangles: polygons, strips, and the faces of volumes that only one cell has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import cloud_of, polygon_mesh_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.geometry import MeshArrays, PointArrays

TRIANGLE, STRIP, POLYGON, PIXEL, QUAD = 5, 6, 7, 8, 9
"""Numbers of kinds of flat cells, of VTK."""
_SMALL = (0, 1, 2, 3, 4)  # nothing, points and lines
_PIXEL_ORDER, _VOXEL_ORDER = [0, 1, 3, 2], [0, 1, 3, 2, 4, 5, 7, 6]  # rows of corners, brought into turning order
# Faces of solid cells, each turning left seen from outside: tetrahedron, voxel, hexahedron, wedge, pyramid.
_BOX_FACES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
_FACES: Mapping[int, tuple[tuple[int, ...], ...]] = {
    10: ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1)),
    11: _BOX_FACES,
    12: _BOX_FACES,
    13: ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    14: ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
_CORNERS = {TRIANGLE: 3, PIXEL: 4, QUAD: 4, 10: 4, 11: 8, 12: 8, 13: 6, 14: 5}
# Cells with further nodes on their sides, and the cell that their corners, which come first, are.
_STRAIGHT = {22: TRIANGLE, 23: QUAD, 28: QUAD, 34: TRIANGLE, 24: 10, 25: 12, 29: 12, 26: 13, 27: 14}

_MOST_VALUES = 256  # arrays, a choice: results of simulations have some ten
_LONGEST_NAME = 60  # characters, a choice
_TAKEN = ("positions", "normals", "colors", "indices", "texture_uvs")  # that a geometry has fields for


@dataclass(frozen=True)
class Cells:
    """Cells one behind the other."""

    kinds: IntArray
    """(c,) numbers of their kinds."""
    corners: IntArray
    """(m,) indices of points, cell after cell."""
    counts: IntArray
    """(c,) how many each has."""

    @property
    def starts(self) -> IntArray:
        """(c,) where each begins."""
        return np.asarray(np.cumsum(self.counts) - self.counts)


@dataclass(frozen=True)
class PointValues:
    """What belongs to points."""

    normals: Float64Array | None = None
    colors: Float64Array | None = None
    others: Mapping[str, Float64Array] = field(default_factory=dict)


def geometry_of(source: Source, points: Float64Array, cells: Cells, values: PointValues) -> MeshArrays | PointArrays:
    """Return the surface of all cells with what belongs to its points; a cloud where there are only points.

    Raises:
        GeometryReadError: The cells are damaged, or only lines.
    """
    if len(cells.corners) and (cells.corners.min() < 0 or cells.corners.max() >= len(points)):
        raise GeometryReadError(
            f"damaged: cells refer to points {cells.corners.min()} … {cells.corners.max()}, "
            f"but there are points 0 … {len(points) - 1}"
        )
    kinds = np.array([_STRAIGHT.get(int(kind), int(kind)) for kind in np.unique(cells.kinds)])
    if (kinds != np.unique(cells.kinds)).any():
        source.note("nodes on the sides of curved cells passed over: they are taken to be straight")
    solid = [kind for kind in _FACES if kind in kinds]
    flat = [kind for kind in (TRIANGLE, STRIP, POLYGON, PIXEL, QUAD) if kind in kinds]
    unknown = sorted({*kinds.tolist()} - {*solid, *flat, *_SMALL})
    if unknown:
        raise GeometryReadError(f"its cells are of kind {unknown[0]}, which is not read")
    if not solid and not flat:
        if len(cells.kinds) and (cells.kinds > 2).any():
            raise GeometryReadError("no surface, only lines")
        cloud = cloud_of(source, points, values.normals, values.colors)
        return replace(cloud, attributes=values.others) if len(cloud.points) == len(points) else cloud
    if solid and flat:
        source.note("flat cells beside solid ones passed over: the surface is that of the solid ones")
    polygons = _boundary(cells, solid) if solid else _polygons(cells, flat)
    mesh = polygon_mesh_of(source, points, polygons.corners, polygons.starts, polygons.counts)
    if len(mesh.vertices) == len(points):  # else some are not finite, and were left out
        mesh = replace(mesh, normals=values.normals, colors=values.colors, attributes=values.others)
    return mesh.compact()[0] if not mesh.used.all() else mesh


def _chosen(cells: Cells, kind: int) -> IntArray:
    """Return the corners of all cells of a kind, (n, k); of curved ones those that come first."""
    same = [kind, *(curved for curved, straight in _STRAIGHT.items() if straight == kind)]
    width = _CORNERS[kind]
    rows = np.flatnonzero(np.isin(cells.kinds, same))
    if (cells.counts[rows] < width).any() or (cells.counts[rows][cells.kinds[rows] == kind] != width).any():
        raise GeometryReadError(f"damaged: cells of kind {kind} should have {width} corners")
    return np.asarray(cells.corners[cells.starts[rows][:, None] + np.arange(width)])


def _polygons(cells: Cells, kinds: list[int]) -> Cells:
    """Return flat cells as polygons, kind after kind."""
    lists: list[tuple[IntArray, IntArray]] = []
    for kind in kinds:
        if kind == STRIP:
            triangles = _strips(cells)
            lists.append((triangles.ravel(), np.full(len(triangles), 3)))
        elif kind == POLYGON:
            rows = cells.kinds == POLYGON
            lists.append((cells.corners[np.repeat(rows, cells.counts)], cells.counts[rows]))
        else:
            corners = _chosen(cells, kind)
            corners = corners[:, _PIXEL_ORDER] if kind == PIXEL else corners
            lists.append((corners.ravel(), np.full(len(corners), corners.shape[1])))
    corners, counts = (np.concatenate(arrays) for arrays in zip(*lists, strict=True))
    return Cells(np.full(len(counts), POLYGON), corners, counts)


def _strips(cells: Cells) -> IntArray:
    """Return triangles: each corner of a strip from the third on makes one with the two before, turned in turn."""
    rows = np.flatnonzero((cells.kinds == STRIP) & (cells.counts >= 3))
    each = cells.counts[rows] - 2
    within = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    first = np.repeat(cells.starts[rows], each) + within
    odd = within % 2
    return np.asarray(cells.corners[np.stack([first + odd, first + 1 - odd, first + 2], axis=1)])


def _boundary(cells: Cells, kinds: list[int]) -> Cells:
    """Return the faces of solid cells that no other one shares."""
    faces = []
    for kind in kinds:
        corners = _chosen(cells, kind)
        corners = corners[:, _VOXEL_ORDER] if kind == 11 else corners
        for face in _FACES[kind]:
            padded = np.full((len(corners), 4), -1, dtype=np.int64)
            padded[:, : len(face)] = corners[:, face]
            faces.append(padded)
    table = np.concatenate(faces)
    _, first, shared = np.unique(np.sort(table, axis=1), axis=0, return_index=True, return_counts=True)
    outer: IntArray = table[np.sort(first[shared == 1])]
    if not len(outer):
        raise GeometryReadError("damaged: every face of its solid cells is shared")
    filled: NDArray[np.bool_] = outer >= 0
    return Cells(np.full(len(outer), POLYGON), outer[filled], filled.sum(axis=1))


def named_values(source: Source, arrays: Mapping[str, NDArray[np.generic]], count: int) -> PointValues:
    """Return normals, colours and other values by the names that programs give them, where each point has one."""
    normals = colors = None
    others: dict[str, Float64Array] = {}
    passed = 0
    for name, array in arrays.items():
        values = array.astype(np.float64)
        if len(array) != count or array.ndim > 2 or not np.isfinite(values).all():
            passed += 1
        elif name.lower() in ("normals", "normal") and values.shape == (count, 3):
            normals = values
        elif _is_color(name, array):
            colors = values[:, :3] / (255 if array.dtype.itemsize == 1 else 1)
        elif name and len(others) < _MOST_VALUES:
            others[_free_name(name, others)] = values
        else:
            passed += 1
    if passed:
        source.note(f"{counted(passed, 'array')} of values at the points passed over")
    return PointValues(normals, colors, others)


def _free_name(name: str, others: Mapping[str, Float64Array]) -> str:
    free = name[:_LONGEST_NAME]
    while free in others or free in _TAKEN:
        free += "_"
    return free


def _is_color(name: str, array: NDArray[np.generic]) -> bool:
    """Whether values are colours: by their name, three or four in each row, bytes or fractions."""
    if array.ndim != 2 or array.shape[1] not in (3, 4):
        return False
    if name.lower().strip("_") not in ("rgb", "rgba", "color", "colors", "colour", "colours"):
        return False
    if array.dtype.kind == "u" and array.dtype.itemsize == 1:
        return True
    numbers = array.astype(np.float64)
    return array.dtype.kind == "f" and bool(((numbers >= 0) & (numbers <= 1)).all())
