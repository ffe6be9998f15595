"""STEP and IGES: exact surfaces of CAD, cut into triangles by OpenCASCADE through cascadio."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf import parse_glb
from fsh3d_o3d.files.formats.optional import guarded, optional_module, silenced
from fsh3d_o3d.files.formats.result import mesh_of, welded
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import MeshArrays

# How far triangles may lie from the surface, of the length of the edges of its faces: a ball comes back with 0.15 % too
# little volume and 10,000 triangles, whatever its size.
_DEFLECTION = 1e-3
_ANGLE = 0.3  # radians between neighbouring triangles, a choice: small roundings keep a form
_MILLIMETRES = 1000.0  # in a metre, the unit in which the triangles of STEP come; those of IGES come in millimetres
_SAME_CORNER = 1e-7  # of the largest coordinate: the last bit of float32, in which the triangles come
_NAME_OF = re.compile(rb"#(\d+)\s*=")
_NAME = re.compile(rb"#(\d+)")
_TEXT = re.compile(rb"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)
_FACE = re.compile(rb"\b(?:ADVANCED_FACE|FACE_SURFACE)\s*\(")
_RECORD = 72  # characters of content in a line of IGES; then come a letter and a number
_SECTIONS = b"SGDP"  # letters of the sections that the last line of IGES counts


def parse_step(source: Source) -> MeshArrays:
    """Return a STEP file in millimetres: all solids, shells and parts of assemblies as one surface."""
    text = _TEXT.sub(b"''", source.data)
    if not text.lstrip().startswith(b"ISO-10303-21"):
        raise GeometryReadError("it does not begin with 'ISO-10303-21'")
    if b"END-ISO-10303-21" not in text:
        raise GeometryReadError("truncated: its last line, 'END-ISO-10303-21;', is missing")
    unknown = {*_NAME.findall(text)} - {*_NAME_OF.findall(text)}
    if unknown:
        some = min(unknown).decode("ascii")[:12]
        raise GeometryReadError(f"damaged: {len(unknown)} of its entities are named, but not there, such as #{some}")
    return _tessellated(source, "step", len(_FACE.findall(text)))


def parse_iges(source: Source) -> MeshArrays:
    """Return an IGES file in millimetres: all its surfaces as one."""
    lines = [line for line in source.data.splitlines() if line.strip()]
    last = lines[-1]
    if len(last) <= _RECORD or last[_RECORD : _RECORD + 1] != b"T":
        raise GeometryReadError("truncated, or no IGES: its last line, with a T in column 73, is missing")
    letters = [line[_RECORD : _RECORD + 1] for line in lines]
    for place, letter in enumerate(_SECTIONS):
        field = last[8 * place : 8 * place + 8]
        found = letters.count(bytes([letter]))
        if field[:1] != bytes([letter]) or not field[1:].strip().isdigit() or int(field[1:]) != found:
            raise GeometryReadError(
                f"truncated or damaged: section {chr(letter)} has {found} lines, the last line tells otherwise"
            )
    return _tessellated(source, "iges", 0)


def _tessellated(source: Source, kind: str, faces: int) -> MeshArrays:
    """Return the triangles of a file; ``faces`` of the file, where it is known how many there are."""
    cascadio = optional_module("cascadio", extra="cad", what="STEP and IGES files")
    with guarded("its surfaces cannot be computed"), silenced():
        glb = cascadio.load(
            source.data,
            file_type=kind,
            tol_linear=_DEFLECTION,
            tol_relative=True,
            tol_angular=_ANGLE,
            use_parallel=False,
            merge_primitives=False,
        )
    if not glb:
        raise GeometryReadError("truncated or damaged: OpenCASCADE finds no surface that it can read")
    inner = Source(glb)
    try:
        found = parse_glb(inner)
    except GeometryReadError as error:
        raise GeometryReadError(f"no surface: {error}") from None
    if not isinstance(found, MeshArrays):
        raise GeometryReadError("no surface, only points")
    read = _primitives(glb)
    if read < faces:
        source.note(f"{faces - read} of its {faces} faces have no surface that can be computed; they are missing")
    corners = found.vertices[found.triangles].reshape(-1, 3)
    # Each face came with corners of its own: of STEP to the last bit those of its neighbour, of IGES nearly.
    step = _SAME_CORNER * np.abs(corners).max()
    vertices, triangles = welded(np.rint(corners / step) * step if kind == "iges" and step > 0 else corners)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    return mesh_of(source, vertices * _MILLIMETRES if kind == "step" else vertices, triangles)


def _primitives(glb: bytes) -> int:
    """How many pieces of surface the triangles come in: one for each face."""
    return glb.count(b'"POSITION"')
