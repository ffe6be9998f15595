"""Triangle arithmetic against figures worked out by hand."""

import numpy as np
import pytest

from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import weld, weld_map
from fsh3d_o3d.geometry.rays import UnitScene
from fsh3d_o3d.geometry.triangles import (
    corner_shares,
    even_places,
    longest_edges,
    point_triangle_distance,
    point_triangle_offsets,
    points_at,
    solid_volume,
    triangle_areas,
    triangle_normals,
)

RIGHT = np.array([[[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]])


def test_a_right_triangle_by_hand():
    np.testing.assert_array_equal(triangle_normals(RIGHT), [[0, 0, 12]])
    assert triangle_areas(RIGHT) == pytest.approx(6, rel=1e-15)
    assert longest_edges(RIGHT).tolist() == [25]


def test_the_volume_and_centroid_of_a_tetrahedron():
    tips = np.concatenate((np.zeros((1, 3)), np.eye(3)))
    volume, centroid = solid_volume(tips[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]])
    assert volume == pytest.approx(1 / 6, rel=1e-15)
    np.testing.assert_allclose(centroid, [0.25] * 3, rtol=1e-15)
    assert solid_volume(np.concatenate((RIGHT + 1, RIGHT[:, ::-1] + 1))) == (0, None)  # a triangle and its back


def test_even_places_are_in_the_triangle_and_take_an_equal_share_of_its_quarters():
    u, v = even_places(np.arange(4000), 0.5)
    assert u.min() >= 0 and v.min() >= 0 and (u + v).max() <= 1
    quarters = [np.count_nonzero(u > 0.5), np.count_nonzero(v > 0.5), np.count_nonzero(u + v < 0.5)]
    np.testing.assert_allclose(quarters, 1000, atol=8)  # 32 is what random points would miss by
    place = points_at(np.repeat(RIGHT, 4000, axis=0), np.array([u, v]))
    np.testing.assert_allclose(place.mean(axis=0), [1, 4 / 3, 0], atol=4e-3)  # random points: 0.012 and 0.015


def test_offsets_lead_to_the_closest_point(rng):
    corners, points = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3))
    offsets = point_triangle_offsets(points, corners)
    np.testing.assert_array_equal(point_triangle_distance(points, corners), np.linalg.norm(offsets, axis=1))
    # Of a convex set the closest point is the one whose offset makes no acute angle with the way on to any corner.
    onwards = corners - (points + offsets)[:, None]
    assert np.einsum("nkx,nx->nk", onwards, offsets).min() > -1e-13


def test_shares_of_the_corners():
    points = np.array([[0.0, 0, 0], [0.75, 1, 0], [3.0, -1e-17, 0]])  # a corner, within, outside by rounding
    shares = corner_shares(points, np.repeat(RIGHT, 3, axis=0))
    np.testing.assert_allclose(shares, [[1, 0, 0], [0.5, 0.25, 0.25], [0, 1, 0]], rtol=0, atol=1e-16)
    assert shares.min() == 0
    needle = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    np.testing.assert_array_equal(corner_shares(np.array([[1.9, 0, 0]]), needle), [[0, 0, 1]])


def test_welding_tells_which_vertex_each_one_was():
    vertices = np.array([[9.0, 9, 9], [0, 0, 0], [1, 0, 0], [-0.0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]])
    mesh = MeshArrays(vertices, [[1, 2, 4], [5, 6, 4], [3, 1, 2]])
    welded, source = weld_map(mesh)
    assert source.tolist() == [1, 2, 4, 6]
    np.testing.assert_array_equal(welded.vertices, vertices[source])
    assert welded.triangles.tolist() == [[0, 1, 2], [1, 3, 2]] == weld(mesh).triangles.tolist()


def test_unused_vertices_are_told_apart_and_left_out():
    mesh = MeshArrays(np.array([[7.0, 7, 7], [0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[1, 2, 3]])
    assert mesh.used.tolist() == [False, True, True, True]
    np.testing.assert_array_equal(mesh.gathered_vertices[0], [0, 0, 0])
    compact, kept = mesh.compact()
    assert kept.tolist() == [1, 2, 3] and compact.triangles.tolist() == [[0, 1, 2]]
    np.testing.assert_array_equal(compact.vertices, mesh.used_vertices)


def test_the_closest_triangle_is_the_closest_of_all_in_float64(rng):
    """Sheets closer together than float32 can tell, some of their triangles needles."""
    corner = rng.uniform(-1, 1, size=(40, 3, 3))
    corner[::4, 2] = corner[::4, 0] + 1e-7 * corner[::4, 2]
    corners = np.concatenate([corner + 1e-9 * k for k in range(4)])
    points = rng.uniform(-1, 1, size=(300, 3))
    scene = UnitScene(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    found = point_triangle_distance(points, corners[scene.closest(points)])
    every = [point_triangle_distance(points, np.broadcast_to(one, (len(points), 3, 3))) for one in corners]
    np.testing.assert_allclose(found, np.min(every, axis=0), atol=4e-15)  # rounding in needles; sheets are 1e-9 apart
