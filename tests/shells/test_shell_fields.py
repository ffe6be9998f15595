"""Surfaces in their own frame, and their fields on shells: analytic truths and brute-force oracles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import area_samples
from fsh3d_o3d.geometry.sampling import surface_points
from fsh3d_o3d.geometry.surface import surface_of
from fsh3d_o3d.shells.shell_fields import ShellFields, ShellSampler, squared_distances
from fsh3d_o3d.sphere.grids import fibonacci_grid
from tests.geometry.mesh_shapes import box, bumpy, ell, joined, sphere, torus

FIELDS = {
    "shells": 8,
    "radius": 2.0,
    "route": "voxel",
    "distance": "soft",
    "widths": (0.2, 0.5),
    "smoothing": 0.1,
    "normal_width": 0.5,
    "normal_smoothing": 0.2,
    "voxels": 48,
}
DIRECTIONS = fibonacci_grid(150).directions


def sampled(surface, **changes):
    return ShellSampler(ShellFields(**{**FIELDS, **changes}), DIRECTIONS).sample(surface)


def quartered(mesh: MeshArrays) -> MeshArrays:
    """Each triangle cut into four, none sharing a vertex with another: the same surface."""
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    corners = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return MeshArrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def test_moments_of_a_cube():
    surface = surface_of(box((2.0, 2.0, 2.0)), 100)
    # Mean of x² + y² + z² over a face: 1 + 1/3 + 1/3.
    assert surface.rms_radius == pytest.approx(np.sqrt(5 / 3), rel=1e-14)
    np.testing.assert_allclose(surface.centroid, 0, atol=1e-15)
    np.testing.assert_allclose(surface.covariance, np.eye(3) / 3, atol=1e-15)


def test_moments_of_one_triangle():
    """The covariance of a uniform triangle is Σ (q − g)(q − g)ᵀ/12 over its corners q."""
    corners = np.array([[0.0, 0, 0], [3, 0, 1], [1, 2, -1]])
    surface = surface_of(MeshArrays(corners, [[0, 1, 2]]), 100)
    middle = corners.mean(axis=0)
    expected = (corners - middle).T @ (corners - middle) / 12
    np.testing.assert_allclose(surface.centroid, middle, atol=1e-14)
    np.testing.assert_allclose(surface.covariance * surface.rms_radius**2, expected, atol=1e-14)


def test_moments_against_samples():
    mesh = ell()
    points, _ = area_samples(mesh, 200_000)
    surface = surface_of(mesh, 100)
    # Stratified samples: errors well below 1/√n = 2e-3.
    np.testing.assert_allclose(surface.centroid, points.mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(surface.covariance * surface.rms_radius**2, np.cov(points.T), atol=1e-3)


def test_triangulation_does_not_matter_for_moments(rng):
    mesh = bumpy()
    shuffled = rng.permutation(len(mesh.vertices))
    renamed = MeshArrays(mesh.vertices[shuffled], np.argsort(shuffled)[mesh.triangles])
    flipped = MeshArrays(mesh.vertices, mesh.triangles[:, ::-1])
    unused = MeshArrays(np.concatenate((mesh.vertices, [[1e300, 0, 0]])), mesh.triangles)
    expected = surface_of(mesh, 1000)
    for other in (renamed, flipped, unused, quartered(mesh)):
        surface = surface_of(other, 1000)
        # Rounding of sums over a few thousand triangles.
        np.testing.assert_allclose(surface.centroid, expected.centroid, atol=1e-14)
        np.testing.assert_allclose(surface.covariance, expected.covariance, atol=1e-14)
        assert surface.rms_radius == pytest.approx(expected.rms_radius, rel=1e-14)
    for other in (renamed, unused):
        np.testing.assert_array_equal(surface_of(other, 1000).points, expected.points)


@given(st.sampled_from([1e-300, 1e-12, 1e12, 1e300]))
def test_any_unit_of_length(scale):
    mesh = bumpy(8)
    expected = surface_of(mesh, 500)
    surface = surface_of(MeshArrays(mesh.vertices * scale, mesh.triangles), 500)
    assert surface.rms_radius == pytest.approx(expected.rms_radius * scale, rel=1e-13)
    # Multiplying by the scale rounds the coordinates once.
    np.testing.assert_allclose(surface.points, expected.points, atol=1e-13)


def test_far_from_the_origin():
    mesh = bumpy(8)
    shift = np.array([1e6, -3e6, 2e6])
    surface = surface_of(MeshArrays(mesh.vertices + shift, mesh.triangles), 500)
    # The coordinates themselves are rounded to 5e-10 there.
    np.testing.assert_allclose(surface.points, surface_of(mesh, 500).points, atol=2e-9)


def test_samples_lie_on_the_surface_and_spread_by_area():
    surface = surface_of(torus(), 4000)
    assert surface.weights.sum() == pytest.approx(1, rel=1e-12)
    # Points are corners combined in float64.
    assert squared_distances(surface, surface.points).max() < 1e-24
    # A stratified set integrates smooth functions with an error well below 1/√n = 0.016.
    np.testing.assert_allclose(surface.points.mean(axis=0), 0, atol=3e-3)
    np.testing.assert_allclose(surface.points.T @ surface.points / 4000, surface.covariance, atol=3e-3)


@pytest.mark.parametrize("power", [-1.0, 0.0, 0.5, 1.0])
def test_whitening(power):
    surface = surface_of(box((1.0, 2.0, 4.0)), 2000)
    changed = surface.whitened(power, 1e-6)
    value = np.linalg.eigvalsh(surface.covariance) ** (1 - power)
    expected = np.sort(value / value.sum())
    np.testing.assert_allclose(np.linalg.eigvalsh(changed.covariance), expected, atol=1e-13)
    # Samples, vertices and normals go along: normals stay perpendicular to the faces.
    assert squared_distances(changed, changed.points).max() < 1e-24
    corners = changed.vertices[changed.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    normals = changed.normals / np.linalg.norm(changed.normals, axis=1, keepdims=True)
    np.testing.assert_allclose(np.abs(normals @ face.T).max(axis=1), 1, atol=1e-12)


def test_whitening_keeps_a_flat_sheet_flat():
    sheet = MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]]), [[0, 1, 2], [0, 2, 3]])
    changed = surface_of(sheet, 500).whitened(1.0, 1e-3)
    np.testing.assert_allclose(np.linalg.eigvalsh(changed.covariance), [0, 0.5, 0.5], atol=1e-13)


def test_exact_distances_to_a_sphere():
    surface = surface_of(sphere(48), 100)
    points = DIRECTIONS * np.linspace(0.1, 2, 150)[:, None]
    expected = np.abs(np.linalg.norm(points, axis=1) - 1)
    # The facets of 46,080 triangles lie up to 4e-4 inside the sphere.
    np.testing.assert_allclose(np.sqrt(squared_distances(surface, points)), expected, atol=5e-4)


def test_exact_distances_to_points_are_to_the_nearest_point(rng):
    surface = surface_of(PointArrays(rng.random((50, 3))), 100)
    points = rng.random((40, 3)) - 0.5
    expected = np.linalg.norm(points[:, None] - surface.points, axis=2).min(axis=1)
    np.testing.assert_allclose(np.sqrt(squared_distances(surface, points)), expected, rtol=1e-12)


@pytest.mark.parametrize("mesh", [torus(), ell(), joined(sphere(8), box())], ids=["torus", "ell", "both"])
def test_voxel_distances_agree_with_exact_ones(mesh):
    surface = surface_of(mesh, 20_000)
    exact = sampled(surface, route="exact", distance="nearest", normal_width=None)
    nearest = sampled(surface, distance="nearest", normal_width=None, voxels=64)
    # The voxel nearest to a node may hold a part of the surface that is half a voxel (0.032) farther than the closest;
    # the largest slope of exp(−d²/2σ²) is 0.6/σ, σ = 0.2.
    assert np.abs(nearest - exact).max() < 0.1
    assert np.abs(nearest - exact).mean() < 0.015


def test_soft_distance_against_the_sum_over_samples():
    surface = surface_of(ell(), 3000)
    points = (np.arange(8) + 0.5)[:, None, None] / 4 * DIRECTIONS
    square = np.square(points[:, :, None] - surface.points).sum(axis=-1)
    soft = -2 * 0.1**2 * np.log(np.exp(-0.5 * square / 0.1**2).mean(axis=-1))
    expected = np.stack([np.exp(-0.5 * soft / width**2) for width in (0.2, 0.5)])
    values = sampled(surface, normal_width=None, voxels=96)
    # Trilinear spreading and interpolation widen the kernel by about a quarter of a squared voxel (0.043² / 0.1²).
    np.testing.assert_allclose(values, expected, atol=0.03)


def test_normal_field_of_a_sphere_and_of_a_sheet():
    """On a sphere all normals are radial; on a sheet through the centroid none is."""
    ball = surface_of(sphere(16), 5000)
    field = sampled(ball)[2]
    radial = sampled(ball, widths=(0.5,), smoothing=0.2, normal_width=None)[0]
    # The same blur of the same area; only the order of the power and the interpolation differs.
    np.testing.assert_allclose(field, radial, atol=0.01)
    sheet = MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), [[0, 1, 2], [0, 2, 3]])
    assert np.abs(sampled(surface_of(sheet, 2000))[2]).max() < 1e-20


def test_normals_of_either_sign_and_any_length_count_alike(rng):
    cloud = surface_of(PointArrays(bumpy().vertices), 100).points
    normals = rng.standard_normal(cloud.shape)
    factor = rng.choice([-1e9, -1.0, 1e-9, 5.0], (len(cloud), 1))
    values = [sampled(surface_of(PointArrays(cloud, n), 100)) for n in (normals, normals * factor)]
    np.testing.assert_allclose(values[0], values[1], atol=1e-12)


def test_cloud_of_uneven_density_has_the_moments_of_the_surface(rng):
    points = rng.standard_normal((6000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    dense = points[(points[:, 2] > 0) | (rng.random(6000) < 0.15)]
    assert dense.mean(axis=0)[2] > 0.3
    surface = surface_of(PointArrays(dense), 100)
    # Distances to the sixteenth neighbour vary by about 1/√16 a point, which averages out but for the border.
    assert np.abs(surface.centroid).max() < 0.05
    assert surface.rms_radius == pytest.approx(1, abs=0.01)


def test_order_and_copies_of_points_do_not_matter(rng):
    mesh = bumpy()
    normals = rng.standard_normal(mesh.vertices.shape)
    order = np.concatenate((rng.permutation(len(normals)), np.arange(50)))
    first = surface_of(PointArrays(mesh.vertices, normals), 100)
    second = surface_of(PointArrays(mesh.vertices[order], normals[order]), 100)
    for name in ("points", "normals", "weights"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_estimated_normals_of_a_sphere():
    cloud = surface_of(PointArrays(sphere(16).vertices), 100)
    cosine = np.abs(np.einsum("ij,ij->i", cloud.normals, cloud.points / np.linalg.norm(cloud.points, axis=1)[:, None]))
    # Neighbours lie on a symmetrical cap, but for the irregular ones near the icosahedron's corners.
    assert cosine.min() > 0.99


def test_unusable_normals_are_estimated():
    points = sphere(8).vertices
    for bad in (np.zeros_like(points), np.full_like(points, np.nan)):
        np.testing.assert_array_equal(
            surface_of(PointArrays(points, bad), 100).normals, surface_of(PointArrays(points), 100).normals
        )


def test_an_outlier_claims_little():
    points = np.concatenate((sphere(16).vertices, [[50.0, 0, 0]]))
    surface = surface_of(PointArrays(points), 100)
    # 2562 points, one of which weighs as much as sixteen.
    assert surface.weights.max() < 17 / 2500
    assert np.abs(surface.centroid).max() < 0.5


@pytest.mark.parametrize("mesh", [box((1.0, 2.0, 3.0)), box((10.0, 0.001, 0.001))], ids=["box", "needle"])
def test_surface_points_leave_no_gaps(mesh):
    surface = surface_of(mesh, 3000)
    covered = surface_of(PointArrays(np.concatenate((surface_points(surface, 0.05), surface.points))), 100)
    assert covered.points.shape[0] > 60
    distance = np.linalg.norm(surface.points[:300, None] - surface_points(surface, 0.05), axis=2).min(axis=1)
    assert distance.max() <= 0.05


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        (MeshArrays(np.array([[0.0, 0, 0], [0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]), [[0, 1, 2]]), "no area"),
        (MeshArrays(np.array([[0.0, 0, 0], [0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]) + 1e6, [[0, 1, 2]]), "no area"),
        (MeshArrays(np.eye(3), [[0, 0, 1], [1, 2, 2]]), "no area"),
        (MeshArrays(np.ones((3, 3)), [[0, 1, 2]]), "no extent"),
        (PointArrays(np.ones((4, 3))), "no extent"),
    ],
    ids=["line", "far line", "repeated corners", "point", "one point"],
)
def test_nothing_to_describe(geometry, message):
    with pytest.raises(GeometryError, match=message):
        surface_of(geometry, 100)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"route": "exact"}, "voxel route only"),
        ({"route": "guess"}, "route must be one of"),
        ({"distance": "far"}, "distance must be one of"),
        ({"shells": 0}, "shells must be"),
        ({"radius": 0.5}, "radius must be"),
        ({"voxels": 1000}, "voxels must be"),
        ({"widths": (0.2, 0.0)}, "widths must be"),
        ({"normal_width": -1.0}, "normal_width must be"),
        ({"widths": (), "normal_width": None}, "must be a field"),
    ],
)
def test_bad_fields_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        ShellFields(**{**FIELDS, **changes})
