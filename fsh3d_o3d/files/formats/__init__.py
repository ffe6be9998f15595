"""One file a format: bytes into meshes and clouds. ``table`` lists them all."""

from __future__ import annotations

from fsh3d_o3d.files.formats.archives import format_of, is_readable, unpacked
from fsh3d_o3d.files.formats.encoding import check_not_a_pointer, plain_text
from fsh3d_o3d.files.formats.source import Part, ReadFile, Source
from fsh3d_o3d.files.formats.stl import binary_stl_size, has_binary_header, parse_stl
from fsh3d_o3d.files.formats.table import NOT_TEXT, PARSERS, PARSERS_ABOVE, Parser

__all__ = [
    "NOT_TEXT",
    "PARSERS",
    "PARSERS_ABOVE",
    "Parser",
    "Part",
    "ReadFile",
    "Source",
    "binary_stl_size",
    "check_not_a_pointer",
    "format_of",
    "has_binary_header",
    "is_readable",
    "parse_stl",
    "plain_text",
    "unpacked",
]
