"""From a file to arrays: what is packed is unpacked, the extension tells the parser, and what goes wrong is one line.

Most parsers are this package's own because the readers at hand are too lenient for untrusted files (a truncated file
becomes part of a mesh) or slow to start; they are second opinions in the tests.
"""

from __future__ import annotations

import errno
import functools
import os
import re
from pathlib import Path

import numpy as np

from fsh3d_o3d._printable import printable
from fsh3d_o3d._regular_file import open_regular
from fsh3d_o3d.errors import GeometryError, GeometryReadError
from fsh3d_o3d.files.formats import (
    NOT_TEXT,
    PARSERS,
    PARSERS_ABOVE,
    Parser,
    ReadFile,
    Source,
    binary_stl_size,
    check_not_a_pointer,
    format_of,
    has_binary_header,
    is_readable,
    parse_stl,
    plain_text,
    unpacked,
)
from fsh3d_o3d.files.object_storage import is_uri, object_content

_SNIFFED_BYTES = 4096  # in which other formats are recognised; the longest pattern skips 3000
_LONGEST_REASON = 400  # characters, a choice: five lines of a terminal
_LONGEST_MESSAGE = 2000  # characters with the path, a choice
_TOO_LITTLE_MEMORY = "needs more memory than the reader is allowed"
_PROLOGUE = rb"\s*(?:<[?!][^>]*>\s*)*"  # what XML may begin with
# In this order; looked for only where the parser that the extension names has failed.
_SIGNATURES: tuple[tuple[str, re.Pattern[bytes]], ...] = (
    ("PLY", re.compile(rb"ply[ \t]*[\r\n]")),
    ("GLB", re.compile(rb"glTF")),
    ("PNG", re.compile(rb"\x89PNG")),
    ("JPEG", re.compile(rb"\xff\xd8\xff")),
    ("PDF", re.compile(rb"%PDF")),
    ("LAS", re.compile(rb"LASF")),
    ("E57", re.compile(rb"ASTM-E57")),
    ("TIFF", re.compile(rb"II[*+]\0|MM\0[*+]")),
    ("NRRD", re.compile(rb"NRRD000")),
    ("NPY", re.compile(rb"\x93NUMPY")),
    ("FBX", re.compile(rb"Kaydara FBX Binary|; FBX \d")),
    ("DAE", re.compile(_PROLOGUE + rb"<(?:\w+:)?COLLADA\b")),
    ("X3D", re.compile(_PROLOGUE + rb"<(?:\w+:)?X3D\b")),
    ("VTU", re.compile(_PROLOGUE + rb"<VTKFile\s[^>]*UnstructuredGrid")),
    ("VTP", re.compile(_PROLOGUE + rb"<VTKFile\s[^>]*PolyData")),
    ("VTK", re.compile(rb"# vtk DataFile")),
    ("ZIP", re.compile(rb"PK\x03\x04")),
    ("GZIP", re.compile(rb"\x1f\x8b")),
    ("HTML", re.compile(rb"\s*<(!doctype html|html)", re.IGNORECASE)),
    ("PCD", re.compile(rb"# \.PCD|VERSION[ \t]+\.?\d|FIELDS[ \t]+x")),
    ("OFF", re.compile(rb"\s*(?:ST|[CN4n])*OFF[\s\d]")),
    ("GLTF", re.compile(rb'\s*\{(?s:.){0,2000}"(asset|accessors|meshes)"')),
    ("STL", re.compile(rb"\s*solid\b(?s:.){0,400}\bfacet\b", re.IGNORECASE)),
    (
        "the answer of a web server",
        re.compile(
            rb"\s*(HTTP/\d|([45]\d\d:?\s+)?(not found|forbidden|(access )?denied|unauthori[sz]ed|gone)\b)", re.I
        ),
    ),
    ("XML", re.compile(rb"\s*<(\?xml|[a-z!]\S*[ >])", re.IGNORECASE)),
    ("JSON", re.compile(rb'\s*(\{\s*["}]|\[\s*[\[{"\d-])')),
    ("OBJ", re.compile(rb"(?s:.){0,3000}?(^|[\r\n])(v[ \t]+[-+.\d]\S*[ \t]+[-+.\d]|mtllib )")),
)
_WRITTEN_AS = {
    "GLTF": "JSON",
    "3MF": "ZIP",
    "NPZ": "ZIP",
    "LAZ": "LAS",
    "TIF": "TIFF",
    "NHDR": "NRRD",
}
"""Formats whose files are of another, more general one as well."""


def read_file(path: str) -> ReadFile:
    """Return a file, read in this process.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: Everything else, in one line with the file's name.
    """
    require_readable(path)
    try:
        data = file_content(path)
    except FileNotFoundError:
        raise FileNotFoundError(errno.ENOENT, "No such file", path) from None
    except (OSError, GeometryError) as error:
        raise read_error(path, getattr(error, "strerror", None) or str(error)) from None
    except MemoryError:
        raise read_error(path, _TOO_LITTLE_MEMORY) from None
    return parse_content(path, data)


def file_content(path: str) -> bytes:
    """Return the bytes of a regular file, or of an object in storage.

    Raises:
        OSError: It is not there or cannot be read.
        GeometryReadError: It is not a regular file, or holds nothing.
    """
    data = object_content(path) if is_uri(path) else _regular_content(path)
    _check_not_blank(data)
    return data


def _check_not_blank(data: bytes) -> None:
    if not data.strip(b"\0 \t\r\n"):
        raise GeometryReadError("the file is empty" if not data else "the file holds nothing but blanks")


def parse_content(path: str, data: bytes) -> ReadFile:
    """Return what the bytes of a file hold; its name tells the format, and where to look for what lies beside it.

    Raises:
        GeometryReadError: They cannot be, in one line with the file's name.
    """
    require_readable(path)
    name, source = path, Source(data, functools.partial(_content_beside, path))
    try:
        check_not_a_pointer(data)
        name, source.data, source.content_beside = unpacked(path, data, source.content_beside)
        if source.data is not data:
            _check_not_blank(source.data)
        above = PARSERS_ABOVE.get(format_of(name))
        parser = above or PARSERS[format_of(name)]
        # The header of a binary STL may begin with anything, also with the bytes of a byte-order mark.
        if (
            not above
            and format_of(name) not in NOT_TEXT
            and not (parser is parse_stl and has_binary_header(source.data))
        ):
            source.data = plain_text(source)
        with np.errstate(all="ignore"):  # what is not finite is an error, not a warning
            geometry = parser(source)
    except MemoryError:
        raise read_error(path, _TOO_LITTLE_MEMORY) from None
    except GeometryError as error:
        raise read_error(path, _with_sniffed(name, source.data, str(error))) from None
    except Exception as error:  # what no parser foresaw in a file is the file's fault for the caller all the same
        raise read_error(path, f"cannot be parsed ({type(error).__name__}: {error})") from error
    return ReadFile(geometry, tuple(source.notes), tuple(source.used.values()), tuple(source.parts))


def parse_with(extension: str, parser: Parser) -> None:
    """Say what parses files of an extension that no folder below knows, such as shapes'; called when it is loaded."""
    PARSERS_ABOVE[extension] = parser


def require_readable(path: str) -> None:
    """Refuse a file whose extension, in whatever case, names no format that is read.

    Raises:
        GeometryReadError: It names none.
    """
    if not is_readable(path) and format_of(path) not in PARSERS_ABOVE:
        suffix = Path(path).suffix.lower()
        named = f"{suffix!r} is not a format that is read" if suffix else "the name has no extension"
        if suffix == ".gz":
            named = "what is packed is not of a format that is read"
        known = " ".join([*PARSERS, *PARSERS_ABOVE])
        raise read_error(path, f"{named}; readable are {known}, also packed as .gz or .zip")


def read_error(path: str, reason: str) -> GeometryReadError:
    """Return the error for a file: one line of printable characters, whatever its name and content."""
    if len(reason) > _LONGEST_REASON:  # a name in a file may be as long as the file
        reason = f"{reason[:_LONGEST_REASON]}…"
    return GeometryReadError(printable(f"{path}: {reason}"[:_LONGEST_MESSAGE]))


def _content_beside(path: str, name: str) -> bytes:
    folder = path.rpartition("/")[0] if is_uri(path) else os.path.dirname(path)  # noqa: PTH120 - any bytes
    try:
        data = file_content(f"{folder}/{name}" if is_uri(path) else os.path.join(folder, name))  # noqa: PTH118 - same
        check_not_a_pointer(data)
    except (OSError, GeometryError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise GeometryReadError(f"it needs the file '{name}' beside it: {reason}") from None
    return data


def _regular_content(path: str) -> bytes:
    with open_regular(path) as file:
        return file.read()


def _with_sniffed(path: str, data: bytes, reason: str) -> str:
    own = Path(path).suffix[1:].upper()
    found = next((name for name, signature in _SIGNATURES if signature.match(data[:_SNIFFED_BYTES])), None)
    if found is None and len(data) == binary_stl_size(data):
        found = "STL"
    if found is None or found == own or found == _WRITTEN_AS.get(own):
        return reason
    return f"the content looks like {found}, not {own} ({reason})"
