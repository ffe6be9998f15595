from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from fsh3d_o3d.files.formats.polygons import cut_polygons
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh

U = np.array([(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)], dtype=np.float64)
# A square with a square hole, as one polygon: a bridge leads to the hole and back.
FRAME = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], dtype=np.float64)


def cut(vertices: np.ndarray, polygons: list[list[int]]) -> tuple[np.ndarray, list[str]]:
    counts = np.array([len(polygon) for polygon in polygons])
    source = Source(b"")
    flat = np.array([corner for polygon in polygons for corner in polygon])
    return cut_polygons(source, vertices, flat, np.cumsum(counts) - counts, counts), source.notes


def cut_one(points: np.ndarray) -> np.ndarray:
    triangles, _ = cut(points, [list(range(len(points)))])
    return triangles


def flat(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


def enclosed(points: np.ndarray) -> float:
    """Area of a plane polygon by the shoelace formula, positive against the clock."""
    x, y = points.T
    return float((x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a) / 2


def covered(vertices: np.ndarray, triangles: np.ndarray) -> float:
    return float(np.linalg.norm(areas(vertices, triangles), axis=1).sum())


def turned(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def simple_polygon(rng: np.random.Generator, size: int) -> np.ndarray:
    """A random polygon that does not cross itself: pairs of crossing sides are turned round until there are none."""
    points = rng.random((size, 2))
    while True:
        ends = np.roll(points, -1, axis=0)

        def beside(p: np.ndarray, a: np.ndarray = points, b: np.ndarray = ends) -> np.ndarray:
            u, v = (b - a)[:, None], p[None] - a[:, None]
            return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0] > 0

        crosses = beside(points) != beside(ends)
        crosses &= crosses.T
        step = np.abs(np.arange(size)[:, None] - np.arange(size))
        i, j = np.nonzero(crosses & (step > 1) & (step < size - 1))
        if not len(i):
            return points if enclosed(points) > 0 else points[::-1].copy()
        first, second = min(i[0], j[0]), max(i[0], j[0])
        points[first + 1 : second + 1] = points[first + 1 : second + 1][::-1].copy()


def check_partition(points: np.ndarray, triangles: np.ndarray) -> None:
    """n − 2 triangles; each side of the polygon is a side of one of them, every other side is one of two, opposite."""
    size = len(points)
    assert triangles.shape == (size - 2, 3)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).tolist()
    outer = {(corner, (corner + 1) % size) for corner in range(size)}
    assert len({tuple(side) for side in sides}) == len(sides)
    inner = {tuple(side) for side in sides} - outer
    assert outer <= {tuple(side) for side in sides}
    assert inner == {(b, a) for a, b in inner}


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 40), st.integers(1, 3))
def test_simple_polygons_keep_their_area_sides_and_sense(seed, size, pieces):
    rng = np.random.default_rng(seed)
    corners = simple_polygon(rng, size)
    # Corners on straight sides too, and one that is there twice.
    points = np.concatenate([corners + (np.roll(corners, -1, 0) - corners) * (k / pieces) for k in range(pieces)], 1)
    points = points.reshape(-1, 2)
    points = np.insert(points, 2, points[2], axis=0)
    area = enclosed(points)
    rotation = turned(rng)
    vertices = flat(points) @ rotation.T * 10.0 ** rng.integers(-6, 7) + rng.standard_normal(3)
    scale = np.linalg.norm(vertices[1] - vertices[0]) / np.linalg.norm(points[1] - points[0])
    triangles = cut_one(vertices)
    check_partition(points, triangles)
    found = areas(vertices, triangles) @ rotation[:, 2] / scale**2
    # One millionth of a fold is left; ten digits are lost where the polygon is small beside its distance.
    np.testing.assert_allclose(found.sum(), area, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(np.abs(found).sum(), area, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("points", [U, FRAME], ids=["U", "frame"])
def test_area_does_not_depend_on_the_first_corner_or_the_sense(points):
    for first in range(len(points)):
        for sense in (1, -1):
            vertices = flat(np.roll(points, first, axis=0)[::sense])
            triangles = cut_one(vertices)
            check_partition(vertices, triangles)
            assert covered(vertices, triangles) == pytest.approx(enclosed(points), rel=1e-14)
            assert areas(vertices, triangles)[:, 2].sum() == pytest.approx(sense * enclosed(points), rel=1e-14)


def test_quadrangles_are_cut_at_their_concave_corner():
    arrow = flat(np.array([(0, 0), (2, -1), (0.5, 0), (2, 1)], dtype=np.float64))[[0, 1, 2, 3]]
    for first in range(4):
        order = np.roll(np.arange(4), first).tolist()
        triangles, _ = cut(arrow, [order])
        assert all({0, 2} <= set(triangle) for triangle in triangles.tolist())
        assert covered(arrow, triangles) == pytest.approx(0.5, rel=1e-14)
        np.testing.assert_array_less(0, areas(arrow, triangles)[:, 2] * -np.sign(enclosed(arrow[::-1, :2])))


def test_what_is_convex_or_nearly_so_stays_a_fan():
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    disk = np.column_stack([np.cos(angles), np.sin(angles), 0.3 * np.cos(2 * angles)])  # not flat
    square = flat(np.array([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (0, 2)], dtype=np.float64))
    square += 1e-8 * np.sin(np.arange(18)).reshape(6, 3)  # as rounded in single precision
    for vertices in (disk, square):
        fan = [[0, k, k + 1] for k in range(1, len(vertices) - 1)]
        assert cut_one(vertices).tolist() == fan


def test_polygons_of_all_kinds_together_keep_their_order():
    vertices = np.vstack([flat(U), flat(U) + np.array([10, 0, 0])])
    polygons = [[0, 1, 2], [8], list(range(8)), [0, 1, 2, 3], [8, 9], [15, 14, 13, 12, 11, 10, 9, 8], [3, 5, 4, 1]]
    triangles, notes = cut(vertices, polygons)
    ends = np.cumsum([max(0, len(polygon) - 2) for polygon in polygons])[:-1]
    for polygon, part in zip(polygons, np.split(triangles, ends), strict=True):
        assert len(part) == max(0, len(polygon) - 2)
        assert set(part.ravel().tolist()) <= set(polygon)
        if len(polygon) == 8:
            assert covered(vertices, part) == pytest.approx(7, rel=1e-14)
            assert np.sign(areas(vertices, part)[:, 2]).tolist() == [1 if polygon[0] == 0 else -1] * 6
    assert notes == []
    assert cut(vertices, polygons)[0].tolist() == triangles.tolist()


def test_polygons_that_are_not_flat_are_cut_in_their_plane():
    rng = np.random.default_rng(3)
    wavy = flat(U) + np.column_stack([np.zeros((8, 2)), 0.2 * rng.standard_normal(8)])
    triangles = cut_one(wavy)
    check_partition(wavy, triangles)
    assert covered(flat(U), triangles) == pytest.approx(7, rel=1e-14)


def test_polygons_that_cross_themselves_are_bounded_and_told():
    fan = lambda count: np.array([[0, k, k + 1] for k in range(1, count - 1)])  # noqa: E731
    rng = np.random.default_rng(4)
    star = np.array([(np.cos(t), np.sin(t)) for t in 4 * np.pi / 5 * np.arange(5)])
    for points in (star, rng.random((200, 2)), rng.random((30_000, 2)), np.array([(0, 0), (2, 0), (0, 2), (3, 3.0)])):
        vertices = flat(points)
        triangles, notes = cut(vertices, [list(range(len(points)))])
        assert triangles.shape == (len(points) - 2, 3)
        assert covered(vertices, triangles) <= covered(vertices, fan(len(points))) * (1 + 1e-12)
        # What winds twice around the same place, as the star does, has no triangle that faces the other way.
        assert len(points) == 5 or notes == ["1 of 1 polygons cross themselves: their triangles overlap"]


@pytest.mark.parametrize("shape", ["one star", "teeth", "random star", "snowflake"])
def test_very_large_polygons(shape):
    count = 30_000
    turn = np.arange(count) / count
    rng = np.random.default_rng(5)
    if shape == "teeth":
        points = np.column_stack([turn, np.where(np.arange(count) % 2, 1.0, 0.001)])
        points = np.vstack([points, [(1, 0), (0, 0)]])[::-1]
    elif shape == "snowflake":
        point = np.exp(2j * np.pi / 3 * np.arange(3))
        for _ in range(7):
            third = (np.roll(point, -1) - point) / 3
            spike = point + third + third * np.exp(-1j * np.pi / 3)
            point = np.stack([point, point + third, spike, point + 2 * third], axis=1).ravel()
        points = np.column_stack([point.real, point.imag])
    else:
        radius = np.where(np.arange(count) % 2, 1, 0.3) if shape == "one star" else 0.05 + rng.random(count)
        points = radius[:, None] * np.column_stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])
    triangles = cut_one(flat(points))
    assert triangles.shape == (len(points) - 2, 3)
    assert covered(flat(points), triangles) == pytest.approx(enclosed(points), rel=1e-6)
    assert len(np.unique(triangles)) == len(points)


def test_polygons_without_area_or_size_are_let_through():
    line = flat(np.column_stack([np.arange(6.0), np.arange(6.0)]))
    for vertices in (line, np.zeros((6, 3)), flat(U) * 1e-300, flat(U) * 1e300):
        triangles, notes = cut(vertices, [list(range(len(vertices)))])
        assert triangles.shape == (len(vertices) - 2, 3) and notes == []
    assert len(cut(np.array([[0, 0, np.nan]] * 5), [[0, 1, 2, 3, 4]])[0]) == 3


def prism(points: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    count = len(points)
    vertices = np.vstack([flat(points), flat(points) + np.array([0, 0, 1])])
    walls = [[k, (k + 1) % count, (k + 1) % count + count, k + count] for k in range(count)]
    return vertices, [*walls, list(range(count))[::-1], list(range(count, 2 * count))]


def written(name: str, vertices: np.ndarray, polygons: list[list[int]]) -> str:
    points = [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    if name.endswith(".obj"):
        return "\n".join(["v " + p for p in points] + ["f " + " ".join(str(c + 1) for c in p) for p in polygons])
    faces = [" ".join(map(str, [len(polygon), *polygon])) for polygon in polygons]
    if name.endswith(".off"):
        return "\n".join(["OFF", f"{len(points)} {len(faces)} 0", *points, *faces])
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property double {axis}" for axis in "xyz"] + [f"element face {len(faces)}"]
    return "\n".join([*head, "property list uchar int vertex_indices", "end_header", *points, *faces, ""])


@pytest.mark.parametrize("name", ["u.obj", "u.off", "u.ply"])
def test_prism_over_a_concave_polygon_is_the_solid_it_is(name, tmp_path):
    path = tmp_path / name
    path.write_text(written(name, *prism(U)))
    mesh = read_geometry_arrays(path)
    assert isinstance(mesh, MeshArrays)
    measures = measure_mesh(mesh)
    assert measures.closed and measures.consistently_oriented and measures.outward and measures.genus == 0
    assert covered(mesh.vertices, mesh.triangles) == pytest.approx(30, rel=1e-14)
    caps = [(0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4), (0, 5, 6), (0, 6, 7)]
    walls = prism(U)[1][:8]
    by_hand = [half for a, b, c, d in walls for half in ((a, b, c), (a, c, d))]
    by_hand += [triangle[::-1] for triangle in caps] + [tuple(corner + 8 for corner in t) for t in caps]
    other = MeshArrays(mesh.vertices, np.array(by_hand))
    features = [np.asarray(fsh.compute_shd_feature(solid).data) for solid in (mesh, other)]
    # Samples fall elsewhere on other triangles; the fan of the same solid is 0.4 away.
    assert np.linalg.norm(features[0] - features[1]) < 0.005 * np.linalg.norm(features[0])


def test_prism_with_a_hole_is_closed():
    vertices, polygons = prism(FRAME)
    triangles, _ = cut(vertices, polygons)
    # Corners that are there twice are one.
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    welded = inverse.ravel()[triangles]
    sides = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
    count = np.zeros((len(unique), len(unique)), dtype=int)
    np.add.at(count, (sides[:, 0], sides[:, 1]), 1)
    np.testing.assert_array_equal(count, count.T)
    volume = np.linalg.det(vertices[triangles]).sum() / 6
    assert volume == pytest.approx(12, rel=1e-14)
