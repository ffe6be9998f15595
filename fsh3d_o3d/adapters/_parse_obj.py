"""Wavefront OBJ (private): vertices and polygons; everything else in it is passed over."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d.adapters._parse_result import polygon_mesh_of
from fsh3d_o3d.adapters._parse_text import TextLines, indices, text_reason, without_comments
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import MeshArrays
from fsh3d_o3d.errors import GeometryReadError

# All statements of the format: an unknown keyword is damage, and a vertex lost to it would shift every later index.
_KEYWORDS = (
    "v vt vn vp f fo l p g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj ctech "
    "stech deg bmat step cstype curv curv2 surf parm trim hole scrv sp end con call csh"
)
_KNOWN = np.array(_KEYWORDS.encode().split(), dtype="S12")


def parse_obj(source: Source) -> MeshArrays:
    """Return an OBJ file as a mesh; polygons are cut into triangles, negative indices count back from their line."""
    text = without_comments(source.data)
    if b"\\" in text:
        text = re.sub(rb"\\[ \t]*\r?\n", b" ", text)
    if b"/" in text:
        if re.search(rb"(?m)^[ \t]*f\b.*[ \t]/", text):
            raise GeometryReadError("a face corner begins with a slash: its vertex index is missing")
        text = re.sub(rb"/[^\s]*", b"", text)  # 3/7/2: vertex, texture coordinate, normal
    lines = TextLines.of(text)
    if not len(lines):
        raise GeometryReadError("no vertices")
    keywords = lines.keywords()
    unknown = np.flatnonzero(~np.isin(keywords, _KNOWN))
    if len(unknown):
        raise GeometryReadError(f"{text_reason(bytes(keywords[unknown[0]]))} is not a keyword of OBJ")
    is_vertex = keywords == b"v"
    is_face = (keywords == b"f") | (keywords == b"fo")
    if not is_vertex.any() or not is_face.any():
        raise GeometryReadError(f"no surface: {is_vertex.sum()} vertices and {is_face.sum()} faces")
    rows = lines.select(is_vertex, skip=1)
    if rows.counts.min() < 3:
        raise GeometryReadError(f"vertex {int(rows.counts.argmin())} has {rows.counts.min()} coordinates")
    vertices = rows.values[rows.starts[:, None] + np.arange(3)]  # a weight or a colour may follow

    faces = lines.select(is_face, skip=1)
    corners = indices(faces.values, "vertex indices")
    if (corners == 0).any():
        raise GeometryReadError("a face names vertex 0, but OBJ counts from 1")
    seen = np.repeat(np.cumsum(is_vertex)[is_face], faces.counts)
    corners = np.where(corners > 0, corners - 1, seen + corners)
    if faces.counts.min() < 3:
        raise GeometryReadError(f"face {int(faces.counts.argmin())} has {faces.counts.min()} vertices")
    return polygon_mesh_of(source, vertices, corners, faces.starts, faces.counts)
