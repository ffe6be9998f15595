import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.radial.star import star_center, star_report, visible_area
from tests.geometry import mesh_shapes as shapes


def polytope(seed, n=40):
    """The hull of random points and its half-spaces (normal, offset)."""
    points = np.random.default_rng(seed).normal(size=(n, 3)) * (1, 2, 0.7)
    hull = ConvexHull(points)
    triangles = hull.simplices
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return MeshArrays(points, np.where(inward[:, None], triangles[:, ::-1], triangles)), hull.equations


def chebyshev(equations):
    """Centre and radius of the largest ball in half-spaces n·x + d ≤ 0, by one programme over all of them."""
    count = len(equations)
    answer = linprog(
        [0, 0, 0, -1],
        A_ub=np.column_stack((equations[:, :3], np.ones(count))),
        b_ub=-equations[:, 3],
        bounds=[(None, None)] * 4,
    )
    return answer.x[:3], answer.x[3]


def face_equations(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return np.column_stack((normals, -np.einsum("ij,ij->i", normals, a)))


def test_the_kernel_of_a_box_is_the_box():
    best = star_center(shapes.moved(shapes.box((2, 4, 6)), offset=(7, 8, 9)))
    assert best.exact
    assert (best.visible_area, best.inside_fraction, best.missed, best.multiple) == (1, 1, 0, 0)
    # HiGHS meets its constraints to 1e-7 or so of the unit cube; in practice a vertex solution is exact to 1e-12.
    assert best.kernel_radius == pytest.approx(1, abs=1e-9)
    assert best.clearance == pytest.approx(1, abs=1e-9)
    assert best.center[0] == pytest.approx(7, abs=1e-9), "the thin side decides"


def test_the_kernel_of_a_regular_tetrahedron_is_its_insphere():
    vertices = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    mesh = MeshArrays(vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))
    best = star_center(mesh)
    assert best.exact
    assert best.kernel_radius == pytest.approx(np.sqrt(8) / np.sqrt(24), abs=1e-9)  # edge / √24
    np.testing.assert_allclose(best.center, 0, atol=1e-9)


def test_the_kernel_of_an_ell_is_the_cube_at_its_bend():
    best = star_center(shapes.ell())
    assert best.exact
    np.testing.assert_allclose(best.center, 0.5, atol=1e-9)
    assert best.kernel_radius == pytest.approx(0.5, abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_kernel_of_a_convex_body_is_the_body(seed):
    mesh, equations = polytope(seed)
    best = star_center(mesh)
    center, radius = chebyshev(equations)
    assert best.exact
    assert best.kernel_radius == pytest.approx(radius, rel=1e-7)
    # The ball is unique for a body in general position; its centre is as well determined as HiGHS's tolerance allows.
    np.testing.assert_allclose(best.center, center, atol=1e-5)


def test_cutting_planes_find_what_one_programme_over_all_faces_finds():
    mesh = shapes.bumpy(24)
    best = star_center(mesh)
    _, radius = chebyshev(face_equations(mesh))
    assert best.exact
    assert best.kernel_radius == pytest.approx(radius, rel=1e-6)


def test_the_u_has_no_kernel_and_the_best_point_beats_a_lattice():
    mesh = shapes.u_shape()
    best = star_center(mesh)
    assert not best.exact
    # x + R ≤ 1 and x − R ≥ 2 from the two inner walls.
    assert best.kernel_radius == pytest.approx(-0.5, abs=1e-9)
    assert best.clearance < 0
    x, y, z = np.meshgrid(np.arange(0.1, 3, 0.2), np.arange(0.1, 1, 0.1), [0.3, 0.5], indexing="ij")
    inside = np.column_stack((x.ravel(), y.ravel(), z.ravel()))
    lattice = max(visible_area(mesh, point) for point in inside)
    # The best points lie low in the corners between base and arms, between lattice points: the search must climb there.
    assert best.visible_area > lattice + 0.003
    assert best.center.min() > 0.01, "but not onto the surface"
    assert best.visible_area < 0.95
    assert best.multiple > 0


def test_what_a_point_in_one_arm_of_the_u_sees():
    # From the far end of an arm's axis, by hand: the planes of the other arm's inner wall face away.
    report = star_report(shapes.u_shape(), np.array([0.5, 1.5, 0.5]))
    # Inner sides: of the 22 unit squares, 2 have the point behind them: the right arm's inner wall (x = 2, y in 1 … 2)
    # and the floor of the notch (y = 1, x in 1 … 2).
    assert report.inside_fraction == pytest.approx(20 / 22, abs=1e-12)
    assert report.clearance == pytest.approx(-1.5)
    assert not report.exact
    assert report.visible_area < report.inside_fraction
    assert report.kernel_radius is None


def test_nested_spheres():
    inner, outer = shapes.sphere(12), shapes.sphere(12, radius=2)
    hidden = star_report(shapes.joined(inner, outer), np.zeros(3))
    # Every face looks outward, so all planes have the centre inside; yet the surface covers directions twice.
    assert hidden.inside_fraction == 1
    assert hidden.clearance > 0
    assert not hidden.exact
    assert (hidden.missed, hidden.multiple) == (0, 1)
    # Only the inner sphere is seen: 1 / (1 + 4). Samples are stratified by area: their number is exact to one or two.
    assert hidden.visible_area == pytest.approx(0.2, abs=1e-3)
    assert not star_center(shapes.joined(inner, outer)).exact


def test_a_centre_outside_sees_nothing_from_inside():
    report = star_report(shapes.sphere(8), np.array([5.0, 0, 0]))
    assert report.visible_area < 1e-3  # at most a sample or two on the silhouette
    assert report.missed > 0.9
    assert report.clearance < 0 and not report.exact


def test_orientation_and_shared_vertices_do_not_matter():
    mesh = shapes.bumpy(8)
    reference = star_center(mesh)
    for other in (MeshArrays(mesh.vertices, mesh.triangles[:, ::-1]), shapes.soup(mesh)):
        report = star_center(other)
        assert report.exact
        np.testing.assert_allclose(report.center, reference.center, atol=1e-7)
        assert report.kernel_radius == pytest.approx(reference.kernel_radius, rel=1e-7)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1.0, 1e30]), st.sampled_from([0.0, 1e6]))
def test_the_report_turns_scales_and_moves_with_the_surface(seed, scale, offset):
    mesh = shapes.bumpy(6)
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    before = star_center(mesh)
    after = star_center(shapes.moved(mesh, rotation=rotation, scale=scale, offset=offset * scale))
    assert after.exact
    # A far offset rounds coordinates to 1e-10; the programme's centre follows to its own tolerance.
    assert after.kernel_radius == pytest.approx(before.kernel_radius * scale, rel=1e-6)
    np.testing.assert_allclose(after.center / scale - offset, rotation @ before.center, atol=1e-5)
    assert (after.missed, after.multiple, after.visible_area) == (0, 0, 1)


def test_centroid_and_given_centres():
    mesh = shapes.ell()
    centroid = star_center(mesh, "centroid")
    np.testing.assert_allclose(centroid.center, (5 / 6, 5 / 6, 0.5), atol=1e-12)
    given_ = star_center(mesh, centroid.center)
    assert given_.clearance == pytest.approx(1 / 6) == pytest.approx(centroid.clearance)
    assert given_.exact and given_.kernel_radius is None


def test_open_surfaces_are_judged_by_rays_and_seen_from_within():
    ball = shapes.sphere(16)
    bowl = shapes.without(ball, ball.vertices[ball.triangles][:, :, 2].min(axis=1) > 0.6)
    best = star_center(bowl)
    assert not best.exact and best.kernel_radius is None
    assert best.visible_area > 0.99
    assert np.linalg.norm(best.center) < 1, "not from far above the hole, where all is visible and most directions miss"
    assert 0 < best.missed < 0.25
    np.testing.assert_allclose(star_center(bowl, "centroid").center[:2], 0, atol=1e-3)


def test_a_sheet_is_not_looked_at_from_afar():
    # From far above all of it is visible, and 95 % of directions miss it.
    best = star_center(shapes.waves())
    assert best.missed < 0.6
    assert best.visible_area > 0.4


def test_surfaces_that_cannot_be_oriented_still_get_a_report():
    report = star_report(shapes.mobius(), np.array([0.0, 0, 0.1]))
    assert (report.exact, report.inside_fraction, report.clearance) == (False, 0, None)
    assert 0 < report.visible_area <= 1
    assert star_center(shapes.mobius()).kernel_radius is None


def test_faces_without_area_have_no_say():
    mesh = shapes.box()
    middle = len(mesh.vertices)
    # A vertex halfway along an edge (0 – a) splits one triangle and leaves a flat one beside the other: still closed.
    a, b, c = mesh.triangles[0]
    vertices = np.vstack((mesh.vertices, (mesh.vertices[a] + mesh.vertices[b]) / 2))
    triangles = np.vstack((mesh.triangles[1:], [[a, middle, c], [middle, b, c], [a, b, middle]]))
    best = star_center(MeshArrays(vertices, triangles))
    assert best.kernel_radius == pytest.approx(0.5, abs=1e-9)
    assert best.exact


def test_the_same_mesh_gives_the_same_report():
    first, second = star_center(shapes.u_shape()), star_center(shapes.u_shape())
    np.testing.assert_array_equal(first.center, second.center)
    assert first.visible_area == second.visible_area


@pytest.mark.parametrize("center", [np.zeros(2), np.full(3, np.nan), "middle", None])
def test_other_centres_are_refused(center):
    with pytest.raises((ValueError, TypeError), match=r"center|method"):
        star_center(shapes.box(), center)


def test_a_flat_mesh_without_area_is_refused():
    with pytest.raises(GeometryError, match="no area"):
        star_center(MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]])))


def spiky(seed, amplitude):
    """A star-shaped surface by construction: every vertex of a ball moved along its own ray from the origin."""
    ball = shapes.sphere(12)
    radius = np.exp(amplitude * np.random.default_rng(seed).standard_normal((len(ball.vertices), 1)))
    return MeshArrays(ball.vertices * radius, ball.triangles)


@pytest.mark.parametrize(
    ("mesh", "center"),
    [
        (shapes.bumpy(20), np.zeros(3)),
        (shapes.ell(), np.full(3, 0.5)),
        (shapes.ellipsoid((1, 2, 3)), np.zeros(3)),
        (shapes.moved(shapes.ellipsoid((1, 5, 25)), offset=(30, 0, -7)), np.array([30.0, 0, -7])),
        (spiky(1, 0.05), np.zeros(3)),
        (spiky(2, 0.3), np.zeros(3)),
        (polytope(3)[0], np.zeros(3)),
    ],
    ids=["bumpy", "ell", "ellipsoid", "long and far away", "rough", "spiky", "polytope"],
)
def test_star_shapes_are_seen_whole_and_the_best_centre_sees_no_less(mesh, center):
    known, best = star_report(mesh, center), star_center(mesh)
    # Nearly star-shaped: 99.9 % of the surface seen, one meeting in 99.9 % of directions; half as much for samples.
    assert known.visible_area >= 0.9985
    assert known.missed + known.multiple <= 0.0015
    assert best.visible_area >= known.visible_area - 0.0005
