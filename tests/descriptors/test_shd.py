"""The spherical harmonic descriptor: analytic energies, invariances, options, bad input."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import threadpool_limits

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.descriptors.shd import SHDOption, compute_shd_feature, descriptor_distances, shd_descriptor
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_mesh
from fsh3d_o3d.geometry.measures import area_samples
from fsh3d_o3d.sphere.grids import equiangular_grid, fibonacci_grid
from fsh3d_o3d.sphere.invariants import energies, gram_powers
from fsh3d_o3d.sphere.transform import SphericalHarmonicTransform
from fsh3d_o3d.sphere.weights import driscoll_healy_weights, equal_weights
from tests.geometry.mesh_shapes import bumpy, ell, joined, sphere, torus, u_shape

SAMPLES = Path(__file__).parents[2] / "samples"
BEST = SHDOption.best()
OPTIONS = {
    "energies": SHDOption(),
    "published": SHDOption.published(),
    "best": BEST,
    "best exact": SHDOption.best(route="exact"),
}


def moved(mesh: MeshArrays, rotation, scale=1.0, shift=(0.0, 0.0, 0.0)) -> MeshArrays:
    return MeshArrays(mesh.vertices @ np.transpose(rotation) * scale + shift, mesh.triangles)


def change(first, second):
    return np.linalg.norm(second - first) / np.linalg.norm(first)


@pytest.mark.parametrize(
    ("name", "shape"), [("energies", (16, 32)), ("published", (17, 32)), ("best", (12, 300)), ("best exact", (12, 300))]
)
def test_feature_is_an_open3d_feature_of_the_promised_shape(name, shape):
    option = OPTIONS[name]
    feature = compute_shd_feature(open3d_mesh(ell()), option)
    assert isinstance(feature, open3d().pipelines.registration.Feature)
    assert option.feature_shape == shape
    # One column: Open3D's functions for the features of points find no points to match in it.
    assert (feature.dimension(), feature.num()) == feature.data.shape == (shape[0] * shape[1], 1)
    assert np.isfinite(feature.data).all()
    assert np.linalg.norm(feature.data.ravel(), int(option.normalisation[1])) == pytest.approx(1, rel=1e-12)
    vector = shd_descriptor(ell(), option)
    assert vector.dtype == np.float32
    np.testing.assert_array_equal(vector, feature.data.astype(np.float32).ravel())


def test_defaults_and_kinds_of_geometry():
    expected = compute_shd_feature(ell(), SHDOption.best()).data  # as fsh3d describe and an index have it
    for geometry in (open3d_mesh(ell()), open3d_mesh(ell(), "tensor")):
        np.testing.assert_array_equal(compute_shd_feature(geometry).data, expected)


def test_energies_of_a_sphere_are_known():
    """Around a unit sphere the field is exp(−(r − 1)²/2σ²) on each shell: degree 0 only, times r√4π and √4π."""
    option = SHDOption(route="exact", normalisation="none", bandwidth=8)
    data = compute_shd_feature(sphere(48), option).data.reshape(option.feature_shape)
    radius = (np.arange(32) + 0.5) / 16
    expected = 4 * np.pi * radius * np.exp(-((radius - 1) ** 2) / (2 * option.widths[0] ** 2))
    # The facets lie up to 4e-4 inside the sphere: at a slope of 0.6/σ = 3.4 that is 1.5e-3 of 4πr.
    np.testing.assert_allclose(data[0], expected, atol=0.02)
    assert data[1:].max() < 0.02


@pytest.mark.parametrize("scaling", ["none", "radius", "sqrt4pi"])
def test_shells_are_scaled(scaling):
    plain = SHDOption(shell_scaling="none", normalisation="none")
    radius = (np.arange(32) + 0.5) / 16
    factor = {"none": np.ones(32), "radius": radius, "sqrt4pi": radius * np.sqrt(4 * np.pi)}[scaling]
    expected = compute_shd_feature(ell(), plain).data.reshape(plain.feature_shape) * factor
    data = compute_shd_feature(ell(), dataclasses.replace(plain, shell_scaling=scaling)).data.reshape(expected.shape)
    # High degrees on the innermost shells are rounding of values of order one.
    np.testing.assert_allclose(data, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("epsilon", [0.0, 0.3])
@pytest.mark.parametrize("power", [0.25, 0.5, 1.0])
def test_gram_powers_against_matrix_functions(rng, power, epsilon):
    coefficients = rng.standard_normal((3, 25))
    rows = gram_powers(coefficients, 5, power, epsilon)
    for degree in range(1, 5):  # degree 0 has rank one, which a matrix power does not take without epsilon
        part = coefficients[:, degree**2 : (degree + 1) ** 2]
        matrix = part @ part.T + epsilon**2 * np.eye(3)
        root = scipy.linalg.fractional_matrix_power(matrix, power) - epsilon ** (2 * power) * np.eye(3)
        upper = np.triu_indices(3)
        expected = root[upper] * np.where(upper[0] == upper[1], 1, np.sqrt(2))
        np.testing.assert_allclose(rows[degree], expected, atol=1e-10)
        assert np.linalg.norm(rows[degree]) == pytest.approx(np.linalg.norm(root), rel=1e-10)


def test_invariants_do_not_change_when_functions_are_rotated(rng, random_rotation):
    from fsh3d_o3d.sphere.transform import evaluate

    transform = SphericalHarmonicTransform(6)
    coefficients = rng.standard_normal((4, 36))
    # Values of f(Rᵀω): exact for functions of degree < 6, so only rounding is left.
    turned = transform.forward(evaluate(coefficients, transform.grid.directions @ random_rotation))
    assert np.abs(turned - coefficients).max() > 0.1
    for values in (
        [gram_powers(c, 6, 0.5, 0.0) for c in (coefficients, turned)],
        [energies(c, quadratic=True) for c in (coefficients, turned)],
        [energies(c, quadratic=False) for c in (coefficients, turned)],
    ):
        np.testing.assert_allclose(values[0], values[1], atol=1e-6)  # a square root of rounding where rank is lacking


def test_covariance_triples_measure_aligned_quadratic_forms(rng):
    """Diagonal forms with axes in the same order: the triples are as far apart as the functions in L2."""
    transform = SphericalHarmonicTransform(4)
    squares = transform.grid.directions**2
    values = np.sort(rng.standard_normal((2, 3)))[:, ::-1]
    functions = values @ squares.T
    triples = energies(transform.forward(functions), quadratic=True)
    assert triples.shape == (5, 2)
    distance = np.sqrt(transform.weights @ (functions[0] - functions[1]) ** 2)
    # The quadrature is exact for the degree 4 of squares.
    assert np.linalg.norm(triples[:3, 0] - triples[:3, 1]) == pytest.approx(distance, rel=1e-12)
    np.testing.assert_allclose(triples[3:], 0, atol=1e-12)


@pytest.mark.parametrize("name", list(OPTIONS))
@pytest.mark.parametrize("mesh", [bumpy(), u_shape()], ids=["bumpy", "u"])
def test_motion_scale_and_reflection(name, mesh, random_rotation):
    first = shd_descriptor(mesh, OPTIONS[name])
    mirrored = np.diag([1.0, 1.0, -1.0])
    # Over 907 models the voxel routes changed by at most 3.3 %, the exact ones by 1 %.
    tolerance = 0.02 if "exact" in name else 0.05
    for other in (moved(mesh, random_rotation, 1e-12), moved(mesh, random_rotation @ mirrored, 1e3, (5e3, 0, -2e4))):
        assert change(first, shd_descriptor(other, OPTIONS[name])) < tolerance
    # Scaling by a power of two is exact in every step.
    np.testing.assert_array_equal(shd_descriptor(moved(mesh, np.eye(3), 2.0**40), OPTIONS[name]), first)


@pytest.mark.parametrize("name", ["energies", "best"])
def test_triangulation_order_and_unused_vertices(name, rng):
    mesh = bumpy()
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    middle = (a + b + c) / 3
    corners = np.concatenate([np.stack(t, axis=1) for t in ((a, b, middle), (b, c, middle), (c, a, middle))])
    order = rng.permutation(len(corners))
    soup = MeshArrays(corners[order].reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)[:, ::-1])
    first = shd_descriptor(mesh, OPTIONS[name])
    # Other samples of the same area: 16,384 of them leave differences below 1 %.
    assert change(first, shd_descriptor(soup, OPTIONS[name])) < 0.02
    unused = MeshArrays(np.concatenate((mesh.vertices, [[1e200, 0, 0]])), mesh.triangles)
    np.testing.assert_array_equal(shd_descriptor(unused, OPTIONS[name]), first)


def test_a_cloud_is_closest_to_its_own_surface(rng):
    meshes = [bumpy(), ell(), u_shape(), torus()]
    known = np.stack([shd_descriptor(mesh, BEST) for mesh in meshes])
    clouds = []
    for mesh in meshes:
        points, _ = area_samples(mesh, 12_000)
        # Half of the points left out on one side of the centroid: density is not part of the shape.
        clouds.append(PointArrays(points[(points[:, 0] > points[:, 0].mean()) | (rng.random(12_000) < 0.5)]))
    distance = descriptor_distances(np.stack([shd_descriptor(cloud, BEST) for cloud in clouds]), known, BEST)
    assert (distance.argmin(axis=1) == np.arange(4)).all()
    # Clouds lack nothing but exactness: far less than the distance between shapes.
    others = distance + np.diag(np.full(4, np.inf))
    assert (np.diag(distance) < 0.4 * others.min(axis=1)).all()


def test_samples_that_are_the_same_shape_find_each_other():
    names = ["gem.stl", "bennu_like.ply", "stone_degree8.ply", "horn.off", "vase_quads.obj", "starfish.ply"]
    known = np.stack([shd_descriptor(read_geometry_arrays(SAMPLES / name, isolated=False), BEST) for name in names])
    for name, expected in (("gem_rotated.stl", 0), ("bennu_like_low.ply", 1), ("stone_cloud.xyzn", 2)):
        query = shd_descriptor(read_geometry_arrays(SAMPLES / name, isolated=False), BEST)
        assert descriptor_distances(query, known, BEST)[0].argmin() == expected


def test_grids_can_be_swapped():
    """Equiangular with Driscoll–Healy weights (the paper's SHD-ESH) measures the same energies."""
    fibonacci = SHDOption(bandwidth=12)
    equiangular = dataclasses.replace(fibonacci, grid=equiangular_grid(12), weights=driscoll_healy_weights(12))
    first, second = (compute_shd_feature(bumpy(), option).data for option in (fibonacci, equiangular))
    # Both integrate degrees < 12 exactly; what differs is how degrees beyond are aliased.
    assert 0 < change(first, second) < 0.01
    analytic = dataclasses.replace(fibonacci, grid=fibonacci_grid(864))
    np.testing.assert_array_equal(compute_shd_feature(bumpy(), analytic).data, first)


def test_more_fields_frames_and_bands_are_more_columns():
    option = SHDOption(
        bandwidth=4, shells=8, widths=(0.2, 0.5), normal_width=0.5, frames=(0.0, 1.0), bands=2, voxels=32
    )
    data = compute_shd_feature(ell(), option).data
    assert option.feature_shape == (4, 2 * 3 * 2)
    # Each field of each frame has unit norm before the whole is normalised.
    fields = np.linalg.norm(data.reshape(4, 6, 2), axis=(0, 2))
    np.testing.assert_allclose(fields, fields[0], rtol=1e-12)


@pytest.mark.parametrize("name", list(OPTIONS))
def test_same_bytes_for_any_number_of_threads(name):
    descriptors = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            descriptors.append(shd_descriptor(u_shape(), OPTIONS[name]))
    np.testing.assert_array_equal(*descriptors)


SHEET = MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]]), [[0, 1, 2], [0, 2, 3]])
TRIANGLE = MeshArrays(np.eye(3), [[0, 1, 2]])
RANDOM = np.random.default_rng(5).random((300, 3, 3))


@pytest.mark.parametrize("name", list(OPTIONS))
@pytest.mark.parametrize(
    "geometry",
    [
        TRIANGLE,
        SHEET,
        joined(TRIANGLE, moved(TRIANGLE, np.eye(3), 1e-3, (1e3, 0, 0))),
        MeshArrays(RANDOM.reshape(-1, 3), np.arange(900).reshape(-1, 3)),
        MeshArrays((RANDOM * [1, 1e-3, 1e-3]).reshape(-1, 3), np.arange(900).reshape(-1, 3)),
        PointArrays(np.linspace(0, 1, 30)[:, None] * [1, 2, 3]),
        PointArrays(np.eye(3)[:2]),
        PointArrays(RANDOM[0] * [1, 1, 0]),
    ],
    ids=[
        "triangle",
        "sheet",
        "far apart",
        "self-intersecting",
        "needles",
        "line of points",
        "two points",
        "three points",
    ],
)
def test_degenerate_geometry_has_a_finite_feature(geometry, name):
    vector = shd_descriptor(geometry, OPTIONS[name])
    assert np.isfinite(vector).all()
    assert np.abs(vector).sum() > 0


@pytest.mark.parametrize(
    "geometry",
    [
        MeshArrays(np.arange(9.0).reshape(3, 3), [[0, 1, 2]]),
        MeshArrays(np.eye(3), [[0, 1, 1], [2, 2, 0]]),
        PointArrays(np.ones((1, 3))),
    ],
    ids=["line", "no area", "one point"],
)
def test_what_has_no_area_or_extent_is_refused(geometry):
    with pytest.raises(GeometryError, match=r"no (area|extent)"):
        shd_descriptor(geometry, BEST)


def test_what_is_no_geometry_is_refused():
    broken = open3d().geometry.TriangleMesh()
    with pytest.raises(GeometryError, match="empty"):
        compute_shd_feature(broken)
    broken.vertices = open3d().utility.Vector3dVector(np.full((3, 3), np.nan))
    broken.triangles = open3d().utility.Vector3iVector(np.array([[0, 1, 2]]))
    with pytest.raises(GeometryError, match="finite"):
        compute_shd_feature(broken)
    with pytest.raises(TypeError, match="TriangleMesh"):
        compute_shd_feature(object())
    with pytest.raises(TypeError, match="SHDOption"):
        compute_shd_feature(ell(), "best")


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"bandwidth": 0}, ValueError, "bandwidth must be"),
        ({"bandwidth": 2.5}, TypeError, "bandwidth must be an integer"),
        ({"shells": 0}, ValueError, "shells must be"),
        ({"bands": 5}, ValueError, "bands must divide"),
        ({"bands": 64}, ValueError, "bands must be"),
        ({"grid": "fibonacci"}, TypeError, "grid must be a SphericalGrid"),
        ({"weights": np.ones(4)}, ValueError, "weights belong to a grid"),
        ({"grid": fibonacci_grid(600), "weights": np.ones(4)}, ValueError, "weights must have shape"),
        ({"route": "exact", "distance": "soft"}, ValueError, "voxel route only"),
        ({"widths": 0.5}, TypeError, "widths must be a tuple"),
        ({"frames": ()}, ValueError, "frames must be"),
        ({"frames": (3.0,)}, ValueError, "frames must be"),
        ({"flatness": 0}, ValueError, "flatness must be"),
        ({"samples": 1}, ValueError, "samples must be"),
        ({"shell_scaling": "r"}, ValueError, "shell_scaling must be one of"),
        ({"invariant": "all"}, ValueError, "invariant must be one of"),
        ({"metric": "l3"}, ValueError, "metric must be one of"),
        ({"normalisation": "max"}, ValueError, "normalisation must be one of"),
        ({"power": 0}, ValueError, "power must be"),
        ({"epsilon": -1}, ValueError, "epsilon must be"),
        ({"covariance": 1}, TypeError, "covariance must be True or False"),
        ({"covariance": True, "bandwidth": 2}, ValueError, "bandwidth >= 3"),
        ({"covariance": True, "invariant": "cross_shell"}, ValueError, "covariance replaces"),
    ],
    ids=str,
)
def test_bad_options_are_refused(changes, error, message):
    with pytest.raises(error, match=message):
        SHDOption(**changes)


def test_fingerprints_tell_options_apart():
    different = [
        SHDOption(),
        *(SHDOption(**changes) for changes in ({"bandwidth": 8}, {"shells": 16}, {"widths": (0.2,)}, {"epsilon": 0.1})),
        SHDOption(grid=fibonacci_grid(600)),
        SHDOption(grid=fibonacci_grid(600), weights=equal_weights(fibonacci_grid(600))),
        SHDOption(metric="l2"),
        BEST,
        SHDOption.published(),
        OPTIONS["best exact"],
    ]
    assert len({option.fingerprint for option in different}) == len(different)
    assert len(set(different)) == len(different)
    same = SHDOption(bandwidth=np.int64(16), radius=2, widths=[np.sqrt(2) / 8])
    assert same == SHDOption()
    assert hash(same) == hash(SHDOption())
    assert same != "SHDOption()"
    assert SHDOption(distance="soft") == SHDOption()
    assert SHDOption(route="exact") == SHDOption(route="exact", distance="nearest") != SHDOption(distance="nearest")


def test_options_travel_between_processes():
    option = SHDOption(grid=fibonacci_grid(600), weights=equal_weights(fibonacci_grid(600)))
    assert pickle.loads(pickle.dumps(option)) == option


def test_fingerprint_is_the_same_in_every_process():
    code = "from fsh3d_o3d.descriptors import SHDOption; print(SHDOption.best().fingerprint)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    )
    assert done.stdout.strip() == BEST.fingerprint


def test_weights_are_copied_and_read_only():
    weights = equal_weights(fibonacci_grid(600))
    option = SHDOption(bandwidth=8, grid=fibonacci_grid(600), weights=weights)
    weights[0] = 5
    assert option.weights[0] != 5
    assert not option.weights.flags.writeable


@pytest.mark.parametrize("metric", ["l1", "l2"])
def test_distances(rng, metric):
    option = SHDOption(bandwidth=2, shells=3, metric=metric)
    first, second = rng.random((4, 6)), rng.random((5, 6))
    difference = np.abs(first[:, None] - second)
    expected = difference.sum(axis=2) if metric == "l1" else np.sqrt((difference**2).sum(axis=2))
    np.testing.assert_allclose(descriptor_distances(first, second, option), expected, rtol=1e-12)
    np.testing.assert_allclose(descriptor_distances(first[0], second, option), expected[:1], rtol=1e-12)
    with pytest.raises(ValueError, match="first must have shape"):
        descriptor_distances(first[:, :5], second, option)
    with pytest.raises(ValueError, match="second must be finite"):
        descriptor_distances(first, second * np.nan, option)
    with pytest.raises(ValueError, match="second must have shape"):
        descriptor_distances(first, second[None], option)
