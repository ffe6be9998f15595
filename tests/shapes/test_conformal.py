"""ConformalShape: encode over a map, decode, smooth, levels of detail, attributes, files; both kinds of geometry."""

from __future__ import annotations

import dataclasses
import pickle
from types import SimpleNamespace

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError, GeometryReadError, MemoryEstimateError
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.geometry.surface_comparison import surface_error
from fsh3d_o3d.sphere.transform import evaluate
from tests.geometry import mesh_shapes as shapes

OCTAHEDRON = MeshArrays(
    np.vstack((np.eye(3), -np.eye(3))),
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
)
AXES = np.array([1.0, 2.0, 0.5])


def linear(matrix, center=(0.0, 0.0, 0.0)):
    """Coefficients of x(ω) = A ω + center."""
    identity = np.zeros((3, 4))
    identity[[0, 1, 2], [3, 1, 2]] = np.sqrt(4 * np.pi / 3)  # orders 1, −1, 0 of degree 1 are x, y, z
    coefficients = np.asarray(matrix) @ identity
    coefficients[:, 0] = np.asarray(center) * np.sqrt(4 * np.pi)
    return coefficients


def bent(bandwidth=12):
    """Coefficients of a bent, bumpy body that is not star-shaped from its middle, but without folds."""
    transform = fsh.SphericalHarmonicTransform(bandwidth)
    x, y, z = transform.grid.directions.T
    radius = 0.4 + 0.05 * np.cos(3 * x + y)
    positions = np.stack([1.5 * x, radius * y + 3 * x**2, radius * z])
    return transform.forward(positions + np.array([[5.0], [-2], [1]]))


@pytest.fixture(scope="module")
def shape():
    return fsh.ConformalShape(bent())


@pytest.fixture(scope="module")
def star():
    """A star-shaped surface of degree 8, and its mesh."""
    degree, _ = fsh.degrees_and_orders(9)
    coefficients = np.random.default_rng(3).standard_normal(81) * 0.15 / (1 + degree) ** 2
    coefficients[0] = np.sqrt(4 * np.pi)
    return fsh.RadialShape(coefficients, np.zeros(3)).mesh_arrays(5000)[0]


def test_an_ellipsoid_is_linear_in_the_direction():
    ellipsoid = fsh.ConformalShape(linear(np.diag(AXES), (1, 2, 3)))
    assert ellipsoid.volume == pytest.approx(4 / 3 * np.pi * AXES.prod(), rel=1e-13)
    np.testing.assert_allclose(ellipsoid.center, [1, 2, 3], rtol=1e-15)
    directions = fsh.fibonacci_grid(200).directions
    np.testing.assert_allclose(ellipsoid.evaluate(directions), directions * AXES + [1, 2, 3], atol=1e-14)
    mesh, normals = ellipsoid.mesh_arrays(500)
    expected = (mesh.vertices - [1, 2, 3]) / AXES**2
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, expected, atol=1e-12)  # the fast transform's tolerance


def test_positions_are_interpolated_linearly_over_each_triangle(rng):
    matrix, offset = rng.standard_normal((3, 3)), rng.standard_normal(3)
    mapped = SimpleNamespace(
        mesh=MeshArrays(OCTAHEDRON.vertices @ matrix.T + offset, OCTAHEDRON.triangles), positions=OCTAHEDRON.vertices
    )
    values = rng.standard_normal((6, 2))
    shape = fsh.ConformalShape.from_map(mapped, 6, attributes={"pair": values, "one": values[:, 1]})
    transform = fsh.SphericalHarmonicTransform(6)
    directions = transform.grid.directions
    flat = directions / np.abs(directions).sum(axis=1, keepdims=True)  # where a ray meets the octahedron
    np.testing.assert_allclose(shape.coefficients, transform.forward(matrix @ flat.T + offset[:, None]), atol=1e-13)
    # Barycentric coordinates on the octahedron: the positive and negative parts of the coordinates.
    corners = np.hstack((np.maximum(flat, 0), np.maximum(-flat, 0)))
    np.testing.assert_allclose(shape.attributes["pair"], transform.forward(values.T @ corners.T), atol=1e-13)
    np.testing.assert_allclose(shape.attributes["one"], shape.attributes["pair"][1], atol=1e-15)


def test_oversampling_takes_more_directions(shape):
    mapped = SimpleNamespace(mesh=OCTAHEDRON, positions=OCTAHEDRON.vertices)
    usual, fine, finest = (
        fsh.ConformalShape.from_map(mapped, 4, oversampling=o).coefficients for o in (None, 24.0, 96.0)
    )
    assert 10 * np.abs(fine - finest).max() < np.abs(usual - finest).max()


def test_a_star_of_degree_eight_comes_back_from_its_mesh(star):
    again = fsh.ConformalShape.from_geometry(star, 33)
    error = surface_error(star, again.mesh_arrays(40_000)[0]).relative()
    assert error.rmse < 5e-4  # 0.05 %
    assert error.volume_error < 5e-4


def test_a_surface_that_is_not_star_shaped_comes_back(shape):
    mesh = shape.mesh_arrays(1500)[0]
    with pytest.raises(fsh.NotStarShapedError):
        fsh.RadialShape.from_geometry(mesh, 24)
    again = fsh.ConformalShape.from_geometry(mesh, 24)
    result = again.mesh_arrays(10_000)[0]
    measures = measure_mesh(result)
    assert measures.closed and measures.vertex_manifold and measures.outward
    assert measures.genus == 0
    assert surface_error(mesh, result).relative().rmse < 2e-3
    assert again.volume == pytest.approx(shape.volume, rel=0.01)


def test_volume_and_normals_agree_with_the_mesh(shape):
    mesh, normals = shape.mesh_arrays(30_000)
    assert measure_mesh(mesh).volume == pytest.approx(shape.volume, rel=5e-4)  # facets cut some 1e-4 off
    corners = mesh.vertices[mesh.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    agreement = np.einsum("ij,ij->i", facing, normals[mesh.triangles[:, 0]])
    # A facet's normal and the analytic one at its corner differ by about edge length over radius of curvature, which is
    # small at the two tips.
    assert agreement.min() > 0.7
    assert np.quantile(agreement, 0.01) > 0.99
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-14)


def test_normals_where_the_surface_degenerates_are_unit_vectors():
    segment = fsh.ConformalShape(linear(np.diag([1.0, 0, 0])))
    assert segment.volume == 0
    np.testing.assert_allclose(np.linalg.norm(segment.mesh_arrays(100)[1], axis=1), 1, atol=1e-14)
    assert fsh.ConformalShape(np.ones((3, 1))).volume == 0


@pytest.mark.parametrize("triangulation", ["icosphere", "fibonacci"])
def test_resolution_and_triangulation(shape, triangulation):
    mesh = shape.mesh_arrays(1000, triangulation=triangulation)[0]
    assert len(mesh.vertices) == (1002 if triangulation == "icosphere" else 1000)
    assert measure_mesh(mesh).genus == 0
    with pytest.raises(ValueError, match="resolution must be"):
        shape.mesh_arrays(3)
    with pytest.raises(ValueError, match="triangulation must be"):
        shape.mesh_arrays(100, triangulation="cube")


def test_smoothing_does_not_collapse(shape):
    """As Laplacian smoothing of a mesh may (Open3D issue 2390), and as the filter alone would."""
    previous = shape
    for time in (1e-3, 1e-2, 0.1, 1.0, 50.0):
        smooth = shape.filtered(fsh.heat_filter(12, time))
        assert smooth.volume == pytest.approx(shape.volume, rel=1e-12)
        np.testing.assert_allclose(smooth.center, shape.center, rtol=1e-12)
        roughness, before = (
            np.linalg.norm(s.coefficients[:, 4:]) / np.linalg.norm(s.coefficients[:, 1:4]) for s in (smooth, previous)
        )
        assert roughness < before
        previous = smooth
    assert roughness < 1e-80  # an ellipsoid, not a point
    assert shape.filtered(fsh.heat_filter(12, 1.0), keep_volume=False).volume < 0.01 * shape.volume


def test_filters_without_scaling_and_without_volume(shape):
    gains = fsh.lanczos_filter(12)
    plain = shape.filtered(gains, keep_volume=False).coefficients
    np.testing.assert_array_equal(plain, fsh.filter_coefficients(shape.coefficients, gains))
    np.testing.assert_array_equal(shape.filtered(lambda degree: np.ones(len(degree))).coefficients, shape.coefficients)
    point = shape.filtered(np.eye(1, 12)[0])
    np.testing.assert_array_equal(point.coefficients[:, 1:], 0)  # nothing left to scale


def test_truncation_is_exact(shape):
    coarse = shape.truncated(5)
    assert coarse.bandwidth == 5
    np.testing.assert_array_equal(coarse.coefficients, shape.coefficients[:, :25])
    with pytest.raises(ValueError, match="bandwidth must be between 1 and 12"):
        shape.truncated(13)


def test_levels_of_detail_are_meshes_of_their_own_size(shape):
    levels = shape.level_of_detail()
    assert list(levels) == [4, 8]
    assert [len(mesh.vertices) for mesh in levels.values()] == [492, 1692]  # the first icospheres of 24b²
    coarse = np.asarray(levels[4].vertices)
    expected = shape.truncated(4).mesh_arrays(384)[0].vertices
    np.testing.assert_array_equal(coarse, expected)
    assert list(shape.level_of_detail([12, 2], kind="tensor")) == [12, 2]
    assert list(fsh.ConformalShape(linear(np.eye(3))).level_of_detail()) == [2]
    with pytest.raises(ValueError, match="bandwidth must be"):
        shape.level_of_detail([24])


def test_rotation_turns_space(shape, random_rotation):
    directions = fsh.fibonacci_grid(100).directions
    turned = shape.rotated(random_rotation)
    expected = (shape.evaluate(directions) - shape.center) @ random_rotation.T + shape.center
    np.testing.assert_allclose(turned.evaluate(directions), expected, atol=1e-12)
    assert turned.volume == pytest.approx(shape.volume, rel=1e-12)
    np.testing.assert_allclose(turned.compute_feature().data, shape.compute_feature().data, atol=1e-13)
    for wrong in (np.eye(2), 2 * np.eye(3), np.diag([1.0, 1, -1])):
        with pytest.raises(ValueError, match="rotation must"):
            shape.rotated(wrong)


def test_feature_is_open3d_and_knows_form_and_size_only(shape, random_rotation):
    feature = shape.compute_feature()
    assert isinstance(feature, o3d.pipelines.registration.Feature)
    assert feature.data.shape == (12, 1)
    assert feature.data[0, 0] == 0
    np.testing.assert_allclose(
        feature.data[1:, 0], np.sqrt((fsh.degree_energies(shape.coefficients)[:, 1:] ** 2).sum(axis=0)), rtol=1e-14
    )
    elsewhere = fsh.ConformalShape(2 * shape.coefficients + 7 * np.eye(1, 144))
    np.testing.assert_allclose(elsewhere.compute_feature().data, 2 * feature.data, rtol=1e-14)
    # A map turned on its sphere: the same surface.
    directions = fsh.SphericalHarmonicTransform(12).grid.directions
    turned = fsh.SphericalHarmonicTransform(12).forward(shape.evaluate(directions @ random_rotation).T)
    np.testing.assert_allclose(fsh.ConformalShape(turned).compute_feature().data, feature.data, atol=1e-12)


def test_the_feature_of_a_mesh_does_not_see_its_pose(star, random_rotation):
    here = fsh.ConformalShape.from_geometry(star, 16).compute_feature().data
    there = fsh.ConformalShape.from_geometry(shapes.moved(star, rotation=random_rotation, offset=(3, 4, 5)), 16)
    # The map is the same up to a rotation and its own tolerance.
    assert np.abs(there.compute_feature().data - here).max() < 5e-3 * here.max()


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_kind_of_geometry_and_colours_are_kept(star, kind):
    mesh = shapes.open3d_geometry(star, kind)
    colors = (star.vertices - star.vertices.min(axis=0)) / np.ptp(star.vertices, axis=0)
    if kind == "legacy":
        mesh.vertex_colors = o3d.utility.Vector3dVector(colors)
    else:
        mesh.vertex.colors = o3d.core.Tensor((255 * colors).round().astype(np.uint8))
    height = star.vertices[:, 2]
    shape = fsh.ConformalShape.from_geometry(mesh, 16, attributes={"height": height})
    assert shape.kind == kind
    assert list(fsh.ConformalShape.from_geometry(mesh, 4, carry=False).attributes) == []
    module = o3d.geometry if kind == "legacy" else o3d.t.geometry
    decoded, cloud = shape.to_triangle_mesh(3000), shape.to_point_cloud(500)
    assert isinstance(decoded, module.TriangleMesh)
    assert isinstance(cloud, module.PointCloud)
    if kind == "legacy":
        got = [
            (np.asarray(g), np.asarray(c))
            for g, c in ((decoded.vertices, decoded.vertex_colors), (cloud.points, cloud.colors))
        ]
    else:
        got = [(g["positions"].numpy(), g["colors"].numpy()) for g in (decoded.vertex, cloud.point)]
        carried = decoded.vertex["height"].numpy()
        np.testing.assert_allclose(carried, decoded.vertex["positions"].numpy()[:, 2], atol=1e-12)  # z, linear in z
    for points, color in got:
        expected = np.clip((points - star.vertices.min(axis=0)) / np.ptp(star.vertices, axis=0), 0, 1)
        np.testing.assert_allclose(color, expected, atol=3e-3)  # 8 bits, and clipping within facets
    assert isinstance(shape.to_triangle_mesh(100, kind="legacy"), o3d.geometry.TriangleMesh)


def test_attributes_follow_vertices_that_are_merged(star):
    soup = shapes.soup(star)  # as STL stores it: the map welds
    shape = fsh.ConformalShape.from_geometry(soup, 12, attributes={"x": soup.vertices[:, 0]})
    np.testing.assert_allclose(shape.attributes["x"], shape.coefficients[0], atol=1e-12)
    directions = fsh.fibonacci_grid(50).directions
    np.testing.assert_allclose(shape.attribute("x", directions), shape.evaluate(directions)[:, 0], atol=1e-12)
    assert shape.truncated(3).attributes["x"].shape == (9,)
    half = shape.filtered(np.full(12, 0.5))
    np.testing.assert_array_equal(half.attributes["x"], shape.attributes["x"] / 2)


def test_points_of_a_cloud_are_spread_over_the_surface(shape):
    cloud = shape.to_point_cloud(2000)
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    mesh = shape.mesh_arrays()[0]
    assert fsh.vertex_distances(points_of(points), mesh).max() < 1e-9 * mesh.diagonal
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)
    # Evenly: the mean of the samples is the centroid of the area.
    np.testing.assert_allclose(points.mean(axis=0), measure_mesh(mesh).area_centroid, atol=0.01)


def points_of(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def test_mesh_far_from_the_origin(star):
    offset = np.array([1e6, -2e6, 3e6])
    here = fsh.ConformalShape.from_geometry(star, 12)
    there = fsh.ConformalShape.from_geometry(shapes.moved(star, offset=offset), 12)
    directions = fsh.fibonacci_grid(100).directions
    # The offset costs 5e-10 of a coordinate, and the map follows the vertices.
    assert np.abs(there.evaluate(directions) - offset - here.evaluate(directions)).max() < 1e-5
    assert there.volume == pytest.approx(here.volume, rel=1e-6)


@pytest.mark.parametrize("scale", [1e-150, 1e150])
def test_extreme_units(star, scale):
    unit = fsh.ConformalShape.from_geometry(star, 8)
    scaled = fsh.ConformalShape.from_geometry(MeshArrays(star.vertices * scale, star.triangles), 8)
    np.testing.assert_allclose(scaled.coefficients / scale, unit.coefficients, atol=1e-6)
    np.testing.assert_allclose(scaled.compute_feature().data / scale, unit.compute_feature().data, atol=1e-6)
    np.testing.assert_allclose(scaled.mesh_arrays(100)[1], unit.mesh_arrays(100)[1], atol=1e-5)
    smooth, expected = (s.filtered(fsh.heat_filter(8, 0.1)).coefficients for s in (scaled, unit))
    np.testing.assert_allclose(smooth / scale, expected, atol=1e-6)


def test_a_shape_is_an_immutable_value(shape):
    with pytest.raises(dataclasses.FrozenInstanceError):
        shape.kind = "tensor"
    with pytest.raises(ValueError, match="read-only"):
        shape.coefficients[0, 0] = 0
    with pytest.raises(TypeError):
        shape.attributes["x"] = np.zeros(144)
    given = bent()
    fsh.ConformalShape(given, {"x": given[0]})
    given[0] = 1  # the caller's array is still the caller's


def test_it_pickles(shape):
    carrying = fsh.ConformalShape(shape.coefficients, {"x": shape.coefficients[0]}, "tensor")
    again = pickle.loads(pickle.dumps(carrying))
    assert again.coefficients.tobytes() == carrying.coefficients.tobytes()
    assert again.attributes["x"].tobytes() == carrying.attributes["x"].tobytes()
    assert again.kind == "tensor"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"coefficients": np.zeros((2, 4))}, r"coefficients must have shape \(3, b²\)"),
        ({"coefficients": np.zeros((3, 5))}, "square number"),
        ({"coefficients": np.full((3, 4), np.nan)}, "finite"),
        ({"kind": "gas"}, "kind must be one of"),
        ({"attributes": {"x": np.zeros(9)}}, r"attribute 'x' must have shape"),
        ({"attributes": {"x": np.zeros((1, 1, 4))}}, r"attribute 'x' must have shape"),
        ({"attributes": {"colors": np.zeros((2, 4))}}, r"attribute 'colors' must have shape \(3, b²\)"),
        ({"attributes": {"normals": np.zeros(4)}}, "name other than positions, normals"),
        ({"attributes": {" ": np.zeros(4)}}, "printable name"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_bad_parts_name_themselves(arguments, message):
    with pytest.raises(ValueError, match=message):
        fsh.ConformalShape(**{"coefficients": np.zeros((3, 4))} | arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bandwidth": 0}, "bandwidth must be between 1 and"),
        ({"oversampling": 0.5}, "oversampling must be"),
        ({"attributes": {"x": [1.0, 2.0]}}, r"attribute 'x' must have shape \(v,\)"),
        ({"attributes": {"colors": np.zeros(6)}}, r"attribute 'colors' must have shape \(v, 3\)"),
        ({"attributes": {"x": np.full(6, np.inf)}}, "attribute 'x' must be finite"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_bad_arguments_name_themselves(arguments, message):
    with pytest.raises(ValueError, match=message):
        fsh.ConformalShape.from_geometry(OCTAHEDRON, **arguments)


def test_bad_types_and_geometry_name_themselves(shape):
    with pytest.raises(TypeError, match="point cloud"):
        fsh.ConformalShape.from_geometry(shape.to_point_cloud(50))
    with pytest.raises(TypeError, match="TriangleMesh or PointCloud"):
        fsh.ConformalShape.from_geometry(object())
    with pytest.raises(TypeError, match="carry must be True or False"):
        fsh.ConformalShape.from_geometry(OCTAHEDRON, carry="colors")
    with pytest.raises(TypeError, match="attributes must be a mapping"):
        fsh.ConformalShape(np.zeros((3, 4)), [np.zeros(4)])
    with pytest.raises(TypeError, match="name must be text"):
        fsh.ConformalShape(np.zeros((3, 4)), {1: np.zeros(4)})
    with pytest.raises(GeometryError, match="genus"):
        fsh.ConformalShape.from_geometry(shapes.torus())
    with pytest.raises(ValueError, match="no attribute 'x'; it has none"):
        shape.attribute("x", np.eye(3))
    with pytest.raises(MemoryEstimateError):
        fsh.ConformalShape.from_geometry(OCTAHEDRON, 4000)


def test_same_bytes_whatever_the_threads(star):
    one, two = (fsh.ConformalShape.from_geometry(star, 32, threads=threads) for threads in (1, 2))
    assert one.coefficients.tobytes() == two.coefficients.tobytes()


@pytest.fixture
def saved(shape, tmp_path):
    path = tmp_path / "x.npz"
    attributes = {"heat": shape.coefficients[0], "a b": shape.coefficients[:2], "colors": shape.coefficients / 9}
    carrying = fsh.ConformalShape(shape.coefficients, attributes, "tensor")
    carrying.save(path)
    return carrying, path


def test_what_is_saved_comes_back(saved):
    shape, path = saved
    again = fsh.load_shape(path)
    assert isinstance(again, fsh.ConformalShape)
    assert again.coefficients.tobytes() == shape.coefficients.tobytes()
    assert again.kind == "tensor"
    assert list(again.attributes) == ["heat", "a b", "colors"]
    for name, array in shape.attributes.items():
        assert again.attributes[name].shape == array.shape
        assert again.attributes[name].tobytes() == array.tobytes()
    first = path.read_bytes()
    again.save(path)
    assert path.read_bytes() == first


def test_without_attributes_the_file_holds_the_coefficients_alone(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as file:
        assert set(file) == {"format", "version", "kind", "coefficients", "geometry"}
        assert file["coefficients"].shape == (3, 144)
    assert fsh.load_shape(tmp_path / "x.npz").attributes == {}


@pytest.mark.parametrize(
    "changes",
    [
        {"coefficients": np.zeros((3, 143))},
        {"coefficients": np.zeros((2, 144))},
        {"coefficients": np.zeros(144)},
        {"coefficients": np.full((3, 144), np.nan)},
        {"coefficients": None},
        {"geometry": np.array("gas")},
        {"attribute_names": None},
        {"attribute_names": np.array(["x", "x", "y"])},
        {"attribute_names": np.array(["x", "y"])},
        {"attribute_names": np.array(["x", "y", "normals"])},
        {"attribute_names": np.array([1.0, 2.0, 3.0])},
        {"attribute_sizes": None},
        {"attribute_sizes": np.array([0, 2, 4])},
        {"attribute_sizes": np.array([0, 5, -1])},
        {"attribute_sizes": np.array([0.0, 2.0, 3.0])},
        {"attribute_sizes": np.array([0, 3, 2])},
        {"attribute_coefficients": None},
        {"attribute_coefficients": np.zeros((6, 121))},
        {"attribute_coefficients": np.zeros((5, 144))},
        {"attribute_coefficients": np.full((6, 144), np.inf)},
    ],
    ids=lambda changes: "-".join(f"{name}-{np.shape(value)}" for name, value in changes.items()),
)
def test_malformed_files_are_refused(saved, changes):
    _, path = saved
    with np.load(path) as file:
        arrays = dict(file) | changes
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(GeometryReadError, match=r"x\.npz"):
        fsh.load_shape(path)


def test_evaluation_is_that_of_the_coefficients(shape):
    directions = fsh.fibonacci_grid(30).directions
    np.testing.assert_allclose(shape.evaluate(directions), evaluate(shape.coefficients, directions).T, atol=1e-12)
