from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from tests.files import mutations

BINARY = mutations.valid_files()["binary.stl"].data
TEXT = mutations.valid_files()["text.stl"].data
FACETS = len(mutations.TRIANGLES)
CORNERS = mutations.VERTICES[mutations.TRIANGLES]


def read(data: bytes) -> tuple[np.ndarray, str]:
    """Corners, (t, 3, 3), and the notes in one line."""
    found = parse_content("/a.stl", data)
    return found.geometry.vertices[found.geometry.triangles], "; ".join(found.notes)


def with_count(count: int, data: bytes = BINARY) -> bytes:
    return data[:80] + struct.pack("<I", count) + data[84:]


def with_payload(sizes: list[int]) -> bytes:
    facets = [BINARY[84 + 50 * i : 132 + 50 * i] + struct.pack("<H", n) + b"\7" * n for i, n in enumerate(sizes)]
    return BINARY[:84] + b"".join(facets)


def with_colors(colors: list[int]) -> bytes:
    return BINARY[:84] + b"".join(
        BINARY[84 + 50 * i : 132 + 50 * i] + struct.pack("<H", color) for i, color in enumerate(colors)
    )


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (BINARY, ""),
        (BINARY + b"\n", "1 byte behind the 8 triangles"),
        (BINARY + b"written by someone\0\0", "20 bytes behind"),
        (BINARY + bytes(500), "500 bytes behind"),
        (BINARY + b"signature " * 12 + b".", "121 bytes behind"),
        (with_count(0), "the header's count, 0, was never filled in; the file holds 8 whole facets"),
        (with_count(2**32 - 1), "count, 4294967295, was never filled in"),
        (with_payload([4] * FACETS), "32 bytes of attributes behind the facets passed over"),
        (with_payload([0, 3, 0, 0, 700, 1, 0, 2]), "706 bytes of attributes"),
        (with_payload([4] * FACETS) + b"\r\n", "32 bytes of attributes"),
        (with_colors([0x8000 + 31 * i for i in range(FACETS)]) + b"\n", "1 byte behind"),
        (with_colors([31] * FACETS) + b"\n\n\n", "3 bytes behind"),
        (with_colors(list(range(FACETS))), ""),
        (TEXT.replace(b"endloop", b"end loop").replace(b"endfacet", b"end facet").replace(b"ends", b"end s"), "apart"),
        (TEXT.upper(), ""),
        (TEXT.replace(b"\n", b"\r"), ""),
        (TEXT.replace(b"\n", b" "), "several keywords of text STL stand on one line"),
        (re.sub(rb"\s+", b" ", TEXT.replace(b"octahedron", b"my part")), "several keywords"),
        (b"; made by hand\n# by me\n" + TEXT, "2 comment lines"),
        (b"made by hand\n" + TEXT, "1 line outside the facets not of text STL passed over, the first begins"),
        (TEXT + b"\nfoo bar\nfoo\n", "2 lines outside the facets"),
        (TEXT.replace(b"solid octahedron\n", b"solid octahedron\ncolor 1 0 0\n", 1), "begins with 'color'"),
        (TEXT.replace(b"octahedron", b""), ""),
        (TEXT.replace(b"octahedron", "Schraube groß facet vertex".encode("latin-1")), ""),
        (TEXT.replace(b"solid octahedron\n", b"solid " + b"long name " * 30 + b"\n", 1), ""),
        (TEXT.replace(b" normal 0 0 0", b""), ""),
        (TEXT.replace(b"normal 0 0 0", b"normal -nan(ind) nan 1e999"), ""),
        (TEXT.replace(b"endsolid octahedron\n", b""), "endsolid is missing; no facet is, as the surface is closed"),
        (TEXT + bytes(300), ""),
    ],
)  # fmt: skip
def test_odd_but_sound(data, note):
    corners, notes = read(data)
    np.testing.assert_array_equal(corners, CORNERS)
    assert note in notes if note else not notes


def test_several_solids_are_one_surface():
    half = TEXT.count(b"endfacet") // 2
    facets = re.findall(rb"  facet.*?endfacet\n", TEXT, re.DOTALL)
    parts = [b"solid one\n", *facets[:half], b"endsolid one\n\nsolid\n", *facets[half:], b"endsolid\n"]
    corners, notes = read(b"".join(parts))
    np.testing.assert_array_equal(corners, CORNERS)
    assert not notes
    with pytest.raises(GeometryReadError, match="breaks off at 'so'"):
        read(b"".join(parts[: half + 1]) + b"endsolid one\nso")
    with pytest.raises(GeometryReadError, match="endsolid without solid"):
        read(b"".join(parts).replace(b"solid\n", b"\n", 1))
    closed_but_for_the_mark = b"".join([b"solid one\n", *facets[:half], b"solid two\n", *facets[half:], b"endsolid\n"])
    assert "endsolid is missing" in read(closed_but_for_the_mark)[1]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (BINARY[:-1], "truncated or damaged: the header announces 8 triangles, 484 bytes, but the file has 483, 7"),
        (with_count(9), "announces 9 triangles, 534 bytes, but the file has 484, 8 whole"),
        (with_count(7), "damaged: the header announces 7 triangles, 434 bytes, but the file has 484, 8"),
        (with_count(7) + b"\n", "damaged: the header announces 7 triangles"),
        (with_count(0)[:-1], "damaged: the header announces 0 triangles, 84 bytes, but the file has 483"),
        (with_count(2**32 - 1)[:-1], "announces 4294967295 triangles"),
        (with_count(0) + b"\n", "announces 0 triangles"),
        (with_count(0)[:84], "0 triangles"),
        (with_payload([4] * FACETS)[:-1], "facets announce more bytes of attributes than the file has"),
        (with_payload([4] * FACETS)[:-25], "facets announce more bytes of attributes than the file has"),
        (b"v 0 0 0\n" * 30, "it does not begin with 'solid' as text STL does"),
        (TEXT[: TEXT.index(b"  facet", 600)], "endsolid is missing, and the surface is open"),
        (TEXT[: TEXT.index(b"endloop", 600)], "a facet is not three vertices in a loop"),
        (TEXT[: TEXT.index(b"endloop", 600) + 3], "'end' is not a keyword"),
        (TEXT[: TEXT.index(b"endsolid")].rstrip(), "endsolid is missing, and so is the end of the last line"),
        (TEXT[: TEXT.index(b"endsolid") + 4], "truncated: the last line breaks off at 'ends'"),
        (TEXT[17:], "does not begin with 'solid'"),
        (b"solid a\nendsolid a\n", "0 triangles"),
        (TEXT.replace(b"vertex", b"vertxe", 1), "'vertxe' is not a keyword of text STL"),
        (TEXT.replace(b"0.25", b"0.25 1", 1), "numbers"),
        (TEXT.replace(b"0.25", b"nan", 1), "NaN or infinite"),
        (TEXT.replace(b"0.25", b"0,25"), "expected numbers, found '0,25'"),
        (TEXT.replace(b"0.25", b"0\0002"), "numbers"),
        (re.sub(rb"\s+", b" ", TEXT)[:700], "a facet is not three vertices in a loop"),
    ],
)  # fmt: skip
def test_damaged_is_refused_with_the_right_reason(data, reason):
    with pytest.raises(GeometryReadError, match=re.escape(reason)):
        read(data)
