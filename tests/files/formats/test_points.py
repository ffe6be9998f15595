from __future__ import annotations

import re

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry.arrays import PointArrays
from tests.files import mutations

POINTS = mutations.VERTICES
ROWS = [" ".join(f"{v!r}" for v in row) for row in POINTS.tolist()]
PLAIN = "\n".join(ROWS) + "\n"
COLORED = "".join(f"{row} {r} {g} {b}\n" for row, (r, g, b) in zip(ROWS, mutations.COLORS.tolist(), strict=True))
INTENSITY = "".join(f"{row} -7 {r} {g} {b}\n" for row, (r, g, b) in zip(ROWS, mutations.COLORS.tolist(), strict=True))


def read(data: str, name: str = "a.xyz") -> tuple[PointArrays, str]:
    found = parse_content(f"/{name}", data.encode("latin-1"))
    assert isinstance(found.geometry, PointArrays)
    return found.geometry, "; ".join(found.notes)


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (PLAIN, ""),
        ("x y z\n" + PLAIN, "the columns are those that the first line names: x y z"),
        ("//X Y Z\n" + PLAIN, ""),
        ("# x y z\n" + PLAIN, ""),
        ("% by hand: \xe4\xf6\n// again\n\n" + PLAIN, ""),
        ("# five words are no names\n" + PLAIN, ""),
        ("//X Y Z\n6\n" + PLAIN, "the first line is the number of points"),
        ("6\n" + PLAIN, "the first line is the number of points"),
        (PLAIN.replace(" ", ","), "numbers are separated by commas"),
        (PLAIN.replace(" ", ", "), "numbers are separated by commas"),
        (PLAIN.replace(" ", ",").replace("\n", ",\n"), "numbers are separated by commas"),
        (PLAIN.replace(" ", ";").replace("\n", "\r\n"), "numbers are separated by semicolons"),
        (PLAIN.replace(" ", ";").replace(".", ","), "numbers have decimal commas, with semicolons"),
        ("# a,,b; c\n" + PLAIN.replace(" ", ",").replace("\n", " # x,, y;\n"), "numbers are separated by commas"),
        (PLAIN.replace(" ", "\t"), ""),
        (PLAIN.replace("\n", "\r"), ""),
        ('"x";"y";"z"\n' + PLAIN.replace(" ", ";"), "first line names: x y z; numbers are separated by semicolons"),
        ("6\n" + PLAIN.replace(" ", ","), "separated by commas; the first line is the number"),
        (PLAIN.replace("\n", " 7\n"), ""),
        (PLAIN.replace("\n", " // a point\n"), ""),
        (PLAIN.rstrip() + "\0\0\0", ""),
    ],
)
def test_odd_but_sound(data, note):
    cloud, notes = read(data)
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.normals is None and cloud.colors is None
    assert note in notes if note else not notes


@pytest.mark.parametrize(
    "head", ["x y z r g b\n", "//X Y Z R G B\n", "#x,y,z,red,green,blue\n", '"X","Y","Z","R","G","B"\n']
)
@pytest.mark.parametrize("name", ["a.xyz", "a.pts", "a.xyzrgb", "a.xyzn"])
def test_names_tell_the_columns_whatever_the_format(head, name):
    cloud, notes = read(head + COLORED.replace(" ", "," if "," in head else " "), name)
    np.testing.assert_array_equal(cloud.points, POINTS)
    np.testing.assert_allclose(cloud.colors, mutations.COLORS / 255, atol=1e-15)  # eight bits divided by 255
    assert cloud.normals is None and "x y z r g b" in notes


def test_names_tell_the_order():
    cloud, _ = read("intensity;nz;ny;nx;Z [m];Y [m];X [m]\n7;0.1;0.2;0.3;3;2;1\n")
    assert cloud.points.tolist() == [[1, 2, 3]] and cloud.normals.tolist() == [[0.3, 0.2, 0.1]]
    cloud, notes = read("# z y x\n3 2 1\n")
    assert cloud.points.tolist() == [[1, 2, 3]] and "a comment names: z y x" in notes
    cloud, notes = read("x y z r g b\n1 2 3 0 0 65535\n")
    assert cloud.colors is None and "colours outside 0 … 255 were left out" in notes


@pytest.mark.parametrize(
    ("data", "note"),
    [
        ("6\n" + INTENSITY, ""),
        (INTENSITY, "the number of points is missing"),
        ("".join(f"2\n{two}" for two in re.findall(r"(?:.*\n){2}", INTENSITY)), "3 scans were put together"),
        ("6\r\n" + INTENSITY.replace("\n", "\r\n"), ""),
        ("6\n" + COLORED, ""),
    ],
)
def test_pts_scans(data, note):
    cloud, notes = read(data, "a.pts")
    np.testing.assert_array_equal(cloud.points, POINTS)
    np.testing.assert_allclose(cloud.colors, mutations.COLORS / 255, atol=1e-15)  # eight bits divided by 255
    assert note in notes if note else not notes


def test_more_columns_than_the_format_has():
    cloud, notes = read("1\n1 2 3 4 5\n", "a.pts")
    assert cloud.points.tolist() == [[1, 2, 3]] and "the 2 columns behind x, y and z passed over" in notes
    cloud, notes = read("1 2 3 0 0 1 9\n", "a.xyzn")
    assert cloud.normals.tolist() == [[0, 0, 1]] and "1 column behind the sixth passed over" in notes


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.xyz", PLAIN[:-5], "numbers, point 0 has 3"),
        ("a.xyz", PLAIN.replace(" ", ",")[:-5], "numbers, point 0 has 3"),
        ("a.xyz", "6\n" + "\n".join(ROWS[:-1]), "the first line announces 6 points, but 5 follow"),
        ("a.xyz", "6\n" + PLAIN + "1 2 3\n", "the first line announces 6 points, but 7 follow"),
        ("a.xyz", "x y z\n" + PLAIN.replace("\n", " 7\n"), "names 3 columns, but the points have 4 numbers"),
        ("a.xyz", "a cloud\n" + PLAIN, "the first line is neither numbers nor the names of columns"),
        ("a.xyz", PLAIN.replace(" ", ",,"), "a field between two separators is empty"),
        ("a.xyz", "1,,3\n" * 4, "a field between two separators is empty"),
        ("a.xyz", "1;2;3\n;2;3\n", "a field between two separators is empty"),
        ("a.xyz", "1,5 2,5 3,5\n", "blanks and commas both stand between digits"),
        ("a.xyz", "1,000.5;2,5;3,5\n", "both points and commas"),
        ("a.xyz", "x y z\n", "no points"),
        ("a.xyz", "3\nwater\nO 0 0 0.1\nH 0 0.7 -0.4\nH 0 -0.7 -0.4\n", "a molecule"),
        ("a.xyz", "3\n\nO 0 0 0.1\nH 0 0.7 -0.4\nH 0 -0.7 -0.4\n", "a molecule"),
        ("a.xyz", "O 0 0 0.1\nH 0 0.7 -0.4\nH 0 -0.7 -0.4\n", "a molecule"),
        ("a.xyz", "3\n\n8 0 0 0.1\n1 0 0.7 -0.4\n1 0 -0.7 -0.4\n", "a molecule"),
        ("a.pts", "2\n1 2 3\n4 5 6\n2\n1 2 3\n", "scan 2 announces 2 points, but 1 follow"),
        ("a.pts", "2\n1 2 3\n4 5 6\n1\n1 2 3 7\n", "point 2 has 4 numbers, point 0 has 3"),
        ("a.pts", "1.5\n1 2 3\n", "numbers of points must be whole numbers"),
        ("a.pts", "1\n1\n" + "0 0 1\n" * 4 + "1 0 0 0\n" * 4 + "1 2 3 0.5\n", "the content is PTX"),
        ("a.xyzrgb", "1 2 3 4 5\n", "each point needs 6 numbers, found 5"),
    ],
)  # fmt: skip
def test_damaged_or_of_another_kind_is_refused_with_the_right_reason(name, data, reason):
    with pytest.raises(GeometryReadError, match=re.escape(reason)):
        read(data, name)
