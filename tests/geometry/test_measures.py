import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, geometry_arrays
from fsh3d_o3d.geometry.measures import area_samples, enclosed_volume, measure_mesh, oriented, weld
from tests.geometry import mesh_shapes as shapes


@pytest.mark.parametrize(
    ("mesh", "area", "volume", "centroid", "genus"),
    [
        (shapes.box((1, 2, 3)), 22, 6, (0, 0, 0), 0),
        (shapes.ell(), 14, 3, (5 / 6, 5 / 6, 0.5), 0),
        (shapes.u_shape(), 22, 5, (1.5, 0.9, 0.5), 0),
        (shapes.frame(), 32, 8, (1.5, 1.5, 0.5), 1),
    ],
)
def test_cubes_measure_what_they_must(mesh, area, volume, centroid, genus):
    m = measure_mesh(mesh)
    # Sums of a few dozen numbers of order one: some ulps.
    assert m.area == pytest.approx(area, rel=1e-14)
    assert m.volume == pytest.approx(volume, rel=1e-14)
    np.testing.assert_allclose(m.volume_centroid, centroid, rtol=1e-13, atol=1e-14)
    assert m.genus == genus
    assert m.euler_number == 2 - 2 * genus
    assert (m.components, m.degenerate_triangles) == (1, 0)
    assert m.closed and m.edge_manifold and m.vertex_manifold and m.orientable and m.consistently_oriented and m.outward
    assert m.diagonal == pytest.approx(mesh.diagonal, rel=1e-15)


def test_the_area_centroid_is_that_of_the_surface():
    m = measure_mesh(shapes.without(shapes.box(), np.arange(12) < 0))
    np.testing.assert_allclose(m.area_centroid, 0, atol=1e-16)
    top = shapes.box()
    above = top.vertices[top.triangles][:, :, 2].min(axis=1) > 0
    # Five faces of the unit cube: the missing one at z = 1/2 moves the centroid to −(1/2)/5.
    np.testing.assert_allclose(measure_mesh(shapes.without(top, above)).area_centroid, (0, 0, -0.1), atol=1e-15)


def test_a_sphere_approaches_its_area_and_volume_from_below():
    coarse, fine = measure_mesh(shapes.sphere(20)), measure_mesh(shapes.sphere(40))
    for value, truth in ((fine.area, 4 * np.pi), (fine.volume, 4 / 3 * np.pi)):
        assert 0.999 * truth < value < truth
    # The error is of second order in the edge length.
    ratio = (4 / 3 * np.pi - coarse.volume) / (4 / 3 * np.pi - fine.volume)
    assert ratio == pytest.approx(4, rel=0.01)


def test_a_torus_has_one_handle():
    m = measure_mesh(shapes.torus())
    assert (m.genus, m.euler_number, m.outward) == (1, 0, True)


def test_turned_inside_out():
    mesh = shapes.box()
    m = measure_mesh(MeshArrays(mesh.vertices, mesh.triangles[:, ::-1]))
    assert m.volume == pytest.approx(-1)
    assert m.consistently_oriented and not m.outward
    np.testing.assert_allclose(m.volume_centroid, 0, atol=1e-16)


def test_one_triangle_wound_the_wrong_way():
    mesh = shapes.bumpy(4)
    triangles = mesh.triangles.copy()
    triangles[7] = triangles[7, ::-1]
    wrong = MeshArrays(mesh.vertices, triangles)
    m = measure_mesh(wrong)
    assert m.orientable and not m.consistently_oriented and not m.outward
    assert m.volume is None and m.volume_centroid is None
    assert m.genus == 0
    repaired = measure_mesh(oriented(wrong))
    assert repaired.outward
    assert repaired.volume == pytest.approx(measure_mesh(mesh).volume, rel=1e-15)
    assert enclosed_volume(wrong) == pytest.approx(repaired.volume, rel=1e-15)


def test_orienting_keeps_what_is_right_and_turns_over_what_is_inside_out():
    mesh = shapes.frame()
    assert oriented(mesh) is mesh
    inside_out = MeshArrays(mesh.vertices, mesh.triangles[:, ::-1])
    assert measure_mesh(oriented(inside_out)).volume == pytest.approx(8)
    hollow = shapes.joined(shapes.box((2, 2, 2)), MeshArrays(shapes.box().vertices, shapes.box().triangles[:, ::-1]))
    assert measure_mesh(oriented(hollow)).volume == pytest.approx(7), "a cavity stays a cavity"


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_set_of_turned_triangles_is_found(seed):
    mesh = shapes.torus(n=12, m=8)
    turned = np.random.default_rng(seed).random(len(mesh.triangles)) < 0.4
    m = MeshArrays(mesh.vertices, np.where(turned[:, None], mesh.triangles[:, ::-1], mesh.triangles))
    result = measure_mesh(oriented(m))
    assert result.outward
    assert result.volume == pytest.approx(measure_mesh(mesh).volume, rel=1e-13)


def test_a_mobius_band_cannot_be_oriented():
    m = measure_mesh(shapes.mobius())
    assert m.edge_manifold and m.vertex_manifold and not m.closed
    assert not m.orientable and not m.consistently_oriented
    assert (m.euler_number, m.genus, m.volume) == (0, None, None)
    assert oriented(shapes.mobius()) is None
    assert enclosed_volume(shapes.mobius()) is None


def test_an_open_box_is_a_disk():
    mesh = shapes.box()
    m = measure_mesh(shapes.without(mesh, np.arange(12) == 3))
    assert (m.closed, m.edge_manifold, m.vertex_manifold, m.outward) == (False, True, True, False)
    assert (m.euler_number, m.genus, m.volume, m.volume_centroid) == (1, None, None, None)


def test_cubes_that_share_an_edge_or_a_corner_are_not_manifold():
    edge = measure_mesh(shapes.voxels([[[1], [0]], [[0], [1]]]))
    assert not edge.edge_manifold and not edge.closed and edge.components == 1
    assert edge.volume == pytest.approx(2), "every edge is still balanced"
    corner = measure_mesh(shapes.voxels([[[1, 0], [0, 0]], [[0, 0], [0, 1]]]))
    assert corner.closed and corner.edge_manifold and not corner.vertex_manifold
    assert (corner.components, corner.genus, corner.euler_number) == (1, None, 3)


def test_parts_are_counted():
    m = measure_mesh(shapes.joined(shapes.box(), shapes.sphere(2, center=(5, 0, 0)), shapes.torus(n=8, m=6)))
    assert (m.components, m.euler_number, m.genus) == (3, 4, None)
    assert m.outward


def test_degenerate_triangles_are_counted_and_do_not_disturb():
    mesh = shapes.box()
    n = len(mesh.vertices)
    vertices = np.vstack((mesh.vertices, [[9.0, 9, 9]]))  # used by nothing
    triangles = np.vstack((mesh.triangles, [[0, 0, 1], [2, 2, 2]]))
    m = measure_mesh(MeshArrays(vertices, triangles))
    assert (m.degenerate_triangles, m.genus, m.components, m.closed) == (2, 0, 1, True)
    assert m.diagonal == pytest.approx(np.sqrt(3))
    assert len(weld(MeshArrays(vertices, triangles)).vertices) == n
    line = MeshArrays(
        np.array([[0.1, 0.1, 0], [0.2, 0.2, 0], [0.3, 0.3, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    assert measure_mesh(line).degenerate_triangles == 1


@pytest.mark.parametrize("triangles", [[[0, 0, 1]], [[0, 1, 2]]])
def test_a_mesh_without_area_is_refused(triangles):
    mesh = MeshArrays(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), np.array(triangles))
    with pytest.raises(GeometryError, match="no area"):
        measure_mesh(mesh)
    with pytest.raises(GeometryError, match="no area"):
        area_samples(mesh, 10)


def test_a_mesh_without_extent_is_refused():
    with pytest.raises(GeometryError, match="no extent"):
        measure_mesh(MeshArrays(np.ones((3, 3)), np.array([[0, 1, 2]])))


def test_welding_a_soup_restores_the_mesh():
    mesh = shapes.bumpy(6)
    welded = weld(shapes.soup(mesh))
    assert len(welded.vertices) == len(mesh.vertices)
    np.testing.assert_array_equal(welded.vertices[welded.triangles], mesh.vertices[mesh.triangles])
    assert measure_mesh(welded).genus == 0
    assert measure_mesh(shapes.soup(mesh)).components == len(mesh.triangles)


def test_welding_is_exact_and_keeps_the_order():
    near = np.nextafter(1.0, 2.0)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [-0.0, 0, 0], [near, 0, 0], [0, 1, 0], [1, 0, 0]])
    welded = weld(MeshArrays(vertices, np.array([[4, 5, 2], [3, 4, 0], [0, 2, 4]])))
    np.testing.assert_array_equal(welded.vertices, [[0, 0, 0], [near, 0, 0], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(welded.triangles, [[2, 3, 0], [1, 2, 0]])
    assert weld(welded).vertices.tolist() == welded.vertices.tolist()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1e-3, 1.0, 1e30]))
def test_measures_turn_and_scale_with_the_mesh(seed, scale):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    before = measure_mesh(shapes.bumpy(5))
    after = measure_mesh(shapes.moved(shapes.bumpy(5), rotation=rotation, scale=scale))
    # The rotation itself rounds each vertex by an ulp.
    assert after.area == pytest.approx(before.area * scale**2, rel=1e-13)
    assert after.volume == pytest.approx(before.volume * scale**3, rel=1e-13)
    np.testing.assert_allclose(after.area_centroid / scale, rotation @ before.area_centroid, atol=1e-14)
    np.testing.assert_allclose(after.volume_centroid / scale, rotation @ before.volume_centroid, atol=1e-14)
    assert after.genus == 0


def test_a_far_off_origin_costs_no_more_than_the_rounding_of_the_coordinates():
    offset = np.array([1e6, -2e6, 3e6])
    near, far = measure_mesh(shapes.ell()), measure_mesh(shapes.moved(shapes.ell(), offset=offset))
    # Integer coordinates move without rounding, so the sums are the same to the last digits.
    assert far.volume == pytest.approx(near.volume, rel=1e-14)
    np.testing.assert_allclose(far.volume_centroid - offset, near.volume_centroid, atol=1e-9)  # ulp of 3e6: 5e-10


def test_coordinates_at_the_end_of_float64_do_not_overflow_on_the_way():
    m = measure_mesh(shapes.moved(shapes.box(), scale=1e100))
    assert m.volume == pytest.approx(1e300)
    assert np.isinf(measure_mesh(shapes.moved(shapes.box(), scale=1.5e308)).volume)
    np.testing.assert_allclose(
        measure_mesh(shapes.moved(shapes.box(), scale=1.5e308)).area_centroid / 1e308, 0, atol=1e-15
    )


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_open3d_agrees(kind):
    mesh = shapes.torus()
    legacy = shapes.open3d_geometry(mesh, "legacy")
    arrays, _ = geometry_arrays(shapes.open3d_geometry(mesh, kind))
    m = measure_mesh(arrays)
    # Open3D sums in float64 too; only the order differs.
    assert m.area == pytest.approx(legacy.get_surface_area(), rel=1e-12)
    assert m.volume == pytest.approx(legacy.get_volume(), rel=1e-12)
    assert m.euler_number == legacy.euler_poincare_characteristic()
    assert m.vertex_manifold == legacy.is_vertex_manifold()


def test_samples_are_even_over_the_area_and_repeatable():
    mesh = shapes.box((1, 2, 4))
    points, triangles = area_samples(mesh, 7000, seed=3)
    again, _ = area_samples(mesh, 7000, seed=3)
    other, _ = area_samples(mesh, 7000, seed=4)
    np.testing.assert_array_equal(points, again)
    assert not np.array_equal(points, other)
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    # One sample in each of 7000 equal shares: a triangle's count is within one or two of its share.
    assert np.abs(np.bincount(triangles, minlength=12) - 7000 * area / area.sum()).max() < 2
    surface = np.abs(np.abs(points) - np.array([0.5, 1, 2])).min(axis=1)
    assert surface.max() < 1e-15
    # Even within triangles too: moments of a low-discrepancy sequence.
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=2e-3)
    one = area_samples(MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])), 4000)[0]
    # Independent random points would be off by 2 % here (one standard deviation).
    assert np.square(one[:, 0]).mean() == pytest.approx(1 / 6, rel=5e-3)
