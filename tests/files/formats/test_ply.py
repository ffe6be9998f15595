from __future__ import annotations

import struct

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays

POINTS = [(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 6\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n"
)
VERTICES = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)
FACES = "".join(f"9 4 {a} {b} {c} {d}\n" for a, b, c, d in SIDES)
TEXT = HEAD + VERTICES + FACES
BINARY = HEAD.replace("ascii", "binary_little_endian").encode()
BINARY += b"".join(struct.pack("<3f", *point) for point in POINTS)
BINARY += b"".join(struct.pack("<BB4i", 9, 4, *side) for side in SIDES)
APART = "the records are not one on each line"


@pytest.fixture
def read(tmp_path):
    def read(content: str | bytes):
        path = tmp_path / "a.ply"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_geometry_file(path, isolated=False)

    return read


@pytest.mark.parametrize(
    ("content", "note"),
    [
        (TEXT, None),
        (HEAD + VERTICES + FACES.replace(" 4", "\n4"), APART),
        (HEAD + VERTICES.replace("\n", " ") + FACES, APART),
        (HEAD + (VERTICES + FACES).replace("\n", " "), APART),
        (HEAD + (VERTICES + FACES).replace(" ", "\n"), APART),
        (HEAD + "comment hello 1 2\n" + VERTICES + "obj_info x\n" + FACES, "2 comments among the data passed over"),
        (
            TEXT.replace("element vertex", "Created by Blender3D 247 - www.blender.org\nelement vertex"),
            "header line 'Created by Blender3D 247…' passed over: it is neither a comment nor anything else",
        ),
        (TEXT.replace("float x", "float X").replace("float z", "float Z"), "names of properties in capitals"),
        (TEXT + "made by hand\n\n", "1 line behind the data passed over"),
        (TEXT + "\0\0\0\0", None),
        (BINARY, None),
        (BINARY + b"\r\n", None),
        (BINARY + bytes(8), "8 bytes behind the elements that the header announces passed over"),
        (BINARY + bytes(18), "18 bytes behind the elements that the header announces passed over"),
        (BINARY + b"made by hand", "12 bytes behind the elements that the header announces passed over"),
        (BINARY.replace(b"float y", b"float Y"), "names of properties in capitals"),
    ],
)
def test_read_with_a_note(content, note, read):
    found = read(content)
    assert isinstance(found.geometry, MeshArrays)
    np.testing.assert_array_equal(found.geometry.vertices, POINTS)
    assert np.linalg.det(found.geometry.vertices[found.geometry.triangles]).sum() / 6 == pytest.approx(6, rel=1e-14)
    assert list(found.notes) == ([] if note is None else [note])


def test_properties_that_differ_in_capitals_only_are_two(read):
    head = HEAD.replace("float z\n", "float z\nproperty float X\n")
    found = read(head + VERTICES.replace("\n", " 5\n") + FACES)
    np.testing.assert_array_equal(found.geometry.vertices, POINTS)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (TEXT + "9 4 0 1 3 2\n", "the header announces 14 lines, but 15 follow"),
        (TEXT[:-9], "face 5 is cut short|the header announces"),
        (HEAD + VERTICES.replace("\n", " ") + FACES[:-2], "the header announces 14 lines, but 6 follow"),
        (HEAD + VERTICES.replace("\n", " ") + FACES + "1\n", "the header announces 14 lines, but 7 follow"),
        (
            BINARY + struct.pack("<BB4i", 9, 4, *SIDES[0]),
            "18 bytes follow the elements .* in records like the last one",
        ),
        (BINARY[:-1], "truncated"),
        (
            "ply\nformat binary_big_endian 1.0\nelement vertex 3\nend_header\nabcdef",
            "no vertex element with x, y and z",
        ),
        (TEXT.replace("property float y", "propetry float y"), "is not understood"),
        (TEXT.replace("property float y", "junk float y"), "is not understood"),
        (TEXT.replace("element face 6", "xlement face 6"), "is not understood"),
        (TEXT.replace("format ascii 1.0", "a\x01b c\nformat ascii 1.0"), "is not understood"),
        (TEXT.replace("format ascii 1.0", "formt ascii 1.0"), "is not understood"),
    ],
)
def test_what_lies_or_breaks_off_is_refused(content, reason, read):
    with pytest.raises(GeometryReadError, match=reason):
        read(content)


def test_a_stream_that_is_cut_off_anywhere_is_refused(read):
    content = HEAD + (VERTICES + FACES).replace("\n", " ").strip()
    for size in range(len(HEAD), len(content) - 1):
        with pytest.raises(GeometryReadError):
            read(content[:size])


def test_points_and_edges_without_faces(read):
    head = HEAD.split("element face")[0]
    found = read(head + "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n" + VERTICES + "0 1\n")
    assert isinstance(found.geometry, PointArrays)
    assert found.notes == ("1 edge passed over: there are no faces, and the vertices are read as a point cloud",)
    content = (head + "end_header\n").replace("ascii", "binary_big_endian").encode()
    content += b"".join(struct.pack(">3f", *point) for point in POINTS)
    np.testing.assert_array_equal(read(content).geometry.points, POINTS)
    assert len(read(content + bytes(12)).notes) == 1
    with pytest.raises(GeometryReadError, match="12 bytes follow"):
        read(content + struct.pack(">3f", 1, 2, 3))
