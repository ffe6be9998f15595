import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere_map.mobius import aligned, centered, inverted, normalized
from fsh3d_o3d.sphere_map.validity import is_valid


def weights_of(sphere):
    return 1 + 0.5 * np.sin(3 * sphere[:, 0] + sphere[:, 1])


def cross_ratio(points):
    a, b, c, d = points

    def gap(p, q):
        return np.linalg.norm(p - q)

    return gap(a, b) * gap(c, d) / (gap(a, c) * gap(b, d))


@given(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3))
def test_inversions_keep_cross_ratios_and_validity(center):
    sphere, triangles = icosphere(5)
    moved = inverted(sphere, np.array(center))
    four = [0, 40, 111, 200]
    # Distances of order 0.1 between points rounded to 1e-16.
    assert cross_ratio(moved[four]) == pytest.approx(cross_ratio(sphere[four]), rel=1e-12)
    assert is_valid(moved, triangles)


@given(st.lists(st.floats(-0.55, 0.55), min_size=3, max_size=3), st.integers(0, 1000))
def test_centering_undoes_any_mobius_transformation_up_to_a_rotation(center, seed):
    sphere, _ = icosphere(5)
    weights = weights_of(sphere)
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    once = centered(sphere, weights)
    again = centered(inverted(sphere @ rotation.T, np.array(center)), weights)
    # The mean is brought to 1e-12, which leaves as much of the transformation.
    np.testing.assert_allclose(weights @ once / weights.sum(), 0, atol=1e-12)
    np.testing.assert_allclose(weights @ again / weights.sum(), 0, atol=1e-12)
    np.testing.assert_allclose(again @ again.T, once @ once.T, atol=1e-10)


def test_centering_spreads_a_crowd():
    # Nearly all of the sphere within 1e-4 of a point: far from the origin, still centred.
    sphere, triangles = icosphere(8)
    crowded = inverted(sphere, np.array([0, 0, 0.9999]))
    assert np.linalg.norm(crowded.mean(axis=0)) > 0.99
    spread = centered(crowded, np.ones(len(sphere)))
    np.testing.assert_allclose(spread.mean(axis=0), 0, atol=1e-12)
    assert is_valid(spread, triangles)


def test_a_rotation_follows_the_surface(rng):
    sphere, _ = icosphere(5)
    weights = weights_of(sphere)
    vertices = sphere * (1, 1.5, 2.5) + (3, 4, 5)
    for seed in range(5):
        rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        # An orthogonal factor of a well-conditioned matrix: some ulps, times its condition.
        turned = aligned(sphere @ rotation.T, vertices, weights)
        np.testing.assert_allclose(turned, aligned(sphere, vertices, weights), atol=1e-13)
        with_surface = aligned(sphere, vertices @ rotation.T, weights)
        np.testing.assert_allclose(with_surface, turned @ rotation.T, atol=1e-13)
    np.testing.assert_allclose(aligned(sphere, vertices, np.ones(len(sphere))), sphere, atol=1e-12)


def test_alignment_never_mirrors():
    sphere, _ = icosphere(5)
    turned = aligned(sphere, -sphere * (1, 2, 3), np.ones(len(sphere)))
    change = np.linalg.lstsq(sphere, turned, rcond=None)[0]
    assert np.linalg.det(change) == pytest.approx(1)


def test_normalized():
    np.testing.assert_allclose(normalized(np.array([[3.0, 0, 4]])), [[0.6, 0, 0.8]], rtol=1e-15)
