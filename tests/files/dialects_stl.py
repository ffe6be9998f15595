"""STL as programs write it."""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Iterator

from tests.files.dialects import Dialect, encodings, line_ends, spellings
from tests.files.mutations import valid_files

_TEXT = valid_files()["text.stl"].data
_BINARY = valid_files()["binary.stl"].data
_FACETS = re.findall(rb"  facet.*?endfacet\n", _TEXT, re.DOTALL)
_APART = _TEXT.replace(b"endloop", b"end loop").replace(b"endfacet", b"end facet").replace(b"endsolid", b"end solid")
_ONE_LINE = re.sub(rb"\s+", b" ", _TEXT)


def stl_dialects() -> Iterator[Dialect]:
    """Yield text and binary STL files of the octahedron."""
    yield from _texts()
    yield from _binaries()


def _texts() -> Iterator[Dialect]:
    variants = {
        **line_ends(_TEXT),
        **encodings(_TEXT),
        **{name: text.encode() for name, text in spellings(_TEXT.decode()).items()},
        "upper": _TEXT.upper(),
        "title": _TEXT.title(),
        "tabs": _TEXT.replace(b"  ", b"\t"),
        "flat": re.sub(rb"(?m)^ +", b"", _TEXT),
        "double": _TEXT.replace(b"\n", b"\n\n"),
        "wide": re.sub(rb" ", b"     ", _TEXT),
        "blanks behind": _TEXT.replace(b"\n", b"   \n"),
        "nameless": _TEXT.replace(b"octahedron", b""),
        "long name": _TEXT.replace(b"octahedron", b"a part with a name " * 10),
        "latin name": _TEXT.replace(b"octahedron", "Größe №1".encode("cp1251", "replace")),
        "names of keywords": _TEXT.replace(b"octahedron", b"facet vertex endsolid loop"),
        "hash name": _TEXT.replace(b"octahedron", b"#12"),
        "other end name": _TEXT.replace(b"endsolid octahedron", b"endsolid"),
        "no normals": _TEXT.replace(b" normal 0 0 0", b""),
        "nan normals": _TEXT.replace(b"normal 0 0 0", b"normal nan nan nan"),
        "windows nan": _TEXT.replace(b"normal 0 0 0", b"normal -1.#IND 1.#QNAN 0"),
        "apart": _APART,
        "apart crlf": _APART.replace(b"\n", b"\r\n"),
        "apart upper": _APART.upper(),
        "one line": _ONE_LINE,
        "one line apart": re.sub(rb"\s+", b" ", _APART),
        "facet a line": _TEXT.replace(b"\n   ", b" ").replace(b"\n  end", b" end"),
        "loop on facet": re.sub(rb"\n\s+outer loop", b" outer loop", _TEXT),
        "comment before": b"; written by hand\n" + _TEXT,
        "comments inside": _TEXT.replace(b"  facet", b"# a facet\n  facet").replace(b"  endloop", b"// end\nendloop"),
        "line before": b"Written by hand\n\n" + _TEXT,
        "color line": _TEXT.replace(b"solid octahedron\n", b"solid octahedron\n  color 1 0 0\n", 1),
        "two solids": b"".join([b"solid a\n", *_FACETS[:4], b"endsolid a\nsolid b\n", *_FACETS[4:], b"endsolid b\n"]),
        "eight solids": b"".join(b"solid\n" + facet + b"endsolid\n" for facet in _FACETS),
        "empty solid": b"solid none\nendsolid none\n" + _TEXT,
        "no last line end": _TEXT.rstrip(),
    }
    wrong = {
        "cr": "it wants line ends of Unix or Windows",
        "utf16none": "it wants a byte-order mark",
        **dict.fromkeys(("apart", "apart crlf", "apart upper", "one line apart"), "it knows no 'end loop'"),
        **dict.fromkeys(("one line", "facet a line"), "it wants one keyword a line"),
        "names of keywords": "it looks for keywords in names",
    }
    for name, data in variants.items():
        behind = 0 if name in encodings(b"") else len(data) - data.lower().rindex(b"solid") - len(b"solid")
        yield Dialect(f"{name}_text.stl", data, tail=behind, trimesh=wrong.get(name, ""))
    yield Dialect(
        "no endsolid_text.stl",
        _TEXT.replace(b"endsolid octahedron\n", b""),
        tail=1,  # the last line end tells that the last line is whole
        trimesh="it drops a solid without its end",
    )
    for name, tail in (
        ("words", b"\nfoo bar\n"),
        ("blanks", b"\n\n \t\n"),
        ("zeros", bytes(200)),
        ("dos end", b"\x1a"),
    ):
        yield Dialect(f"{name} behind.stl", _TEXT + tail, tail=len(tail) + len(b" octahedron\n"))


def _binaries() -> Iterator[Dialect]:
    headers = {
        "zeros": bytes(80),
        "blanks": b" " * 80,
        "solid": b"solid octahedron".ljust(80),
        "solid zeros": b"solid octahedron\n".ljust(80, b"\0"),
        "solid facet": b"solid facet normal".ljust(80, b"\0"),
        "colour": b"COLOR=\xff\xff\xff\xff,MATERIAL=".ljust(80, b"\0"),
        "latin": "Größe".encode("latin-1").ljust(80),
        "mark 8": codecs.BOM_UTF8.ljust(80, b"a"),
        "mark 16": codecs.BOM_UTF16_LE.ljust(80, b"a"),
        "mark 16 text": "solid of a program".encode("utf-16").ljust(80, b"\0"),
        "ply": b"ply\nformat ascii 1.0\n".ljust(80),
        "units": b"UNITS=mm".ljust(80),
        "lines": b"a part\r\nby hand\r\n".ljust(80, b"\n"),
    }
    for name, header in headers.items():
        yield Dialect(f"{name}_header.stl", header + _BINARY[80:])
    for name, tail in (
        ("newline", b"\n"),
        ("line ends", b"\r\n\r\n"),
        ("twenty", b"written by a program"),
        ("page", bytes(3612)),
        ("signature", b"-- signature --" * 9),
    ):
        yield Dialect(f"{name}_behind.stl", _BINARY + tail, tail=len(tail), trimesh="it wants the exact size")
    facets = [_BINARY[84 + 50 * i : 132 + 50 * i] for i in range(8)]
    for name, count in (("zero", 0), ("full", 2**32 - 1)):
        data = _BINARY[:80] + struct.pack("<I", count) + _BINARY[84:]
        yield Dialect(f"{name}_count.stl", data, trimesh="it believes the count")
    for name, sizes in (
        ("four", [4] * 8),
        ("two", [2] * 8),
        ("mixed", [0, 7, 0, 1, 300, 2, 2, 5]),
        ("last", [0] * 7 + [9]),
    ):
        body = b"".join(f + struct.pack("<H", n) + b"\5" * n for f, n in zip(facets, sizes, strict=True))
        yield Dialect(f"{name}_payload.stl", _BINARY[:84] + body, trimesh="it wants the exact size")
    for name, colors in (
        ("viscam", [0x8000 | 77 * i for i in range(8)]),
        ("magics", list(range(8))),
        ("one", [31] * 8),
    ):
        body = b"".join(f + struct.pack("<H", color) for f, color in zip(facets, colors, strict=True))
        yield Dialect(f"{name}_colors.stl", _BINARY[:84] + body)
    nan = struct.pack("<3f", *[float("nan")] * 3)
    yield Dialect("nan_normals.stl", _BINARY[:84] + b"".join(nan + f[12:] + b"\0\0" for f in facets))
