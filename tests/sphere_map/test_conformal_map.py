import numpy as np
import pytest

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import MemoryEstimateError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.sphere_map.conformal_map import ConformalMapOption, conformal_map
from fsh3d_o3d.sphere_map.validity import degree, distortion, is_valid
from tests.geometry import mesh_shapes as shapes

CONFORMAL = ConformalMapOption(area_weight=0)


def tetrahedron():
    return MeshArrays(np.vstack((np.zeros(3), np.eye(3))), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def tube(length, around=8):
    """A closed tube of radius 1, with caps of one vertex each."""
    height, angle = (a.ravel() for a in np.meshgrid(np.arange(length + 1.0), np.arange(around), indexing="ij"))
    angle = 2 * np.pi * angle / around
    vertices = np.column_stack((np.cos(angle), np.sin(angle), height))
    k = np.arange(around)
    following = (k + 1) % around
    base = around * np.arange(length)[:, None]
    a, b, c, d = base + k, base + following, base + around + following, base + around + k
    sides = np.concatenate([np.column_stack([x.ravel() for x in t]) for t in ((a, b, c), (a, c, d))])
    n, last = len(vertices), len(vertices) - around
    caps = np.concatenate(
        (np.column_stack((n + 0 * k, following, k)), np.column_stack((n + 1 + 0 * k, last + k, last + following)))
    )
    return MeshArrays(np.vstack((vertices, [[0, 0, 0], [0, 0, length]])), np.concatenate((sides, caps)))


def with_slivers(mesh):
    """The mesh with a vertex on an edge of some triangles, which makes triangles without area."""
    vertices, triangles = mesh.vertices, mesh.triangles
    chosen = np.arange(0, len(triangles), 37)
    a, b, c = triangles[chosen].T
    new = len(vertices) + np.arange(len(chosen))
    added = (vertices[a] + vertices[b]) / 2
    parts = [np.column_stack(columns) for columns in ((a, b, new), (b, c, new), (c, a, new))]
    return MeshArrays(np.vstack((vertices, added)), np.concatenate((np.delete(triangles, chosen, axis=0), *parts)))


def check_valid(result):
    assert is_valid(result.positions, result.mesh.triangles)
    assert (result.flipped, result.degree) == (0, 1)
    np.testing.assert_allclose(np.linalg.norm(result.positions, axis=1), 1, rtol=1e-14)
    assert not result.source_vertices.flags.writeable


@pytest.mark.parametrize("area_weight", [0.0, ConformalMapOption().area_weight])
@pytest.mark.parametrize(
    "mesh",
    [
        tetrahedron(),
        shapes.box((1, 2, 3)),
        shapes.u_shape(),
        shapes.bumpy(8),
        shapes.soup(shapes.ell()),
        shapes.needles(40),
        with_slivers(shapes.bumpy(8)),
        shapes.moved(shapes.bumpy(6), scale=1e-100, offset=(1e-99, 0, 0)),
    ],
    ids=["tetrahedron", "box", "u", "bumpy", "soup", "needles", "slivers", "tiny"],
)
def test_closed_surfaces_map_one_to_one(mesh, area_weight):
    result = conformal_map(mesh, ConformalMapOption(area_weight=area_weight))
    check_valid(result)
    np.testing.assert_array_equal(mesh.vertices[result.source_vertices], result.mesh.vertices)
    unit = (result.mesh.vertices - result.mesh.vertices[0]) / result.mesh.diagonal
    measured = distortion(unit, result.mesh.triangles, result.positions)
    # The same surface at another scale: rounding, and half the digits where the ratio is near 1.
    assert result.distortion_mean == pytest.approx(measured.mean, rel=1e-8)
    assert result.distortion_99 == pytest.approx(measured.percentile_99, rel=1e-8)
    assert result.area_distortion == pytest.approx(measured.area, rel=1e-6, abs=1e-9)


def test_a_sphere_maps_to_itself():
    sphere = shapes.sphere(16, radius=3, center=(1, 2, 3))
    result = conformal_map(sphere, CONFORMAL)
    # The discrete map differs from the smooth one in second order of the edge length.
    np.testing.assert_allclose(result.positions, (sphere.vertices - (1, 2, 3)) / 3, atol=2e-4)
    assert result.method == "flow"
    assert result.balance_iterations == 0


def test_a_spheroid_maps_by_its_conformal_latitude():
    errors = []
    for frequency in (8, 16):
        mesh = shapes.ellipsoid((1, 1, 0.6), frequency)
        result = conformal_map(mesh, CONFORMAL)
        x, y, z = mesh.vertices.T
        # Snyder, Map Projections, Eq. 3-1: artanh sin χ = artanh sin φ − e artanh(e sin φ), φ the geodetic latitude.
        eccentricity = 0.8
        sine = np.sin(np.arctan2(z, np.hypot(x, y) * (1 - eccentricity**2)))
        inner = np.abs(sine) < 1 - 1e-12
        isometric = np.arctanh(sine[inner]) - eccentricity * np.arctanh(eccentricity * sine[inner])
        errors.append(np.abs(result.positions[inner, 2] - np.tanh(isometric)).max())
    # Second order in the edge length, 0.15 and 0.07.
    assert errors[1] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.3)


def test_refined_surfaces_map_more_conformally():
    coarse, fine = (conformal_map(shapes.bumpy(f), CONFORMAL) for f in (8, 16))
    # First order: triangles are flat.
    assert fine.distortion_mean - 1 == pytest.approx((coarse.distortion_mean - 1) / 2, rel=0.1)
    assert fine.distortion_99 < 1.05


def test_conformal_maps_are_centred():
    result = conformal_map(shapes.bumpy(10), CONFORMAL)
    corners = result.mesh.vertices[result.mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mean = area @ result.positions[result.mesh.triangles].mean(axis=1) / area.sum()
    np.testing.assert_allclose(mean, 0, atol=1e-11)


def test_balancing_evens_out_areas():
    mesh = shapes.ellipsoid((1, 1, 4), 10)
    conformal, balanced = (conformal_map(mesh, ConformalMapOption(area_weight=w)) for w in (0, 1))
    assert balanced.area_distortion < 0.5 * conformal.area_distortion
    assert conformal.distortion_mean < balanced.distortion_mean
    assert balanced.balance_iterations == 0  # done level by level
    further = conformal_map(mesh, ConformalMapOption(area_weight=1, balance_iterations=5))
    assert 0 < further.balance_iterations <= 5
    off = conformal_map(mesh, ConformalMapOption(area_weight=1, balance_iterations=0))
    np.testing.assert_array_equal(off.positions, balanced.positions)  # the default


@pytest.mark.parametrize(
    ("area_weight", "tolerance"),
    # Lengths of a rotated copy differ in the last digit; conjugate gradients and Newton's steps then stop elsewhere
    # within their tolerances.
    [(0.0, 1e-7), (1.0, 1e-5)],
)
def test_the_map_turns_with_the_surface(area_weight, tolerance, random_rotation):
    option = ConformalMapOption(area_weight=area_weight)
    mesh = shapes.bumpy(9)
    result = conformal_map(mesh, option)
    turned = conformal_map(shapes.moved(mesh, rotation=random_rotation, scale=7.0, offset=(20, -3, 5)), option)
    np.testing.assert_allclose(turned.positions, result.positions @ random_rotation.T, atol=tolerance)


def test_a_mirrored_surface_has_the_mirrored_map():
    mesh = shapes.bumpy(7)
    mirrored = conformal_map(MeshArrays(mesh.vertices * (-1, 1, 1), mesh.triangles), CONFORMAL)
    np.testing.assert_allclose(mirrored.positions * (-1, 1, 1), conformal_map(mesh, CONFORMAL).positions, atol=1e-7)


def test_inside_out_makes_no_difference():
    mesh = shapes.bumpy(7)
    inward = conformal_map(MeshArrays(mesh.vertices, mesh.triangles[:, (0, 2, 1)]), CONFORMAL)
    check_valid(inward)
    np.testing.assert_allclose(inward.positions, conformal_map(mesh, CONFORMAL).positions, atol=1e-7)


def test_the_same_input_gives_the_same_bytes():
    mesh = shapes.bumpy(9)
    assert conformal_map(mesh).positions.tobytes() == conformal_map(mesh).positions.tobytes()


def test_tangled_flows_are_untangled_or_embedded():
    methods = set()
    for length in (40, 80, 160):
        result = conformal_map(tube(length), ConformalMapOption(area_weight=0, balance_iterations=3))
        check_valid(result)
        methods.add(result.method)
        assert np.isfinite([result.distortion_mean, result.distortion_99, result.area_distortion]).all()
    assert methods == {"flow", "untangled", "embedding"}


def test_collapsing_flows_warn_of_nothing():
    # Warnings are errors here: a star of needles sends the flow through division by zero.
    mesh = shapes.sphere(2)
    spikes = np.where(np.arange(len(mesh.vertices)) % 3 == 0, 60.0, 1.0)
    check_valid(conformal_map(MeshArrays(mesh.vertices * spikes[:, None], mesh.triangles), CONFORMAL))


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_open3d_meshes(kind):
    mesh = shapes.bumpy(4)
    result = conformal_map(shapes.open3d_geometry(mesh, kind), CONFORMAL)
    np.testing.assert_array_equal(result.positions, conformal_map(mesh, CONFORMAL).positions)


def test_point_clouds_have_no_surface():
    with pytest.raises(TypeError, match="point cloud"):
        conformal_map(PointArrays(np.eye(3)))
    with pytest.raises(TypeError, match="point cloud"):
        conformal_map(open3d().geometry.PointCloud(open3d().utility.Vector3dVector(np.eye(3))))
    with pytest.raises(TypeError, match="ConformalMapOption"):
        conformal_map(shapes.box(), {"area_weight": 0})


@pytest.mark.parametrize(
    ("field", "value", "error"),
    [
        ("area_weight", -1, ValueError),
        ("area_weight", np.nan, ValueError),
        ("max_iterations", -1, ValueError),
        ("max_iterations", 2.5, TypeError),
        ("balance_iterations", -1, ValueError),
    ],
)
def test_options_are_checked(field, value, error):
    with pytest.raises(error, match=field):
        ConformalMapOption(**{field: value})


def test_huge_meshes_are_refused_before_anything_is_done():
    triangles = np.broadcast_to(np.array([[0, 1, 2]]), (20_000_000, 3))

    class Huge(MeshArrays):
        def __post_init__(self):
            pass

    with pytest.raises(MemoryEstimateError, match="20000000 triangles"):
        conformal_map(Huge(np.eye(3), triangles))


def test_degree_of_the_result_is_counted_not_claimed():
    result = conformal_map(shapes.bumpy(5))
    assert degree(-result.positions, result.mesh.triangles) == -result.degree
