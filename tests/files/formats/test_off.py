from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays

POINTS = [(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
VERTICES = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)
FACES = "".join(f"4 {a} {b} {c} {d}\n" for a, b, c, d in SIDES)
APART = "vertices and faces are not one on each line"


@pytest.fixture
def read(tmp_path):
    def read(content: str | bytes):
        path = tmp_path / "a.off"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_geometry_file(path, isolated=False)

    return read


def check_box(mesh: MeshArrays | PointArrays) -> None:
    assert isinstance(mesh, MeshArrays)
    np.testing.assert_array_equal(mesh.vertices, POINTS)
    assert len(mesh.triangles) == 12
    assert np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6 == pytest.approx(6, rel=1e-14)


def behind(extra: str) -> str:
    return VERTICES.replace("\n", f" {extra}\n")


@pytest.mark.parametrize(
    ("content", "notes"),
    [
        ("OFF\n8 6 0\n" + VERTICES + FACES, []),
        ("OFF\n8\n6\n0\n" + VERTICES + FACES, []),
        ("OFF 8 6\n" + VERTICES + FACES, []),
        ("OFF\n8 6 0\n" + VERTICES.replace("\n", " ") + "\n" + FACES, [APART]),
        ("OFF\n8 6 0\n" + VERTICES + FACES.replace(" 4", "\n4").replace(" 3", "\n3"), [APART]),
        (f"OFF 8 6 0 {VERTICES} {FACES}".replace("\n", " "), [APART]),
        ("OFF 8 6 0 " + (VERTICES + FACES).replace(" ", "\n"), [APART]),
        # Colours end with their lines, wherever the vertices' lines end.
        ("OFF\n8 6 0\n" + VERTICES.replace("\n", " ") + "\n" + FACES.replace("\n", " 0.5 1 0\n"), [APART]),
        ("COFF\n8 6 0\n" + behind("255 0 0 255").replace("\n", "\t") + "\n" + FACES, [APART]),
        ("COFF 8 6 0 " + behind("0.5 0 0").replace("\n", "\t") + FACES, [APART]),
        ("NCOFF\n8 6 0\n" + behind("0 0 1 1 0 0 1") + FACES, []),
        ("STCNOFF\n8 6 0\n" + behind("0 0 1 1 0 0 1 0.5 0.5") + FACES, []),
        ("4OFF\n8 6 0\n" + behind("1") + FACES, []),
        ("C4OFF\n8 6 0\n" + behind("1 0 0 0 1") + FACES, []),
        ("nOFF\n3\n8 6 0\n" + VERTICES + FACES, []),
        ("nOFF 3 8 6 0\n" + VERTICES + FACES, []),
        ("8 6 0\n" + VERTICES + FACES, ["the keyword OFF is missing at the beginning"]),
        ("# made by hand\n\nOFF # box\n8 6 0 # counts\n" + VERTICES + "# faces\n" + FACES, []),
    ],
)
def test_text_in_all_its_forms(content, notes, read):
    found = read(content)
    check_box(found.geometry)
    assert list(found.notes) == notes


def test_homogeneous_coordinates_are_divided(read):
    rows = "".join(f"{2 * x} {2 * y} {2 * z} 2\n" for x, y, z in POINTS)
    found = read("4OFF\n8 6 0\n" + rows + FACES)
    check_box(found.geometry)
    assert found.notes == ("coordinates are divided by the fourth, homogeneous one",)


def binary(order: str, *, colors: bool | None, prefix: str = "", rows: list[tuple[float, ...]] | None = None) -> bytes:
    """A binary file; faces have a colour, say that they have none, or (None) do not say anything."""
    table = rows or POINTS
    body = struct.pack(f"{order}3i", 8, len(SIDES), 0)
    body += b"".join(struct.pack(f"{order}{len(row)}f", *row) for row in table)
    for face in SIDES:
        body += struct.pack(f"{order}5i", 4, *face)
        if colors is not None:
            body += struct.pack(f"{order}i4f", 4, 1, 0, 0, 1) if colors else struct.pack(f"{order}i", 0)
    return f"{prefix}OFF BINARY # box\n".encode() + body


@pytest.mark.parametrize("order", [">", "<"])
@pytest.mark.parametrize("colors", [True, False, None])
def test_binary(order, colors, read):
    content = binary(order, colors=colors)
    found = read(content)
    check_box(found.geometry)
    assert len(found.notes) == (order == "<")
    assert "1 byte behind" in read(content + b"x").notes[0]
    assert read(content + b"\0\n").notes == found.notes
    start = content.index(b"\n") + 1
    for size in range(start, len(content) - 1):
        with pytest.raises(GeometryReadError):
            read(content[:size])


def test_binary_with_more_on_its_vertices(read):
    rows = [(*point, 0, 0, 1, 1, 0.5, 0, 1, 0.25, 0.75) for point in POINTS]
    check_box(read(binary(">", colors=False, prefix="STCN", rows=rows)).geometry)
    with pytest.raises(GeometryReadError, match="nOFF in 8 dimensions"):
        read(binary(">", colors=False, prefix="n"))


def test_points_alone_are_a_cloud_with_what_they_have(read):
    cloud = read("OFF\n8 0 0\n" + VERTICES)
    assert isinstance(cloud.geometry, PointArrays) and cloud.notes == ()
    np.testing.assert_array_equal(cloud.geometry.points, POINTS)
    assert cloud.geometry.normals is None and cloud.geometry.colors is None
    cloud = read("CNOFF\n8 0 0\n" + behind("0 0 1 255 0 51 255")).geometry
    np.testing.assert_array_equal(cloud.normals, [[0, 0, 1]] * 8)
    np.testing.assert_allclose(cloud.colors, [[1, 0, 0.2]] * 8, atol=1e-15)
    assert read("COFF\n8 0 0\n" + behind("1 0 0.5")).geometry.colors.tolist() == [[1, 0, 0.5]] * 8
    assert read("COFF\n8 0 0\n" + behind("900 0 0")).geometry.colors is None
    cloud = read(b"NOFF BINARY\n" + struct.pack(">3i", 1, 0, 0) + struct.pack(">6f", 1, 2, 3, 0, 0, 1)).geometry
    assert cloud.points.tolist() == [[1, 2, 3]] and cloud.normals.tolist() == [[0, 0, 1]]
    cloud = read("OFF\n9 0 0\nnan nan nan\n" + VERTICES)
    assert len(cloud.geometry.points) == 8 and "1 of 9 points" in cloud.notes[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("nOFF 4\n8 6 0\n" + behind("1") + FACES, "nOFF in 4 dimensions is not read"),
        ("nOFF\n", "the number of dimensions is missing"),
        ("4OFF\n8 6 0\n" + behind("0") + FACES, "homogeneous coordinate of 4OFF must not be 0"),
        ("4OFF\n8 6 0\n" + VERTICES + FACES, "each vertex needs 4 numbers, found 3"),
        ("OFF\n8 6 0\n" + VERTICES + FACES + "3 0 1 2\n", "but 15 lines follow"),
        ("OFF\n8 6 0\n" + VERTICES.replace("\n", " ") + FACES[:-2], "but 6 lines follow"),
        ("OFF\n8 6 0\n" + VERTICES.replace("\n", " ") + FACES + "0\n", "but 7 lines follow"),
        ("OFF\n8\n6\n", "the numbers of vertices and faces are missing"),
        ("8 6 0\n" + VERTICES + FACES[:-9], "face 5 announces 4 vertices but has 0"),
        ("8 6 0\n" + VERTICES, "does not begin with OFF"),
        ("off-topic", "does not begin with OFF"),
        (binary(">", colors=True)[:60], "truncated or damaged: 8 vertices and 6 faces are announced, but 31 bytes"),
    ],
)
def test_what_lies_or_breaks_off_is_refused(content, reason, read):
    with pytest.raises(GeometryReadError, match=reason):
        read(content)


def test_a_stream_that_is_cut_off_anywhere_is_refused(read):
    content = f"OFF 8 6 0 {VERTICES} {FACES}".replace("\n", " ").strip()
    for size in range(3, len(content) - 1):
        with pytest.raises(GeometryReadError):
            read(content[:size])
    assert re.match("vertices", read(content).notes[0])
