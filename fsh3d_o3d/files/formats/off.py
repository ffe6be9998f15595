"""Object File Format of Geomview: text and binary, with normals, colours and texture coordinates.

The format is a stream of numbers, but only the end of the line tells where the colour of a face ends. So files are read
line by line where they have one vertex or face on each, as nearly all do, and as a stream where they do not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.off_binary import read_binary_off
from fsh3d_o3d.files.formats.off_vertices import OffVertices
from fsh3d_o3d.files.formats.result import polygon_mesh_of
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.text import TextLines, indices, without_comments
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_KEYWORD = re.compile(rb"\s*((?:ST|[CN4n])*)OFF(?![A-Za-z])")
_BINARY = re.compile(rb"(?:\s|#[^\n]*\n)*((?:ST|[CN4n])*)OFF[ \t]+BINARY[^\n]*\n")
_DIMENSION = re.compile(rb"\s*(\d{1,9})(?=\s)")
# The counts may follow the keyword at once, as in ``OFF8 6 12`` (Princeton Shape Benchmark); edges may be left out.
_COUNTS = re.compile(rb"\s*(\d{1,18})[ \t]+(\d{1,18})(?:[ \t]+\d+)?[ \t]*(?=[\r\n]|$)")
_COUNTS_ON_SEVERAL_LINES = re.compile(rb"\s*(\d{1,18})\s+(\d{1,18})\s+\d+(?=\s|$)")
_THREE_COUNTS = re.compile(rb"\s*(\d{1,18})[ \t]+(\d{1,18})[ \t]+\d+[ \t]*(?=[\r\n])")


@dataclass(frozen=True, eq=False)
class _Faces:
    """Polygons, possibly with other values between them."""

    values: IntArray
    """(m,) vertex indices."""
    starts: IntArray
    """(f,) where each face begins in ``values``."""
    sizes: IntArray
    """(f,) number of its vertices."""


def parse_off(source: Source) -> MeshArrays | PointArrays:
    """Return an OFF file as a mesh, or as a point cloud where it announces no faces.

    Colours of faces are passed over.
    """
    binary = _BINARY.match(source.data)
    if binary is not None:
        return read_binary_off(source, binary[1].decode("ascii"), binary.end())
    text = without_comments(source.data)
    keyword = _KEYWORD.match(text)
    if keyword is None and _THREE_COUNTS.match(text) is None:
        raise GeometryReadError("does not begin with OFF")
    prefix, end = ("", 0) if keyword is None else (keyword[1].decode("ascii"), keyword.end())
    if "n" in prefix:
        dimension = _DIMENSION.match(text, end)
        if dimension is None:
            raise GeometryReadError("the number of dimensions is missing behind nOFF")
        OffVertices.check_dimension(int(dimension[1]))
        end = dimension.end()
    counts = _COUNTS.match(text, end) or _COUNTS_ON_SEVERAL_LINES.match(text, end)
    if counts is None:
        raise GeometryReadError("the numbers of vertices and faces are missing behind OFF")
    vertex_count, face_count = int(counts[1]), int(counts[2])
    if vertex_count == 0:
        raise GeometryReadError(f"no surface: the header announces 0 vertices and {face_count} faces")
    lines = TextLines.of(text[counts.end() :])
    try:
        table, faces = _line_by_line(lines, vertex_count, face_count)
    except GeometryReadError:
        stream = _as_a_stream(OffVertices.widths(prefix), lines, vertex_count, face_count)
        if stream is None and keyword is None:
            raise GeometryReadError("does not begin with OFF") from None
        if stream is None:
            raise
        table, faces = stream
        source.note("vertices and faces are not one on each line")
    if keyword is None:
        source.note("the keyword OFF is missing at the beginning")
    vertices = OffVertices.of(source, prefix, table)
    if faces is None:
        return vertices.cloud(source)
    return polygon_mesh_of(source, vertices.positions, faces.values, faces.starts, faces.sizes, vertices.values)


def _line_by_line(lines: TextLines, vertices: int, faces: int) -> tuple[Float64Array, _Faces | None]:
    if len(lines) != vertices + faces:
        raise GeometryReadError(
            f"the header announces {vertices} vertices and {faces} faces, one on each line, "
            f"but {len(lines)} lines follow"
        )
    return lines.span(0, vertices).columns("vertex", minimum=3), _faces_on_lines(lines, faces) if faces else None


def _faces_on_lines(lines: TextLines, count: int) -> _Faces:
    """Return the faces on the last ``count`` lines."""
    faces = lines.span(len(lines) - count, len(lines))
    starts = faces.starts
    sizes = indices(faces.values[starts], "vertex counts of faces")
    short = np.flatnonzero(faces.counts < sizes + 1)
    if len(short):
        raise GeometryReadError(
            f"face {short[0]} announces {sizes[short[0]]} vertices but has {faces.counts[short[0]] - 1}"
        )
    values = faces.values
    if (faces.counts != sizes + 1).any():
        # Behind its vertices a face may name its colour, as fractions too: only what is an index has to be whole.
        position = np.arange(len(values)) - np.repeat(starts, faces.counts)
        values = np.where(position <= np.repeat(sizes, faces.counts), values, 0)
    return _Faces(indices(values, "vertex indices"), starts + 1, sizes)


def _as_a_stream(
    widths: tuple[int, ...], lines: TextLines, vertices: int, faces: int
) -> tuple[Float64Array, _Faces | None] | None:
    """Return vertices and faces wherever the lines end; None where the numbers are not exactly those announced.

    Faces that have colours must still end with their lines.
    """
    values = lines.span(0, len(lines)).values
    for width in widths:
        stop = vertices * width
        if stop > len(values):
            continue
        if not faces:
            if stop == len(values):
                return values.reshape(-1, width), None
            continue
        table = values[:stop].reshape(-1, width)
        stream = _chained_faces(values[stop:], faces, vertices)
        if stream is not None:
            return table, stream
        if len(lines) > faces and lines.counts[:-faces].sum() == stop:
            return table, _faces_on_lines(lines, faces)
    return None


def _chained_faces(values: Float64Array, count: int, vertices: int) -> _Faces | None:
    """Return faces without colours: each begins where the one before it ends, and the last one ends the file."""
    if 2 * count > len(values):
        return None
    whole = (values == np.rint(values)) & (values >= 0) & (values < max(vertices, len(values)))
    if not whole.all():
        return None
    flat = values.astype(np.int64)
    sizes = flat.tolist()
    starts = np.empty(count, dtype=np.int64)
    at = 0
    for face in range(count):  # a chain can only be followed
        if at >= len(sizes) or sizes[at] < 1:
            return None
        starts[face] = at
        at += sizes[at] + 1
    if at != len(sizes):
        return None
    return _Faces(flat, starts + 1, flat[starts])
