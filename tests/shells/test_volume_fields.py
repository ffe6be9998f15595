"""Fields around surfaces: exact distances, and an inside that survives bad meshes."""

from __future__ import annotations

import math

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.shells.volume_fields import volume_field
from tests.geometry.mesh_shapes import box, frame, sphere, torus


def turned(mesh, which):
    triangles = mesh.triangles.copy()
    triangles[which] = triangles[which][:, ::-1]
    return MeshArrays(mesh.vertices, triangles)


def together(*meshes):
    shift = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, shift, strict=False)]
    return MeshArrays(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def signs(mesh, points, **options):
    """Signed distances at points in the coordinates of the mesh."""
    field = volume_field(mesh, "signed_distance", width=math.inf, **options)
    return field.sample((np.atleast_2d(points) - field.center) / field.scale) * field.scale


def box_distance(points, half):
    """Signed distance to a box about the origin, by its formula."""
    beyond = np.abs(points) - half
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def test_distance_to_a_box_is_exact(rng):
    points = rng.uniform(-2, 2, (5000, 3))
    got = signs(box((2.0, 1.0, 1.6)), points)
    # float32 decides between triangles equally near, which moves the float64 distance by its rounding at most.
    assert np.abs(got - box_distance(points, np.array([1.0, 0.5, 0.8]))).max() < 1e-6


def test_paths_give_what_single_points_give(rng):
    field = volume_field(torus(), "signed_distance", width=math.inf)
    paths = rng.standard_normal((300, 1, 3)) * np.linspace(0.02, 1.0, 30)[:, None]
    assert np.array_equal(field.sample(paths).ravel(), field.sample(paths.reshape(-1, 3)))


def test_threads_do_not_change_the_result(rng):
    points = rng.uniform(-1, 1, (70_000, 3))  # three blocks
    field = volume_field(frame(), "signed_distance")
    assert np.array_equal(field.sample(points, threads=1), field.sample(points, threads=2))


def test_fields_are_functions_of_the_distance(rng):
    points = rng.uniform(-1.2, 1.2, (400, 3))
    distance = volume_field(box(), "signed_distance", width=math.inf).sample(points)
    soft = volume_field(box(), "signed_distance", width=0.2).sample(points)
    occupancy = volume_field(box(), "occupancy", width=0.1).sample(points)
    gauss = volume_field(box(), "gaussian_distance", width=0.3).sample(points)
    assert soft == pytest.approx(0.2 * np.tanh(distance / 0.2), abs=1e-14)
    assert occupancy == pytest.approx(0.5 - 0.5 * np.tanh(distance / 0.1), abs=1e-14)
    assert gauss == pytest.approx(np.exp(-(distance**2) / 0.18), abs=1e-14)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_flipped_faces_do_not_matter(rng, share):
    mesh = sphere(8)
    which = rng.random(len(mesh.triangles)) < share
    points = rng.uniform(-1.5, 1.5, (2000, 3))
    # Corners in another order: float32 may decide otherwise between triangles equally near.
    assert signs(turned(mesh, which), points) == pytest.approx(signs(mesh, points), abs=1e-6)


def test_faces_that_share_no_vertices_are_welded(rng):
    mesh = sphere(6)
    soup = MeshArrays(mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(3 * len(mesh.triangles)).reshape(-1, 3))
    points = rng.uniform(-1.5, 1.5, (500, 3))
    # Welding reorders nothing but which of two equally near triangles is found first.
    assert signs(soup, points) == pytest.approx(signs(mesh, points), abs=1e-6)


def test_soup_without_common_edges_keeps_its_inside(rng):
    """A box of twelve loose triangles, half of them turned, each moved outward a little: no edge is shared."""
    mesh = box((2.0, 2.0, 2.0))
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = corners + 0.004 * (normal / np.linalg.norm(normal, axis=1)[:, None])[:, None]
    corners[::2] = corners[::2, ::-1]
    loose = MeshArrays(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    points = rng.uniform(-1.6, 1.6, (2000, 3))
    points = points[np.abs(box_distance(points, 1.0)) > 0.1]
    assert np.array_equal(signs(loose, points) < 0, box_distance(points, 1.0) < 0)


def test_holes_are_closed():
    mesh = sphere(10)
    centroids = mesh.vertices[mesh.triangles].mean(axis=1)
    open_ = MeshArrays(mesh.vertices, mesh.triangles[(centroids[:, 2] < 0.8) & (centroids[:, 0] < 0.9)])
    points = 0.7 * fsh.fibonacci_grid(500).directions
    assert (signs(open_, points) < 0).all()
    assert (signs(open_, 1.6 * points) > 0).all()
    # The cap counts as surface: nothing jumps where the hole was.
    above = signs(open_, [[0, 0, 0.75], [0, 0, 0.85]])
    assert abs(above[1] - above[0]) < 0.11


def test_overlapping_and_nested_parts_count_once():
    parts = together(sphere(6), sphere(6, center=(0.8, 0, 0)), sphere(6, 0.4))
    inside = signs(parts, [[0.4, 0, 0], [0, 0, 0], [-0.7, 0, 0], [1.5, 0, 0]])
    assert (inside < 0).all()
    assert (signs(parts, [[0, 0, 1.3], [-1.2, 0, 0], [2.0, 0, 0]]) > 0).all()


def test_a_part_inside_that_is_wound_inward_is_a_cavity():
    inner = sphere(6, 0.5)
    hollow = together(sphere(8), turned(inner, slice(None)))
    values = signs(hollow, [[0, 0, 0.1], [0, 0, 0.75], [0, 0, 1.2]])
    assert values[0] > 0 > values[1]
    assert values[2] > 0


def test_far_apart_parts_turned_either_way():
    pair = together(sphere(6), turned(sphere(6, center=(5, 0, 0)), slice(None)))
    assert (signs(pair, [[0, 0, 0.2], [5, 0.2, 0]]) < 0).all()
    assert (signs(pair, [[2.5, 0, 0]]) > 0).all()


def test_cloud_with_normals_has_an_inside(rng):
    directions = fsh.fibonacci_grid(3000).directions
    points = rng.uniform(-1.3, 1.3, (500, 3))
    exact = np.linalg.norm(points, axis=1) - 1
    got = signs(PointArrays(directions, directions), points, center=np.zeros(3))
    assert np.abs(got - exact).max() < 0.02  # a cell of the Poisson grid
    turned_over = signs(PointArrays(directions, -directions), points, center=np.zeros(3))
    assert np.abs(turned_over - exact).max() < 0.02


def test_cloud_distance_is_to_the_nearest_point(rng):
    cloud = rng.standard_normal((50, 3))
    field = volume_field(PointArrays(cloud), "gaussian_distance", width=0.5)
    points = rng.uniform(-1, 1, (40, 3))
    nearest = np.linalg.norm(points[:, None] - (cloud - field.center) / field.scale, axis=2).min(axis=1)
    assert field.sample(points) == pytest.approx(np.exp(-2 * nearest**2), abs=1e-12)


def test_gaussian_of_a_cloud_is_zero_where_it_is_not_felt():
    field = volume_field(PointArrays(fsh.fibonacci_grid(2000).directions), "gaussian_distance", center=np.zeros(3))
    values = field.sample(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.45], [0.0, 0.0, 0.97]]))
    assert values[0] == 0  # ten widths away: not searched
    assert values[1] == pytest.approx(np.exp(-0.5 * 5.5**2), rel=0.05)
    assert values[2] > 0.9


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_frame_follows_scale_and_shift(size):
    field = volume_field(MeshArrays(sphere(8).vertices * size + 3 * size, sphere(8).triangles))
    assert field.center == pytest.approx([3 * size] * 3, rel=1e-9)  # the icosphere is symmetric
    assert field.scale == pytest.approx(size, rel=1e-9)
    assert field.reach == pytest.approx(1.0, rel=1e-12)


def test_centre_does_not_move_with_the_triangulation():
    coarse = box((1.0, 2.0, 3.0))
    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(coarse.vertices)),
        o3d.utility.Vector3iVector(coarse.triangles[:7].astype(np.int32)),
    )
    fine = legacy.subdivide_midpoint(2)
    rest = MeshArrays(coarse.vertices, coarse.triangles[7:])
    mixed = together(MeshArrays(np.asarray(fine.vertices), np.asarray(fine.triangles)), rest)
    assert volume_field(mixed, "gaussian_distance").center == pytest.approx(np.zeros(3), abs=1e-12)


SHEET = MeshArrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
TRIANGLE = MeshArrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
LINE = MeshArrays([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]])
POINT = MeshArrays([[1, 2, 3]] * 3, [[0, 1, 2]])


@pytest.mark.parametrize("mesh", [SHEET, TRIANGLE], ids=["sheet", "triangle"])
@pytest.mark.parametrize("field", ["signed_distance", "occupancy"])
def test_what_encloses_nothing_is_refused(mesh, field):
    with pytest.raises(GeometryError, match=r"encloses nothing.*gaussian_distance"):
        volume_field(mesh, field)
    assert volume_field(mesh, "gaussian_distance").sample(np.zeros((1, 3))).shape == (1,)


@pytest.mark.parametrize("mesh", [LINE, POINT], ids=["line", "point"])
@pytest.mark.parametrize("field", ["signed_distance", "gaussian_distance"])
def test_no_area_is_refused(mesh, field):
    with pytest.raises(GeometryError):
        volume_field(mesh, field)


def test_cloud_without_usable_normals_is_refused(rng):
    cloud = rng.standard_normal((100, 3))
    with pytest.raises(GeometryError, match="no normals"):
        volume_field(PointArrays(cloud), "occupancy")
    with pytest.raises(GeometryError, match="finite normals"):
        volume_field(PointArrays(cloud, np.zeros_like(cloud)))
    with pytest.raises(GeometryError, match="at least 10"):
        volume_field(PointArrays(cloud[:4], cloud[:4]))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"field": "distance"}, ValueError),
        ({"width": 0.0}, ValueError),
        ({"width": math.nan}, ValueError),
        ({"field": "occupancy", "width": math.inf}, ValueError),
        ({"width": "wide"}, TypeError),
        ({"scale": -1.0}, ValueError),
        ({"center": [0.0, 1.0]}, ValueError),
        ({"center": [0.0, 1.0, math.nan]}, ValueError),
    ],
)
def test_bad_options(options, error):
    with pytest.raises(error):
        volume_field(box(), **options)


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((2, 2)), np.full((1, 3), np.nan), np.zeros((0, 3))])
def test_bad_points(points):
    with pytest.raises(ValueError, match="points"):
        volume_field(box()).sample(points)
