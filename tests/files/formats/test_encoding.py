from __future__ import annotations

import codecs

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats import PARSERS
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry.arrays import MeshArrays
from tests.files import mutations

FILES = mutations.valid_files()
TEXTS = [name for name, file in FILES.items() if file.data.isascii() and b"\0" not in file.data]
BINARIES = [name for name in FILES if name not in TEXTS and not name.endswith(".glb")]


def read(name: str, data: bytes) -> tuple[np.ndarray, tuple[str, ...]]:
    found = parse_content(f"/{name}", data)
    geometry = found.geometry
    return (geometry.vertices[geometry.triangles] if isinstance(geometry, MeshArrays) else geometry.points), found.notes


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("marked", [True, False])
@pytest.mark.parametrize(
    ("encoding", "mark"),
    [
        ("utf-8", codecs.BOM_UTF8),
        ("utf-16-le", codecs.BOM_UTF16_LE),
        ("utf-16-be", codecs.BOM_UTF16_BE),
        ("utf-32-le", codecs.BOM_UTF32_LE),
        ("utf-32-be", codecs.BOM_UTF32_BE),
    ],
)
def test_text_in_any_encoding(name, encoding, mark, marked):
    plain = FILES[name].data
    expected, _ = read(name, plain)
    data = mark * marked + plain.decode().encode(encoding)
    found, notes = read(name, data)
    np.testing.assert_array_equal(found, expected)
    assert [encoding[:6].upper() in note for note in notes] == [True] * (encoding != "utf-8")
    if encoding != "utf-8":
        with pytest.raises(GeometryReadError, match=f"{encoding[:6].upper()}, but not all of it"):
            read(name, data[:-1])


@pytest.mark.parametrize("name", [name for name in BINARIES if not name.endswith(".stl")])
def test_mark_before_a_text_header_of_binary_data(name):
    expected, _ = read(name, FILES[name].data)
    np.testing.assert_array_equal(read(name, codecs.BOM_UTF8 + FILES[name].data)[0], expected)


@pytest.mark.parametrize(
    "mark", [codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE]
)
@pytest.mark.parametrize(
    "header", [b"", b"a part".ljust(76), "Teil".encode("utf-16-le") * 9, "Teil".encode("utf-32-be")]
)
def test_binary_stl_whose_header_begins_like_a_mark(mark, header):
    plain = FILES["binary.stl"].data
    expected, _ = read("a.stl", plain)
    for data in (plain, plain + b"\n"):
        found, _ = read("a.stl", (mark + header).ljust(80, b"\0")[:80] + data[80:])
        np.testing.assert_array_equal(found, expected)


def test_binary_numbers_are_not_taken_for_wide_letters():
    points = np.arange(33, 93, dtype="<u2").reshape(-1, 3)
    points = np.tile(points, (50, 1))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property ushort {axis}\n" for axis in "xyz") + "end_header\n"
    head = head.replace("1.0\n", "1.0\ncomment\n" if len(head) % 2 else "1.0\n")
    np.testing.assert_array_equal(read("a.ply", head.encode() + points.tobytes())[0], points)


def test_latin_1_in_comments_and_names():
    name = "Größe".encode("latin-1")
    for file, word in (("colored.off", b"by hand"), ("plain.obj", b"octahedron"), ("text.ply", b"octahedron")):
        changed = FILES[file].data.replace(word, name)
        np.testing.assert_array_equal(read(file, changed)[0], read(file, FILES[file].data)[0])
    np.testing.assert_array_equal(read("a.xyz", b"# " + name + b"\n1 2 3\n")[0], [[1, 2, 3]])


@pytest.mark.parametrize("extension", PARSERS)
@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (
            "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
            "a Git LFS pointer.*git lfs pull",
        ),
        ("/annex/objects/SHA256E-s1234--9f86d081884c7d65.stl\n", "a git-annex pointer.*git annex get"),
        ("404: Not Found", "looks like the answer of a web server"),
        ("<?xml version='1.0'?>\n<Error><Code>NoSuchKey</Code></Error>", "looks like XML"),
        ("<!DOCTYPE html><html></html>", "looks like HTML"),
        ('{"message": "Not Found", "status": 404}', "looks like JSON|asset|glTF|meshes|scene"),
    ],
)
def test_what_stands_in_place_of_a_file_is_named(extension, content, reason):
    with pytest.raises(GeometryReadError, match=reason):
        read(f"a{extension}", content.encode())
