"""RadialShape: encode, decode, level of detail, files; both kinds of Open3D geometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError, NotStarShapedError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import measure_mesh


def stone(bandwidth=9, amplitude=0.15, seed=3):
    """Coefficients of a positive random radial function with a decaying spectrum, mean radius 1."""
    degree, _ = fsh.degrees_and_orders(bandwidth)
    coefficients = np.random.default_rng(seed).standard_normal(bandwidth**2) * amplitude / (1 + degree) ** 2
    coefficients[0] = np.sqrt(4 * np.pi)
    return coefficients


@pytest.fixture(scope="module")
def shape():
    return fsh.RadialShape(stone(), np.array([1.0, -2.0, 3.0]))


def test_degree_eight_star_comes_back_from_its_mesh(shape):
    mesh, _ = shape.mesh_arrays(200_000)
    again = fsh.RadialShape.from_geometry(mesh, 33, shape.center)
    padded = np.zeros(33**2)
    padded[:81] = shape.coefficients
    # The facets lie inside the smooth surface by up to h²/6 = 1.2e-5, which moves c₀ by up to √4π times that.
    assert np.abs(again.coefficients - padded).max() < 4.5e-5
    directions = fsh.fibonacci_grid(5000).directions
    error = again.evaluate(directions) / shape.evaluate(directions) - 1
    assert np.sqrt(np.mean(error**2)) < 2e-5  # 0.002 %


def test_sphere_has_one_coefficient_and_known_volume():
    mesh = o3d.geometry.TriangleMesh.create_sphere(2.0, 200)
    sphere = fsh.RadialShape.from_geometry(mesh, 8)
    assert sphere.coefficients[0] == pytest.approx(2 * np.sqrt(4 * np.pi), rel=1e-3)  # facets
    assert np.abs(sphere.coefficients[1:]).max() < 1e-3
    exact = fsh.RadialShape(np.array([2 * np.sqrt(4 * np.pi)]), np.zeros(3))
    assert exact.volume == pytest.approx(4 / 3 * np.pi * 8, rel=1e-13)


def test_volume_agrees_with_the_mesh(shape):
    mesh, _ = shape.mesh_arrays(160_000)
    assert measure_mesh(mesh).volume == pytest.approx(shape.volume, rel=1e-4)  # facets cut 3e-5 off


@pytest.mark.parametrize("triangulation", ["icosphere", "fibonacci"])
def test_decoded_mesh_is_closed_manifold_outward_and_of_genus_0(shape, triangulation):
    mesh, normals = shape.mesh_arrays(3000, triangulation=triangulation)
    measures = measure_mesh(mesh)
    assert measures.closed
    assert measures.vertex_manifold
    assert measures.outward
    assert measures.genus == 0
    assert measures.degenerate_triangles == 0
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-12)
    corners = mesh.vertices[mesh.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    # A facet's normal and the analytic one at its corner differ by about edge length over radius of curvature.
    assert np.einsum("ij,ij->i", facing, normals[mesh.triangles[:, 0]]).min() > 0.95


def test_normals_of_an_ellipsoid_are_its_gradient():
    directions = fsh.fibonacci_grid(6 * 48**2).directions
    axes = np.array([1.0, 1.1, 0.9])
    radii = 1 / np.sqrt(((directions / axes) ** 2).sum(axis=1))
    shape = fsh.RadialShape(fsh.SphericalHarmonicTransform(48).forward(radii), np.zeros(3))
    mesh, normals = shape.mesh_arrays(2000)
    expected = mesh.vertices / axes**2
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(normals - expected).max() < 1e-9  # the spectrum of this ellipsoid has decayed to 1e-12 by degree 48


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_kind_of_geometry_is_kept(shape, kind):
    mesh = shape.to_triangle_mesh(3000, kind=kind)
    module = o3d.geometry if kind == "legacy" else o3d.t.geometry
    assert isinstance(mesh, module.TriangleMesh)
    again = fsh.RadialShape.from_geometry(mesh, 16)
    assert again.kind == kind
    assert isinstance(again.to_triangle_mesh(), module.TriangleMesh)
    cloud = again.to_point_cloud(500)
    assert isinstance(cloud, module.PointCloud)
    assert len(np.asarray(cloud.points) if kind == "legacy" else cloud.point.positions) == 500
    from_cloud = fsh.RadialShape.from_geometry(again.to_point_cloud(20_000), 9)
    assert from_cloud.kind == kind


def test_cloud_of_a_shape_gives_the_shape_back(shape):
    cloud = shape.to_point_cloud(20_000)
    again = fsh.RadialShape.from_geometry(cloud, 9, shape.center)
    directions = fsh.fibonacci_grid(2000).directions
    assert np.abs(again.evaluate(directions) - shape.evaluate(directions)).max() < 1e-4


def test_mesh_far_from_the_origin(shape):
    mesh, _ = shape.mesh_arrays(20_000)
    offset = np.array([1e6, -2e6, 3e6])
    here = fsh.RadialShape.from_geometry(mesh, 16, shape.center)
    there = fsh.RadialShape.from_geometry(MeshArrays(mesh.vertices + offset, mesh.triangles), 16, shape.center + offset)
    assert np.abs(there.coefficients - here.coefficients).max() < 1e-8  # the offset itself costs 3e-10 of a coordinate


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_extreme_units(shape, scale):
    mesh, _ = shape.mesh_arrays(20_000)
    unit = fsh.RadialShape.from_geometry(mesh, 16)
    scaled = fsh.RadialShape.from_geometry(MeshArrays(mesh.vertices * scale, mesh.triangles), 16)
    assert scaled.coefficients / scale == pytest.approx(unit.coefficients, abs=1e-9)
    assert np.isfinite(scaled.compute_feature().data).all()


def test_levels_of_detail_and_filters(shape):
    assert shape.truncated(4).bandwidth == 4
    assert np.array_equal(shape.truncated(4).coefficients, shape.coefficients[:16])
    smooth = shape.filtered(fsh.heat_filter(9, 0.1))
    degree, _ = fsh.degrees_and_orders(9)
    assert smooth.coefficients == pytest.approx(shape.coefficients * np.exp(-0.1 * degree * (degree + 1)), rel=1e-14)
    assert np.array_equal(shape.filtered(lambda l: np.ones(len(l))).coefficients, shape.coefficients)  # noqa: E741


def test_feature_is_open3d_and_invariant(shape, random_rotation):
    feature = shape.compute_feature()
    assert isinstance(feature, o3d.pipelines.registration.Feature)
    assert feature.data.shape == (9, 1)
    mesh, _ = shape.mesh_arrays(60_000)
    here = fsh.RadialShape.from_geometry(mesh, 16, shape.center).compute_feature().data
    turned = MeshArrays((mesh.vertices - shape.center) @ random_rotation.T + 5.0, mesh.triangles)
    again = fsh.RadialShape.from_geometry(turned, 16, np.full(3, 5.0)).compute_feature().data
    # The same facets sampled in other directions; they carry some 1e-6 above the band limit, which aliases differently.
    assert np.abs(again - here).max() < 2e-6


def test_a_shape_is_an_immutable_value(shape):
    with pytest.raises(dataclasses.FrozenInstanceError):
        shape.center = np.zeros(3)
    with pytest.raises(ValueError, match="read-only"):
        shape.coefficients[0] = 0
    given = stone()
    fsh.RadialShape(given, np.zeros(3))
    given[0] = 1  # the caller's array is still the caller's


def test_what_is_not_star_shaped_is_refused_with_figures():
    torus = o3d.geometry.TriangleMesh.create_torus()
    with pytest.raises(NotStarShapedError, match=r"not star-shaped.* % of directions"):
        fsh.RadialShape.from_geometry(torus, 8)


def test_two_bumps_seen_from_outside(shape):
    outer, _ = shape.mesh_arrays(3000)
    inner = MeshArrays((outer.vertices - shape.center) * 0.5 + shape.center, outer.triangles)
    both = MeshArrays(
        np.concatenate([outer.vertices, inner.vertices]),
        np.concatenate([outer.triangles, inner.triangles + len(outer.vertices)]),
    )
    outermost = fsh.RadialShape.from_geometry(both, 9, shape.center, behaviour="outermost")
    innermost = fsh.RadialShape.from_geometry(both, 9, shape.center, behaviour="innermost")
    assert outermost.coefficients == pytest.approx(2 * innermost.coefficients, abs=1e-9)


def test_a_radius_that_is_not_positive_is_refused():
    spiky = fsh.RadialShape(np.array([1.0, 0.0, 3.0, 0.0]), np.zeros(3))
    with pytest.raises(GeometryError, match=r"not positive in .* % of directions"):
        spiky.to_triangle_mesh()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bandwidth": 0}, "bandwidth must be between 1 and"),
        ({"bandwidth": -3}, "bandwidth must be between 1 and"),
        ({"bandwidth": 10**9}, "bandwidth must be between 1 and"),
        ({"center": "middle"}, "center must be one of"),
        ({"center": [0, 0]}, r"center must have shape \(3,\)"),
        ({"center": [0, np.nan, 0]}, "center must be finite"),
        ({"oversampling": 0.5}, "oversampling must be"),
        ({"behaviour": "guess"}, "behaviour must be one of"),
    ],
)
def test_bad_arguments_name_themselves(shape, arguments, message):
    mesh, _ = shape.mesh_arrays(500)
    with pytest.raises(ValueError, match=message):
        fsh.RadialShape.from_geometry(mesh, **arguments)


def test_bad_geometry_names_itself():
    with pytest.raises(TypeError, match="TriangleMesh or PointCloud"):
        fsh.RadialShape.from_geometry(object())
    with pytest.raises(FileNotFoundError):
        fsh.RadialShape.from_geometry("no such bunny.ply")
    with pytest.raises(GeometryError, match="empty"):
        fsh.RadialShape.from_geometry(o3d.geometry.TriangleMesh())
    with pytest.raises(GeometryError, match="empty"):
        fsh.RadialShape.from_geometry(o3d.t.geometry.PointCloud())
    flat = MeshArrays(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(GeometryError):
        fsh.RadialShape.from_geometry(flat, 4)
    with pytest.raises(GeometryError):
        fsh.RadialShape.from_geometry(PointArrays(np.ones((100, 3))), 4)


def test_bad_coefficients_name_themselves():
    with pytest.raises(ValueError, match="square number"):
        fsh.RadialShape(np.zeros(5), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        fsh.RadialShape(np.array([np.inf]), np.zeros(3))


def test_same_bytes_whatever_the_threads(shape):
    mesh, _ = shape.mesh_arrays(5000)
    one, two = (fsh.RadialShape.from_geometry(mesh, 32, threads=threads) for threads in (1, 2))
    assert one.coefficients.tobytes() == two.coefficients.tobytes()
