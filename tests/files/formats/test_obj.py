from __future__ import annotations

import re

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays

CORNERS = "v 0 0 0\nv 0 0 3\nv 0 2 0\nv 0 2 3\nv 1 0 0\nv 1 0 3\nv 1 2 0\nv 1 2 3\n"
SIDES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"


@pytest.fixture
def read(tmp_path):
    def read(content: str | bytes):
        path = tmp_path / "a.obj"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_geometry_file(path, isolated=False)

    return read


@pytest.mark.parametrize(
    ("content", "note"),
    [
        ("$ from a server\n" + CORNERS + SIDES, r"1 line passed over whose keywords OBJ does not have: '\$'"),
        (CORNERS + SIDES + "t crease 2/1/0 1 5 4.7\n", "1 line passed over .*: 't'"),
        (CORNERS + "vw 0 1 0.5\nvw 1 1 0.5\n" + SIDES, "2 lines passed over .*: 'vw'"),
        ("newmtl a\nKd 1 0 0\nillum 2\nmap_Kd a.png\n" + CORNERS + SIDES, "4 lines .*: 'newmtl', 'Kd', 'illum' …"),
        ("Gemacht für das Institut, Halle 7\n" + CORNERS + SIDES, r"1 line passed over .*: 'Gemacht'"),
        ((CORNERS + SIDES).upper(), "14 keywords in capitals"),
        (CORNERS + "f 1 2\nf 3\n" + SIDES, "2 faces of one or two vertices passed over"),
        (CORNERS + SIDES + "l 1 2 3\nf 1\nf 2\n", "2 faces of one or two vertices passed over"),
    ],
)
def test_statements_of_others_are_passed_over_with_a_note(content, note, read):
    found = read(content)
    assert isinstance(found.geometry, MeshArrays)
    corners = found.geometry.vertices[found.geometry.triangles]
    assert abs(np.linalg.det(corners).sum()) / 6 == pytest.approx(6, rel=1e-14)
    assert len(found.geometry.triangles) == 12
    assert len(found.notes) == 1 and re.search(note, found.notes[0])


def test_known_statements_need_no_note(read):
    assert read("mtllib a.mtl\no box\n" + CORNERS + "vt 0 0\nvn 0 0 1\ns 1\ng a\n" + SIDES).notes == ()


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("v1 2 3", "'v1' is not a keyword of OBJ: it looks like a damaged vertex or face"),
        ("vx", "damaged vertex"),
        ("vx 1 2 3", "damaged vertex"),
        ("f1 2 3", "damaged vertex"),
        ("f1", "damaged vertex"),
        ("f-1 -2 -3", "damaged vertex"),
        ("w 1 0 0", "damaged vertex"),
        ("x 1/1 2/2 3/3", "damaged vertex"),
        ("1 2 3", "the line begins with a number"),
        (".5 2", "the line begins with a number"),
        (b"\xff\xd8\xff\xe0 a b", "the line is not text"),
        (b"word \x01\x02 more", "the line is not text"),
        ("v 1 2", "has 2 coordinates"),
        ("f", "breaks off"),
        ("a\nb\nc\nd\ne\ng\nh\n" + "word\n" * 14, "most lines are none"),
    ],
)
def test_damage_stays_an_error(line, reason, read):
    line = line.encode() if isinstance(line, str) else line
    with pytest.raises(GeometryReadError, match=reason):
        read(CORNERS.encode() + line + b"\n" + SIDES.encode())


def test_files_that_break_off_in_a_face_are_refused(read):
    for content in (CORNERS + SIDES + "f 1 2", CORNERS + SIDES + "f 1"):
        with pytest.raises(GeometryReadError, match="truncated: the last face"):
            read(content)
    with pytest.raises(GeometryReadError, match="the faces have 2 vertices or fewer"):
        read(CORNERS + "f 1 2\nf 2\n")


def test_points_alone_are_a_cloud(read):
    found = read(CORNERS)
    assert isinstance(found.geometry, PointArrays)
    assert found.geometry.points.shape == (8, 3) and found.geometry.normals is None and found.geometry.colors is None
    assert found.notes == ("there are no faces: the 8 vertices are read as a point cloud",)
    assert read(CORNERS + "p 1 2 3 4 5 6 7 8\n").notes == ()


def test_points_keep_colours_and_normals_where_they_are_certain(read):
    rows = [line + " 255 0 51" for line in CORNERS.splitlines()]
    whole = "\n".join(rows + ["vn 0 0 1"] * 8)
    np.testing.assert_allclose(read(whole).geometry.colors, [[1, 0, 0.2]] * 8, atol=1e-15)
    np.testing.assert_array_equal(read(whole).geometry.normals, [[0, 0, 1]] * 8)
    np.testing.assert_array_equal(read(whole.replace("255 0 51", "1 0 0.5")).geometry.colors, [[1, 0, 0.5]] * 8)
    unclear = whole.replace("255 0 51", "255 0 51.5").replace("vn 0 0 1", "", 1)
    assert read(unclear).geometry.colors is None and read(unclear).geometry.normals is None
    assert read(CORNERS.replace("3\n", "3 0.5 0.5 0.5\n")).geometry.colors is None


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (CORNERS + "l 1 2 3\nl 4 5\n", "no surface, only lines: 8 vertices, 2 statements 'l' and 0 faces"),
        (CORNERS + "cstype bezier\ndeg 3 3\nsurf 0 1 0 1 1 2 3 4\nend\n", "only free-form surfaces"),
        (CORNERS + "vt 0 0\n", "truncated before its faces"),
        ("vn 0 0 1\nf 1 2 3\n", "0 vertices and 1 faces"),
    ],
)
def test_what_is_neither_surface_nor_points(content, reason, read):
    with pytest.raises(GeometryReadError, match=reason):
        read(content)


def test_points_that_are_nan_are_left_out(read):
    found = read(CORNERS + "v nan 0 0\nv nan nan nan\n")
    assert len(found.geometry.points) == 8
    assert any("2 of 10 points" in note for note in found.notes)
    mesh = read(CORNERS + SIDES + "v nan 0 0\n")
    assert len(mesh.geometry.vertices) == 8 and "1 vertices that no face uses" in mesh.notes[0]
