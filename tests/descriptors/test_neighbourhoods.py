"""Local harmonics: they turn with the shape, and only what lies near matters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.descriptors import local_harmonics
from fsh3d_o3d.descriptors.neighbourhoods import neighbourhoods

DEGREE, ORDER = fsh.degrees_and_orders(5)
MIRRORED = DEGREE * DEGREE + DEGREE - ORDER  # the coefficient of order −m
TURN = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
SHIFT = np.array([3.0, -1.0, 2.0])


def surface(count: int, seed: int = 0) -> np.ndarray:
    """Points on a rugged sphere."""
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    height = 0.2 * np.sin(5 * x + 1) * np.cos(4 * y) + 0.15 * np.sin(7 * z + 2 * x) + 0.1 * np.sin(9 * y - 4 * z)
    return directions * (1 + height)[:, None]


def test_coefficients_are_sums_of_harmonics_in_the_frames() -> None:
    points = surface(3000)
    keys, areas = points[:5], np.linspace(0.5, 1.5, 3000)
    found = neighbourhoods(points, areas, keys, 0.4, bandwidth=4, shells=2)
    for key, frame, coefficients, count in zip(keys, found.frames, found.coefficients, found.counts, strict=True):
        near = (points - key) @ frame.T / 0.4
        distance = np.linalg.norm(near, axis=1)
        assert count == np.count_nonzero(distance**2 <= 1.001)
        inside = (distance > 0) & (distance <= 1)
        values = fsh.spherical_harmonics(near[inside] / distance[inside, None], 4)
        # Hats of width 1/2.75 of the radius, the first 0.75 widths out.
        for shell in range(2):
            window = np.maximum(1 - np.abs(2.75 * distance[inside] - shell - 0.75), 0)
            np.testing.assert_allclose(
                coefficients[shell], (window * areas[inside]) @ values, atol=2e-4
            )  # float32 sums


def test_what_is_beyond_three_radii_changes_nothing() -> None:
    points = surface(4000)
    keys = points[np.argsort(points[:, 0])[:40]]  # one side
    far = np.random.default_rng(1).uniform(-3, 3, size=(3000, 3))
    far = far[np.linalg.norm(far[:, None] - keys, axis=2).min(axis=1) > 0.9]
    alone = local_harmonics(points, 0.3, keypoints=keys)
    among = local_harmonics(np.concatenate((far, points)), 0.3, keypoints=keys)
    assert np.array_equal(alone.feature, among.feature)
    assert np.array_equal(alone.coefficients, among.coefficients)


def test_clutter_beyond_the_radius_changes_little() -> None:
    points = surface(10000)
    keys = points[np.argsort(points[:, 0])[:40]]
    near = np.random.default_rng(1).uniform(-2, 2, size=(3000, 3))
    near = near[np.linalg.norm(near[:, None] - keys, axis=2).min(axis=1) > 0.3]
    alone = local_harmonics(points, 0.3, keypoints=keys)
    among = local_harmonics(np.concatenate((near, points)), 0.3, keypoints=keys)
    # Only the densities see it, that the areas of points come from.
    assert np.linalg.norm(among.feature - alone.feature, axis=1).max() < 0.1


def test_density_changes_little() -> None:
    points = surface(40000)
    sparse = points[np.random.default_rng(2).uniform(size=40000) < 0.2 + 0.8 * (points[:, 2] > 0)]
    keys = points[np.abs(points[:, 2]) < 0.3][:60]
    here, there = (local_harmonics(cloud, 0.5, keypoints=keys).feature for cloud in (points, sparse))
    assert np.mean((here @ there.T).argmax(axis=1) == np.arange(60)) > 0.7  # a step of five times within the radius


def test_turning_the_points_turns_the_coefficients() -> None:
    points = surface(3000)
    here = neighbourhoods(points, np.ones(3000), points[:50], 0.4, bandwidth=5, shells=3)
    there = neighbourhoods(points @ TURN.T, np.ones(3000), points[:50] @ TURN.T, 0.4, bandwidth=5, shells=3)
    # The same normal, up to its sign; the axes beside it are chosen by the coordinates.
    assert np.abs(np.einsum("ki,ki->k", here.frames[:, 2] @ TURN.T, there.frames[:, 2])).min() > 1 - 1e-9
    size = np.hypot(here.coefficients, here.coefficients[:, :, MIRRORED])
    np.testing.assert_allclose(np.hypot(there.coefficients, there.coefficients[:, :, MIRRORED]), size, atol=1e-3)


def test_key_points_know_themselves_after_turning() -> None:
    points = surface(20000)
    here = local_harmonics(points, 0.4, keypoints=points[:100])
    there = local_harmonics(points @ TURN.T + 5, 0.4, keypoints=points[:100] @ TURN.T + 5)
    nearest = (here.feature @ there.feature.T).argmax(axis=1)
    assert np.mean(nearest == np.arange(100)) > 0.9  # the lattice that thins the points lies another way


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_features_do_not_depend_on_the_unit(scale: float) -> None:
    points = surface(5000)
    here = local_harmonics(points, 0.4, keypoints=100)
    there = local_harmonics(points * scale, 0.4 * scale, keypoints=100)
    np.testing.assert_allclose(there.points, here.points * scale, rtol=1e-9)
    np.testing.assert_allclose(there.feature, here.feature, atol=1e-4)
