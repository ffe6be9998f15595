"""One file a format: bytes into meshes and clouds, in Python and NumPy alone. ``table`` lists them all."""

from __future__ import annotations

from fsh3d_o3d.files.formats.encoding import check_not_a_pointer, plain_text
from fsh3d_o3d.files.formats.gltf import parse_glb
from fsh3d_o3d.files.formats.source import ReadFile, Source
from fsh3d_o3d.files.formats.stl import binary_stl_size, has_binary_header, parse_stl
from fsh3d_o3d.files.formats.table import PARSERS, Parser

__all__ = [
    "PARSERS",
    "Parser",
    "ReadFile",
    "Source",
    "binary_stl_size",
    "check_not_a_pointer",
    "has_binary_header",
    "parse_glb",
    "parse_stl",
    "plain_text",
]
