import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import area_samples
from fsh3d_o3d.geometry.surface_comparison import point_triangle_distance, surface_error, vertex_distances
from tests.geometry import mesh_shapes as shapes

SAMPLES = 20_000


@pytest.mark.parametrize("mesh", [shapes.bumpy(24), shapes.torus(), shapes.frame(), shapes.soup(shapes.bumpy(12))])
def test_equal_meshes_are_equal_to_rounding(mesh):
    error = surface_error(mesh, mesh, samples=SAMPLES)
    # A point on a triangle, put together from its corners, is off by an ulp or two.
    assert error.rmse < 3e-16 * error.diagonal
    assert error.maximum < 1e-15 * error.diagonal
    assert error.volume_error in (0, None)


def test_remeshing_without_change_is_seen_as_none():
    box = shapes.box()
    finer = shapes.voxels(np.ones((3, 3, 3)))
    finer = MeshArrays(finer.vertices / 3 - 0.5, finer.triangles)
    error = surface_error(box, finer, samples=SAMPLES)
    assert error.maximum < 1e-15
    assert error.volume_error < 1e-14


@pytest.mark.parametrize("gap", [1e-1, 1e-4, 1e-8, 1e-12])
def test_concentric_spheres_are_their_gap_apart(gap):
    inner, outer = shapes.sphere(24), shapes.sphere(24, radius=1 + gap)
    error = surface_error(inner, outer, samples=SAMPLES)
    # The facets scale with the radius: face to face the gap shrinks by the cosine of half a facet, at most 0.1 %.
    # A gap of 1e-12 is known to its rounding, 2e-16.
    assert error.rmse == pytest.approx(gap, rel=2e-3)
    assert error.mae == pytest.approx(gap, rel=2e-3)
    assert error.maximum == pytest.approx(gap, rel=2e-3)
    # (1 + gap)³ − 1, from a difference of volumes that keeps 15 digits.
    assert error.volume_error == pytest.approx((1 + gap) ** 3 - 1, rel=1e-9, abs=3e-15)
    relative = error.relative()
    assert relative.rmse == pytest.approx(error.rmse / error.diagonal)
    assert relative.maximum == pytest.approx(error.maximum / error.diagonal)
    assert (relative.diagonal, relative.volume_error) == (1, error.volume_error)


def test_both_sides_weigh_the_same():
    # A small plate h above the middle of a large one: from the small plate every distance is h, from the large one most
    # are about the distance to the small one's rim.
    def plate(half, z):
        corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
        return MeshArrays(corners, np.array([[0, 1, 2], [0, 2, 3]]))

    h, half = 0.3, 2.0
    large, small = plate(half, 0), plate(0.5, h)
    axis = (np.arange(800) + 0.5) / 800 * 2 * half - half
    beyond = np.maximum(np.abs(axis) - 0.5, 0)
    distance = np.sqrt(beyond[:, None] ** 2 + beyond[None] ** 2 + h * h)  # midpoint rule over the large plate
    error = surface_error(large, small, samples=50_000)
    assert error.mae == pytest.approx((distance.mean() + h) / 2, rel=1e-3)
    assert error.rmse == pytest.approx(np.sqrt((np.square(distance).mean() + h * h) / 2), rel=1e-3)
    # Vertices are measured too, so the corners' distance is found exactly.
    assert error.maximum == pytest.approx(np.sqrt(2 * 1.5**2 + h * h), rel=1e-14)
    swapped = surface_error(small, large, samples=50_000)
    assert swapped.rmse == pytest.approx(error.rmse, rel=1e-12)
    assert swapped.diagonal == pytest.approx(np.sqrt(2))
    assert error.volume_error is None


def test_distances_agree_with_every_triangle_in_turn():
    rng = np.random.default_rng(5)
    mesh, points = shapes.bumpy(5), rng.normal(size=(150, 3))
    corners = mesh.vertices[mesh.triangles]
    each = [point_triangle_distance(np.broadcast_to(point, (len(corners), 3)), corners).min() for point in points]
    np.testing.assert_allclose(vertex_distances(PointArrays(points), mesh), each, rtol=1e-12)


@pytest.mark.parametrize("aspect", [100, 300])
def test_needles_are_measured_like_any_other_triangle(aspect):
    # Single precision misplaces the closest point of such a needle so far that its twin, a gap away, seems closer.
    mesh = shapes.needle_soup(aspect, gap=1e-5)
    error = surface_error(mesh, mesh, samples=SAMPLES)
    assert error.maximum < 1e-16 * aspect  # the normal of a needle loses digits with its aspect
    prism = shapes.needles(aspect)
    apothem = np.cos(np.pi / aspect)
    heights, gaps = np.linspace(-15, 15, 500), np.linspace(-0.2, 0.5, 500)
    middle = 2 * np.pi * (np.random.default_rng(0).integers(0, aspect, 500) + 0.5) / aspect
    points = np.column_stack(((apothem + gaps) * np.cos(middle), (apothem + gaps) * np.sin(middle), heights))
    np.testing.assert_allclose(vertex_distances(PointArrays(points), prism), np.abs(gaps), atol=1e-13)


def test_points_beside_an_edge_are_measured_to_the_right_side_of_it():
    # 3e-8 of a triangle's width from its edge, where single precision cannot tell the triangles apart.
    mesh, aside = shapes.bumpy(24), 3e-8
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    share = np.random.default_rng(0).random((len(a), 1))
    points = (a * share + b * (1 - share)) * (1 - aside) + c * aside
    assert vertex_distances(PointArrays(points), mesh).max() < 1e-15


def test_point_triangle_distances_by_hand():
    triangle = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    points = np.array([[0.5, 0.5, 3], [-1, -1, 0], [1, -2, 0], [2, 2, 0], [3, 0, 1], [0.2, 0.3, 0], [-3, 1, 4]])
    truth = [3, np.sqrt(2), 2, np.sqrt(2), np.sqrt(2), 0, 5]
    np.testing.assert_allclose(point_triangle_distance(points, np.tile(triangle, (7, 1, 1))), truth, atol=1e-15)
    flat = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1.0, 1, 1], [1, 1, 1], [1, 1, 1]]])
    np.testing.assert_allclose(point_triangle_distance(np.array([[1.5, 2, 0], [1, 1, 3]]), flat), [2, 2], atol=1e-15)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_point_triangle_distance_is_the_least_over_the_triangle(seed):
    rng = np.random.default_rng(seed)
    point, triangle = rng.normal(size=3), rng.normal(size=(3, 3))
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101)))
    u, v = u[u + v <= 1], v[u + v <= 1]
    on = triangle[0] + u[:, None] * (triangle[1] - triangle[0]) + v[:, None] * (triangle[2] - triangle[0])
    brute = np.linalg.norm(on - point, axis=1).min()
    exact = point_triangle_distance(point[None], triangle[None])[0]
    size = np.ptp(triangle, axis=0).max()
    assert exact <= brute + 1e-12
    assert brute - exact <= 0.02 * size  # the lattice's spacing


def test_points_are_measured_one_way():
    ball = shapes.sphere(24)
    points = np.random.default_rng(1).normal(size=(3000, 3))
    points *= 1.05 / np.linalg.norm(points, axis=1)[:, None]
    half = PointArrays(points[points[:, 2] > 0])
    for error in (surface_error(half, ball), surface_error(ball, half)):
        # Facets of this sphere lie up to 0.1 % inside; what the cloud does not cover does not count.
        assert error.rmse == pytest.approx(0.05, abs=1.5e-3)
        assert error.maximum < 0.052
        assert error.volume_error is None
    assert surface_error(half, ball).diagonal == half.diagonal


def test_two_clouds_are_measured_to_their_nearest_points():
    one = PointArrays(np.array([[0.0, 0, 0], [1, 0, 0]]))
    two = PointArrays(np.array([[0.0, 0, 0], [1, 0, 0], [1, 3, 0]]))
    error = surface_error(one, two)
    assert error.maximum == 3
    assert error.mae == pytest.approx((0 + 3 / 3) / 2)
    assert error.rmse == pytest.approx(np.sqrt((0 + 9 / 3) / 2))


def test_volume_errors():
    box = shapes.box()
    grown = shapes.box((1, 1, 1.25))
    assert surface_error(box, grown, samples=100).volume_error == pytest.approx(0.25, rel=1e-13)
    inside_out = MeshArrays(grown.vertices, grown.triangles[:, ::-1])
    assert surface_error(box, inside_out, samples=100).volume_error == pytest.approx(0.25, rel=1e-13)
    assert surface_error(shapes.soup(box), grown, samples=100).volume_error == pytest.approx(0.25, rel=1e-13)
    open_box = shapes.without(box, np.arange(12) == 0)
    assert surface_error(open_box, grown, samples=100).volume_error is None
    assert surface_error(grown, open_box, samples=100).volume_error is None


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1.0, 1e30]), st.sampled_from([0.0, 1e6]))
def test_errors_scale_turn_and_move_with_the_surfaces(seed, scale, offset):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    pair = shapes.bumpy(6), shapes.ellipsoid((1, 1.1, 0.9), 5)
    before = surface_error(*pair, samples=2000)
    after = surface_error(
        *(shapes.moved(mesh, rotation=rotation, scale=scale, offset=offset * scale) for mesh in pair), samples=2000
    )
    # A far offset rounds coordinates to 1e-10; the samples are the same barycentric points, up to a tie of shares.
    for name in ("rmse", "mae", "maximum"):
        assert getattr(after, name) == pytest.approx(getattr(before, name) * scale, rel=1e-5)
    assert after.volume_error == pytest.approx(before.volume_error, abs=1e-8)


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_both_kinds_of_open3d_geometry(kind):
    pair = shapes.bumpy(5), shapes.sphere(5)
    arrays = surface_error(*pair, samples=1000)
    assert surface_error(*(shapes.open3d_geometry(mesh, kind) for mesh in pair), samples=1000) == arrays


def test_the_same_seed_gives_the_same_figures_and_another_similar_ones():
    pair = shapes.bumpy(12), shapes.sphere(12)
    first, second = surface_error(*pair, samples=SAMPLES), surface_error(*pair, samples=SAMPLES)
    assert first == second
    other = surface_error(*pair, samples=SAMPLES, seed=1)
    assert other != first
    assert other.rmse == pytest.approx(first.rmse, rel=2e-3)


def test_vertex_distances_for_colour_maps():
    ball, box = shapes.sphere(6, radius=3), shapes.box((2, 2, 2))
    outside = np.maximum(np.abs(ball.vertices) - 1, 0)
    np.testing.assert_allclose(vertex_distances(ball, box), np.linalg.norm(outside, axis=1), rtol=1e-13)
    on_surface = area_samples(box, 500)[0]
    assert vertex_distances(PointArrays(on_surface), box).max() < 1e-15
    cloud = PointArrays(np.array([[0.0, 0, 0]]))
    np.testing.assert_allclose(vertex_distances(ball, cloud), 3, rtol=1e-15)


def test_what_cannot_be_measured_is_refused():
    box = shapes.box()
    with pytest.raises(FileNotFoundError):
        surface_error(box, "no such box.obj")
    with pytest.raises(TypeError, match="TriangleMesh or PointCloud"):
        surface_error(box, 1.0)
    with pytest.raises(ValueError, match="samples"):
        surface_error(box, box, samples=0)
    line = MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 0, 1]]))
    for pair in ((box, line), (line, box)):
        with pytest.raises(GeometryError, match="no area"):
            surface_error(*pair)
    with pytest.raises(GeometryError, match="no extent"):
        surface_error(PointArrays(np.ones((2, 3))), PointArrays(np.ones((1, 3))))
