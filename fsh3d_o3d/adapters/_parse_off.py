"""Object File Format (private): OFF, COFF, NOFF, STOFF and their mixtures, as text."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d.adapters._parse_result import polygon_mesh_of
from fsh3d_o3d.adapters._parse_text import TextLines, indices, without_comments
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import MeshArrays
from fsh3d_o3d.errors import GeometryReadError

# The counts may follow the keyword at once, as in ``OFF8 6 12`` (Princeton Shape Benchmark); edges may be left out.
_HEADER = re.compile(rb"\s*(ST)?C?N?OFF\s*(\d{1,18})[ \t]+(\d{1,18})(?:[ \t]+\d+)?[ \t]*(?=[\r\n]|$)")
_KEYWORD = re.compile(rb"\s*(ST)?C?N?(4)?(n)?OFF")


def parse_off(source: Source) -> MeshArrays:
    """Return an OFF file as a mesh; vertex and face colours, normals and texture coordinates are passed over."""
    text = without_comments(source.data)
    header = _HEADER.match(text)
    if header is None:
        raise GeometryReadError(_header_reason(text))
    vertex_count, face_count = int(header[2]), int(header[3])
    if vertex_count == 0 or face_count == 0:
        raise GeometryReadError(f"no surface: the header announces {vertex_count} vertices and {face_count} faces")
    lines = TextLines.of(text[header.end() :])
    if len(lines) != vertex_count + face_count:
        raise GeometryReadError(
            f"the header announces {vertex_count} vertices and {face_count} faces, one on each line, "
            f"but {len(lines)} lines follow"
        )
    vertices = lines.span(0, vertex_count).columns("vertex", minimum=3)[:, :3]
    faces = lines.span(vertex_count, len(lines))
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
    return polygon_mesh_of(source, vertices, indices(values, "vertex indices"), starts + 1, sizes)


def _header_reason(text: bytes) -> str:
    keyword = _KEYWORD.match(text)
    if keyword is None:
        return "does not begin with OFF"
    if keyword[2] or keyword[3]:
        return "OFF in four or n dimensions is not read"
    if re.match(rb"\s*BINARY", text[keyword.end() :]):
        return "binary OFF is not read"
    return "the numbers of vertices and faces are missing behind OFF"
