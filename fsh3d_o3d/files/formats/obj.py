"""Wavefront OBJ: vertices and polygons, or points alone; everything else in it is passed over."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.obj_keywords import known_keywords
from fsh3d_o3d.files.formats.result import VertexValues, cloud_of, polygon_mesh_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import NumberRows, TextLines, indices, without_comments
from fsh3d_o3d.geometry import MeshArrays, PointArrays


def parse_obj(source: Source) -> MeshArrays | PointArrays:
    """Return an OBJ file as a mesh, or as a point cloud where it has vertices alone.

    Polygons are cut into triangles, negative indices count back from their line.
    """
    text = without_comments(source.data)
    if b"\\" in text:
        text = re.sub(rb"\\[ \t]*\r?\n", b" ", text)
    width = 1
    if b"/" in text:
        if re.search(rb"(?m)^[ \t]*[fF]\b.*[ \t]/", text):
            raise GeometryReadError("a face corner begins with a slash: its vertex index is missing")
        width = _numbers_of_a_corner(text)
        text = text.replace(b"//", b"/0/").replace(b"/", b" ") if width > 1 else re.sub(rb"/[^\s]*", b"", text)
    lines = TextLines.of(text)
    if not len(lines):
        raise GeometryReadError("no vertices")
    keywords = known_keywords(source, lines)
    is_vertex = keywords == b"v"
    is_face = (keywords == b"f") | (keywords == b"fo")
    if not is_vertex.any():
        raise GeometryReadError(f"no surface: 0 vertices and {is_face.sum()} faces")
    rows = lines.select(is_vertex, skip=1)
    if rows.counts.min() < 3:
        raise GeometryReadError(f"vertex {int(rows.counts.argmin())} has {rows.counts.min()} coordinates")
    vertices = rows.values[rows.starts[:, None] + np.arange(3)]  # a weight or a colour may follow
    if not is_face.any():
        _refuse_other_elements(keywords, len(vertices))
        if not (keywords == b"p").any():
            source.note(
                f"there are no faces: the {counted(len(vertices), 'vertex', 'vertices')} are read as a point cloud"
            )
        return cloud_of(source, vertices, _normals(lines, keywords, len(vertices)), _colors(rows))

    faces = lines.select(is_face, skip=1)
    named = indices(faces.values, "vertex indices").reshape(-1, width)
    starts, counts = faces.starts // width, faces.counts // width
    if (named[:, 0] == 0).any():
        raise GeometryReadError("a face names vertex 0, but OBJ counts from 1")

    def counted_from_zero(column: int, keyword: bytes) -> IntArray:
        seen = np.repeat(np.cumsum(keywords == keyword)[is_face], counts)
        return np.where(named[:, column] > 0, named[:, column] - 1, seen + named[:, column])

    corners = counted_from_zero(0, b"v")
    _check_sizes(source, text, counts, last=bool(is_face[-1]))
    uvs = normals = None
    if width > 1 and (named[:, 1] != 0).all():
        uvs = _at_corners(source, lines, keywords, b"vt", 2, counted_from_zero(1, b"vt"))
    if width > 2:
        at_corners = _at_corners(source, lines, keywords, b"vn", 3, counted_from_zero(2, b"vn"))
        normals = None if at_corners is None else _at_vertices(at_corners, corners, len(vertices))
    values = VertexValues(normals, _colors(rows))
    return polygon_mesh_of(source, vertices, corners, starts, counts, values, uvs)


def _numbers_of_a_corner(text: bytes) -> int:
    """Return 3 where all corners are like 3/7/2 (vertex, texture coordinate, normal) or 3//2, 2 where like 3/7.

    Otherwise 1: only their vertices are read.
    """
    for width, corner in ((3, rb"-?\d+/-?\d*/-?\d+"), (2, rb"-?\d+/-?\d+")):
        others = rb"(?m)^[ \t]*[fF][oO]?(?=[ \t])(?!(?:[ \t]+" + corner + rb")+[ \t\r]*$)"
        if re.search(others, text) is None:
            return width
    return 1


def _at_corners(
    source: Source, lines: TextLines, keywords: NDArray[np.bytes_], keyword: bytes, width: int, index: IntArray
) -> Float64Array | None:
    """Return what corners (m,) name of the statements ``vt`` or ``vn``, (m, width); None where some are not there."""
    rows = lines.select(keywords == keyword, skip=1)
    if not len(rows.counts):
        return None
    if rows.counts.min() < width or index.min() < 0 or index.max() >= len(rows.counts):
        what = "texture coordinates" if keyword == b"vt" else "normals"
        source.note(f"faces name {what} that the file does not have; all of them were left out")
        return None
    return np.asarray(rows.values[rows.starts[:, None] + np.arange(width)][index], dtype=np.float64)


def _at_vertices(at_corners: Float64Array, corners: IntArray, count: int) -> Float64Array | None:
    """Return normals (v, 3) from those of corners (m, 3): the mean where a vertex has several, at a crease."""
    if corners.min() < 0 or corners.max() >= count:
        return None  # an error further on
    normals = np.zeros((count, 3))
    normals[corners] = at_corners
    if not (normals[corners] == at_corners).all():
        sums = [np.bincount(corners, weights=at_corners[:, axis], minlength=count) for axis in range(3)]
        normals = np.stack(sums, axis=1)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    return normals


def _check_sizes(source: Source, text: bytes, counts: IntArray, *, last: bool) -> None:
    """Pass over faces of one or two vertices, but not where the file breaks off in one."""
    if counts.min() >= 3:
        return
    if last and counts[-1] < 3 and not text.rstrip(b" \t").endswith((b"\n", b"\r")):
        raise GeometryReadError(f"truncated: the last face has {counted(counts[-1], 'vertex', 'vertices')}")
    if counts.max() < 3:
        raise GeometryReadError(f"no surface: the faces have {counts.max()} vertices or fewer")
    source.note(f"{counted((counts < 3).sum(), 'face')} of one or two vertices passed over")


def _refuse_other_elements(keywords: NDArray[np.bytes_], vertices: int) -> None:
    """Raise where vertices without faces are not points, but belong to something else."""
    for found, what in (
        (b"l", "only lines"),
        (b"curv", "only free-form curves, which are not read"),
        (b"curv2", "only free-form curves, which are not read"),
        (b"surf", "only free-form surfaces, which are not read"),
        (b"vt", "truncated before its faces"),
    ):
        number = int((keywords == found).sum())
        if number:
            raise GeometryReadError(
                f"no surface, {what}: {counted(vertices, 'vertex', 'vertices')}, "
                f"{counted(number, 'statement')} '{found.decode('ascii')}' and 0 faces"
            )


def _normals(lines: TextLines, keywords: NDArray[np.bytes_], vertices: int) -> Float64Array | None:
    """Return the normals of points: only where there is one for each, in the same order."""
    is_normal = keywords == b"vn"
    if is_normal.sum() != vertices:
        return None
    rows = lines.select(is_normal, skip=1)
    return rows.values.reshape(-1, 3) if (rows.counts == 3).all() and np.isfinite(rows.values).all() else None


def _colors(rows: NumberRows) -> Float64Array | None:
    """Return the colours behind coordinates: only where each point has three fractions, or three integers to 255."""
    if (rows.counts != 6).any():
        return None
    colors = rows.values.reshape(-1, 6)[:, 3:]
    if not (colors.min() >= 0 and colors.max() <= 255):
        return None
    if colors.max() <= 1:
        return colors
    return colors / 255 if (colors == np.rint(colors)).all() else None
