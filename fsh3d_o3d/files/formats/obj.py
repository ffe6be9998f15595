"""Wavefront OBJ: vertices and polygons, or points alone; everything else in it is passed over."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.obj_keywords import known_keywords
from fsh3d_o3d.files.formats.result import cloud_of, polygon_mesh_of
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
    if b"/" in text:
        if re.search(rb"(?m)^[ \t]*[fF]\b.*[ \t]/", text):
            raise GeometryReadError("a face corner begins with a slash: its vertex index is missing")
        text = re.sub(rb"/[^\s]*", b"", text)  # 3/7/2: vertex, texture coordinate, normal
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
    corners = indices(faces.values, "vertex indices")
    if (corners == 0).any():
        raise GeometryReadError("a face names vertex 0, but OBJ counts from 1")
    seen = np.repeat(np.cumsum(is_vertex)[is_face], faces.counts)
    corners = np.where(corners > 0, corners - 1, seen + corners)
    _check_sizes(source, text, faces.counts, last=bool(is_face[-1]))
    return polygon_mesh_of(source, vertices, corners, faces.starts, faces.counts)


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
