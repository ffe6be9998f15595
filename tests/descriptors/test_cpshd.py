"""The descriptor over a conformal map: analytic energies, invariances, options, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.descriptors.shd import CPSHDOption, compute_cpshd_feature, cpshd_descriptor, descriptor_distances
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_mesh
from fsh3d_o3d.sphere.grids import equiangular_grid, fibonacci_grid
from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere.weights import driscoll_healy_weights, equal_weights
from fsh3d_o3d.sphere_map.conformal_map import ConformalMapOption
from tests.geometry.mesh_shapes import bumpy, ell, torus

CONFORMAL = ConformalMapOption(area_weight=0)
SMALL = CPSHDOption(bandwidth=12)
ROTATION = Rotation.random(random_state=4).as_matrix()


def ball(stretch=(1.0, 1.0, 1.0)):
    points, triangles = icosphere(16)
    return MeshArrays(points * stretch, triangles)


def change(first, second):
    return np.linalg.norm(second - first) / np.linalg.norm(first)


def test_a_sphere_has_degree_one_alone_and_alike_in_all_axes():
    feature = compute_cpshd_feature(open3d_mesh(ball()), CPSHDOption(bandwidth=8, map=CONFORMAL))
    assert isinstance(feature, open3d().pipelines.registration.Feature)
    assert feature.data.shape == (24, 1)
    data = feature.data.reshape(8, 3)
    # The chords of 16² · 20 triangles lie below the sphere by 1e-3.
    np.testing.assert_allclose(data[1], np.sqrt(1 / 3), atol=1e-3)
    assert np.linalg.norm(np.delete(data, 1, axis=0)) < 5e-3


@pytest.mark.parametrize("form", ["axes", "pooled"])
def test_it_keeps_to_the_shape_alone(form):
    option = CPSHDOption(bandwidth=12, form=form)
    mesh = bumpy()
    expected = cpshd_descriptor(mesh, option)
    assert expected.shape == (12 * (3 if form == "axes" else 1),)
    assert np.linalg.norm(expected) == pytest.approx(1, rel=1e-6)
    moved = MeshArrays(3 * mesh.vertices @ ROTATION.T + (5, -2, 1), mesh.triangles)
    assert change(expected, cpshd_descriptor(moved, option)) < 5e-3  # the target of a rotation
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    shuffled = MeshArrays(mesh.vertices[order], np.argsort(order)[mesh.triangles])
    assert change(expected, cpshd_descriptor(shuffled, option)) < 5e-3


def test_pooled_is_the_norm_over_axes():
    axes = cpshd_descriptor(bumpy(), SMALL).reshape(12, 3)
    pooled = cpshd_descriptor(bumpy(), CPSHDOption(bandwidth=12, form="pooled"))
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), pooled, rtol=1e-5)


def test_the_longest_axis_comes_first():
    feature = cpshd_descriptor(ball((1.0, 3.0, 2.0)), SMALL).reshape(12, 3)
    assert feature[1, 0] > feature[1, 1] > feature[1, 2]


def test_equiangular_grid_gives_nearly_the_same():
    fibonacci = cpshd_descriptor(bumpy(), SMALL)
    other = CPSHDOption(bandwidth=12, grid=equiangular_grid(12), weights=driscoll_healy_weights(12))
    # Both are exact for degrees < 12; what is beyond aliases differently.
    assert 0 < change(fibonacci, cpshd_descriptor(bumpy(), other)) < 0.02


def test_what_is_not_of_genus_0_is_refused_or_repaired():
    with pytest.raises(GeometryError, match="genus 1"):
        cpshd_descriptor(torus(), SMALL)
    repaired = cpshd_descriptor(torus(), CPSHDOption(bandwidth=12, repair=24))
    assert np.isfinite(repaired).all()
    np.testing.assert_array_equal(
        cpshd_descriptor(ell(), SMALL), cpshd_descriptor(ell(), CPSHDOption(bandwidth=12, repair=24))
    )


def test_distances_and_equal_options():
    vectors = np.stack([cpshd_descriptor(mesh, SMALL) for mesh in (ball(), bumpy(), ell())])
    table = descriptor_distances(vectors, vectors, SMALL)
    assert np.diag(table).max() == 0
    assert (table + np.eye(3) > 0.01).all()
    assert CPSHDOption(bandwidth=12) == SMALL
    assert hash(CPSHDOption(bandwidth=12)) == hash(SMALL)
    others = [
        CPSHDOption(bandwidth=12, map=CONFORMAL),
        CPSHDOption(bandwidth=12, form="pooled"),
        CPSHDOption(bandwidth=12, repair=32),
        CPSHDOption(bandwidth=12, grid=fibonacci_grid(1000)),
        CPSHDOption(bandwidth=12, grid=fibonacci_grid(1000), weights=equal_weights(fibonacci_grid(1000))),
        CPSHDOption(bandwidth=12, metric="l2"),
    ]
    assert len({SMALL.fingerprint, *(option.fingerprint for option in others)}) == 7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bandwidth": 1}, "bandwidth"),
        ({"form": "xyz"}, "form"),
        ({"metric": "l3"}, "metric"),
        ({"repair": 4}, "repair"),
        ({"map": None}, "map"),
        ({"weights": np.ones(5)}, "grid"),
        ({"grid": fibonacci_grid(600), "weights": np.ones(5)}, "weights"),
    ],
)
def test_wrong_options_are_refused(changes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        CPSHDOption(**changes)


def test_wrong_input_is_refused():
    with pytest.raises(TypeError, match="point cloud"):
        compute_cpshd_feature(PointArrays(np.eye(3)))
    with pytest.raises(TypeError, match="CPSHDOption"):
        compute_cpshd_feature(ball(), "default")
