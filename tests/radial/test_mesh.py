import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.errors import GeometryError, NotStarShapedError
from fsh3d_o3d.geometry import MeshArrays, geometry_arrays
from fsh3d_o3d.geometry.rays import UnitScene
from fsh3d_o3d.radial.mesh import sample_radial
from fsh3d_o3d.sphere.grids import fibonacci_grid
from tests.geometry import mesh_shapes as shapes

ORIGIN = np.zeros(3)


def meetings(mesh, directions, center):
    """All distances (n, t) in float64 where direction and triangle meet, NaN elsewhere (Möller and Trumbore 1997)."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles] - center, 1, 0)
    p = np.cross(directions[:, None], (c - a)[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.einsum("tj,ntj->nt", b - a, p)
        u = np.einsum("tj,ntj->nt", -a, p) * inverse
        q = np.cross(-a, b - a)
        v = np.einsum("nj,tj->nt", directions, q) * inverse
        t = np.einsum("tj,tj->t", c - a, q) * inverse
        return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.nan)


def test_a_box_is_met_on_its_planes():
    size = np.array([1.0, 2, 3])
    directions = fibonacci_grid(5000).directions
    samples = sample_radial(shapes.box(size), directions, ORIGIN)
    truth = np.min(size / 2 / np.maximum(np.abs(directions), 1e-300), axis=1)
    # Computed in float64 from the triangle's plane; float32 alone would give 1e-7.
    np.testing.assert_allclose(samples.radii, truth, rtol=1e-14)
    assert samples.hit.all() and not samples.several.any()
    assert (samples.missed, samples.multiple) == (0, 0)


def test_rays_through_corners_and_edges_meet_once():
    corners = np.array(np.meshgrid(*3 * [[-1, 0, 1]])).reshape(3, -1).T
    directions = corners[corners.any(axis=1)] / np.linalg.norm(corners[corners.any(axis=1)], axis=1)[:, None]
    samples = sample_radial(shapes.box((2, 2, 2)), directions, ORIGIN)
    np.testing.assert_allclose(samples.radii, 1 / np.abs(directions).max(axis=1), rtol=1e-12)
    assert samples.hit.all() and not samples.several.any()
    sphere = shapes.sphere(16)
    on_vertices = sample_radial(sphere, sphere.vertices, ORIGIN)
    # A ray of float32 passes a vertex by 1e-7, where the next plane is less than 1e-8 away from the vertex.
    np.testing.assert_allclose(on_vertices.radii, 1, atol=1e-8)
    assert on_vertices.hit.all() and not on_vertices.several.any()


def test_radii_agree_with_rays_cast_in_float64():
    mesh, center = shapes.bumpy(10), np.array([0.1, -0.05, 0.07])
    directions = fibonacci_grid(400).directions
    samples = sample_radial(mesh, directions, center)
    np.testing.assert_allclose(samples.radii, np.nanmin(meetings(mesh, directions, center), axis=1), rtol=1e-12)


def test_an_ellipsoid_converges_to_its_radial_function():
    axes = np.array([1.0, 1.5, 2])
    directions = fibonacci_grid(2000).directions
    truth = 1 / np.linalg.norm(directions / axes, axis=1)
    coarse, fine = (
        np.abs(sample_radial(shapes.ellipsoid(axes, f), directions, ORIGIN).radii - truth).max() for f in (16, 32)
    )
    assert fine < 2e-3
    assert coarse / fine == pytest.approx(4, rel=0.2)  # second order in the edge length


def test_innermost_and_outermost_of_a_folded_surface():
    mesh, center = shapes.u_shape(), np.array([0.4, 1.6, 0.45])
    directions = fibonacci_grid(1500).directions
    all_meetings = meetings(mesh, directions, center)
    inner = sample_radial(mesh, directions, center, behaviour="innermost")
    outer = sample_radial(mesh, directions, center, behaviour="outermost")
    np.testing.assert_allclose(inner.radii, np.nanmin(all_meetings, axis=1), rtol=1e-12)
    np.testing.assert_allclose(outer.radii, np.nanmax(all_meetings, axis=1), rtol=1e-12)
    several = np.nanmax(all_meetings, axis=1) - np.nanmin(all_meetings, axis=1) > 1e-5
    np.testing.assert_array_equal(inner.several, several)
    assert inner.multiple == pytest.approx(several.mean()) == pytest.approx(outer.multiple)
    assert 0.05 < inner.multiple < 0.5


def test_a_thin_second_wall_is_told_from_a_repeated_one():
    sphere = shapes.sphere(8)
    directions = fibonacci_grid(300).directions
    assert sample_radial(shapes.joined(sphere, sphere), directions, ORIGIN).multiple == 0
    shell = shapes.joined(sphere, shapes.sphere(8, radius=1.001))
    assert sample_radial(shell, directions, ORIGIN, behaviour="outermost").multiple == 1
    assert sample_radial(shell, directions, ORIGIN, same=0.01).multiple == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1.0, 1e30]), st.sampled_from([0.0, 1e6]), st.booleans())
def test_radii_turn_scale_and_move_with_the_surface(seed, scale, offset, inside_out):
    mesh, center = shapes.bumpy(6), np.array([0.05, 0.1, 0.0])
    directions = fibonacci_grid(200).directions
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    before = sample_radial(mesh, directions, center).radii
    moved = shapes.moved(mesh, rotation=rotation, scale=scale, offset=offset * scale)
    if inside_out:
        moved = MeshArrays(moved.vertices, moved.triangles[:, ::-1])
    after = sample_radial(moved, directions @ rotation.T, rotation @ center * scale + offset * scale).radii / scale
    # Coordinates a million off are rounded to 1e-10. Rotated rays may fall just beyond an edge: 1e-7 of its bend.
    np.testing.assert_allclose(after, before, atol=1e-8)


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_both_kinds_of_open3d_geometry(kind):
    mesh = geometry_arrays(shapes.open3d_geometry(shapes.box(), kind))[0]
    assert sample_radial(mesh, np.eye(3), ORIGIN).radii.tolist() == [0.5, 0.5, 0.5]


def test_unused_vertices_do_not_widen_the_frame():
    mesh = shapes.box()
    far = MeshArrays(np.vstack((mesh.vertices, [[1e12, 0, 0]])), mesh.triangles)
    directions = fibonacci_grid(100).directions
    np.testing.assert_array_equal(
        sample_radial(far, directions, ORIGIN).radii, sample_radial(mesh, directions, ORIGIN).radii
    )


def test_needle_triangles_give_no_absurd_radii():
    directions = fibonacci_grid(3000).directions
    samples = sample_radial(shapes.needles(2000), directions, ORIGIN)
    rho = np.linalg.norm(directions[:, :2], axis=1)
    truth = np.minimum(1 / np.maximum(rho, 1e-12), 20 / np.abs(directions[:, 2]))
    # A 2000-gon is within 1.3e-6 of the circle; at the rim the ray may meet the other surface, as far as float32 goes.
    np.testing.assert_allclose(samples.radii, truth, rtol=5e-6)


def test_a_plane_seen_edge_on_does_not_make_up_a_radius():
    scene = UnitScene(np.array([[0.2, -0.1, 0], [0.4, 0, 1e-9], [0.2, 0.1, 0]]), np.array([[0, 1, 2]]))
    # In the plane, and a hair off it, where the plane is met far beyond the triangle.
    directions = np.array([[1, 0, 0], [1, 0, 1e-12], [1, 0, -1e-9]])
    np.testing.assert_array_equal(scene._refined(directions, np.full(3, 0.3), np.zeros(3, int)), 0.3)


def test_a_ray_that_slips_between_two_triangles_meets_what_is_beside():
    # A lid cut in two, 4e-7 apart: nothing of single precision lies between, but a ray does.
    gap = 2e-7
    lid = [[-1, -1, 1], [-gap, -1, 1], [-gap, 1, 1], [-1, 1, 1], [gap, -1, 1], [1, -1, 1], [1, 1, 1], [gap, 1, 1]]
    mesh = MeshArrays(np.array(lid, float), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    samples = sample_radial(mesh, np.array([[0, 0.6, 0.8], [0, 0, 1]]), ORIGIN)
    np.testing.assert_allclose(samples.radii, [1.25, 1], rtol=1e-14)
    assert samples.hit.all()


def test_the_default_error_says_how_far_and_what_to_do():
    with pytest.raises(NotStarShapedError) as caught:
        sample_radial(shapes.u_shape(), fibonacci_grid(1000).directions, np.array([0.5, 1.5, 0.5]))
    message = str(caught.value)
    assert "\n" not in message
    assert "(0.5, 1.5, 0.5): 0 % of directions never meet it" in message
    assert "% of its area is visible" in message
    for way in ('method="conformal"', 'method="shells"', 'behaviour="outermost"'):
        assert way in message
    assert "which lies outside" not in message


def test_a_centre_outside_is_called_that():
    with pytest.raises(NotStarShapedError, match=r"\(3, 0, 0\), which lies outside of it.*use another center"):
        sample_radial(shapes.sphere(8), fibonacci_grid(500).directions, np.array([3.0, 0, 0]))
    with pytest.raises(NotStarShapedError, match="outside"):
        sample_radial(shapes.torus(), fibonacci_grid(500).directions, ORIGIN, behaviour="outermost")


def test_a_surface_of_genus_one_is_not_sent_to_the_conformal_method():
    with pytest.raises(NotStarShapedError) as caught:
        sample_radial(shapes.frame(), fibonacci_grid(500).directions, np.full(3, 0.5))
    assert 'method="shells"' in str(caught.value)
    assert "conformal" not in str(caught.value)


def test_few_hidden_folds_pass_and_more_do_not():
    ball, pimple = shapes.sphere(24), shapes.sphere(6, radius=0.1, center=(0, 0, 1.2))
    mesh, directions = shapes.joined(ball, pimple), fibonacci_grid(20000).directions
    # The pimple takes (1 − cos asin(0.1 / 1.2)) / 2 = 0.17 % of directions and hides 1 % of the area.
    samples = sample_radial(mesh, directions, ORIGIN)
    assert samples.multiple == pytest.approx(0.0017, rel=0.05)
    assert samples.radii.max() == pytest.approx(1.3, abs=2e-3), "the outermost meeting"
    with pytest.raises(NotStarShapedError):
        sample_radial(mesh, directions, ORIGIN, accepted=0.001)
    with pytest.raises(NotStarShapedError):
        sample_radial(mesh, directions, ORIGIN, hidden=0.005)


def test_a_hole_is_filled_from_its_rim():
    ball = shapes.sphere(32)
    height = ball.vertices[ball.triangles][:, :, 2].mean(axis=1)
    bowl = shapes.without(ball, height > 0.9)
    directions = fibonacci_grid(4000).directions
    samples = sample_radial(bowl, directions, ORIGIN, behaviour="outermost")
    assert samples.missed == pytest.approx(0.05, abs=0.005)
    # Filled radii lie between those of the rim: all faces of the sphere are within its inradius.
    np.testing.assert_allclose(samples.radii, 1, atol=2e-3)
    with pytest.raises(NotStarShapedError, match="% of directions never meet it"):
        sample_radial(bowl, directions, ORIGIN)
    with pytest.raises(NotStarShapedError):
        sample_radial(bowl, directions, ORIGIN, behaviour="outermost", fillable=0.01)


def test_a_filled_hole_is_smooth():
    # On an ellipsoid the rim's radii vary; a harmonic fill follows them, nearest-neighbour filling would jump.
    axes = np.array([1.0, 1.4, 1])
    body = shapes.ellipsoid(axes, 32)
    towards = np.array([0, 0.6, 0.8])
    center_directions = body.vertices[body.triangles].mean(axis=1)
    center_directions /= np.linalg.norm(center_directions, axis=1)[:, None]
    directions = fibonacci_grid(6000).directions
    open_body = shapes.without(body, center_directions @ towards > np.cos(np.radians(12)))
    samples = sample_radial(open_body, directions, ORIGIN, behaviour="innermost")
    truth = 1 / np.linalg.norm(directions / axes, axis=1)
    assert not samples.hit.all()
    rim = (directions @ towards > np.cos(np.radians(15))) & samples.hit
    filled = samples.radii[~samples.hit]
    assert samples.radii[rim].min() <= filled.min() and filled.max() <= samples.radii[rim].max()
    # Curvature of r over 12°: about 0.4·(12° in radians)² / 2.
    np.testing.assert_allclose(filled, truth[~samples.hit], atol=0.01)


def test_coinciding_directions_are_filled_too():
    ball = shapes.sphere(8)
    bowl = shapes.without(ball, ball.vertices[ball.triangles][:, :, 2].mean(axis=1) > 0.95)
    directions = np.vstack((np.tile([0.0, 0, 1], (20, 1)), fibonacci_grid(2000).directions))
    samples = sample_radial(bowl, directions, ORIGIN, behaviour="outermost")
    np.testing.assert_allclose(samples.radii, 1, atol=0.02)  # the coarse sphere's inradius


def test_nothing_to_meet_is_an_error_whatever_is_allowed():
    patch = MeshArrays(np.array([[1.0, 0, 0], [1, 1e-3, 0], [1, 0, 1e-3]]), np.array([[0, 1, 2]]))
    with pytest.raises(NotStarShapedError, match="100 % of directions never meet it"):
        sample_radial(patch, -np.eye(3), ORIGIN, behaviour="outermost", fillable=1.0)


def test_the_same_request_gives_the_same_bytes():
    directions = fibonacci_grid(3000).directions
    first = sample_radial(shapes.bumpy(12), directions, ORIGIN)
    second = sample_radial(shapes.bumpy(12), directions, ORIGIN)
    assert first.radii.tobytes() == second.radii.tobytes()
    assert not first.radii.flags.writeable


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"directions": np.ones((4, 3))}, "unit vectors"),
        ({"directions": np.ones(3)}, "shape"),
        ({"center": np.zeros(2)}, "center"),
        ({"center": np.array([0, np.inf, 0])}, "finite"),
        ({"behaviour": "nearest"}, "behaviour"),
        ({"accepted": 2}, "accepted"),
        ({"hidden": -0.1}, "hidden"),
        ({"fillable": np.nan}, "fillable"),
        ({"same": -1}, "same"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    call = {"directions": np.eye(3), "center": ORIGIN} | arguments
    with pytest.raises(ValueError, match=message):
        sample_radial(shapes.box(), **call)


def test_a_mesh_without_extent_is_refused():
    with pytest.raises(GeometryError, match="no extent"):
        sample_radial(MeshArrays(np.ones((3, 3)), np.array([[0, 1, 2]])), np.eye(3), np.ones(3))
