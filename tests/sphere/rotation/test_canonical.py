"""Canonical poses: equivariance, margins, symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere.rotation.canonical import canonical_pose


def smooth(rng: np.random.Generator, functions: int, bandwidth: int = 12) -> np.ndarray:
    degree, _ = fsh.degrees_and_orders(bandwidth)
    return rng.standard_normal((functions, bandwidth**2)) * (degree + 1.0) ** -2


@pytest.mark.parametrize("functions", [1, 2, 8, 32])
def test_same_pose_from_any_rotation(functions: int, rng: np.random.Generator) -> None:
    coefficients = smooth(rng, functions)
    pose = canonical_pose(coefficients)
    assert pose.margin > 1e-6
    there = fsh.rotate_coefficients(coefficients, pose.rotation)
    for rotation in Rotation.random(5, rng=rng).as_matrix():
        other = canonical_pose(fsh.rotate_coefficients(coefficients, rotation))
        # Newton's method ends at the square of 1e-6.
        assert other.rotation @ rotation == pytest.approx(pose.rotation, abs=1e-8)
        assert other.margin == pytest.approx(pose.margin, abs=1e-8)
        again = fsh.rotate_coefficients(fsh.rotate_coefficients(coefficients, rotation), other.rotation)
        assert np.linalg.norm(again - there) < 1e-7 * np.linalg.norm(there)


def test_noise_moves_it_little(rng: np.random.Generator) -> None:
    moved = []
    for _ in range(10):
        coefficients = smooth(rng, 8)
        pose = canonical_pose(coefficients)
        if pose.margin < 0.02:
            continue
        noise = smooth(rng, 8)
        noise *= 1e-3 * np.linalg.norm(coefficients) / np.linalg.norm(noise)
        moved.append(np.linalg.norm(canonical_pose(coefficients + noise).rotation - pose.rotation))
    assert len(moved) >= 4
    # Balancing raises noise with the weak degrees; a hundredth of a radian is half a degree.
    assert max(moved) < 0.02


def test_symmetric_functions_come_to_the_same_pose_by_several_rotations(rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(10)
    directions = transform.grid.directions
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    coefficients = transform.forward(np.exp(5 * (directions @ corners.T)).sum(axis=1))
    pose = canonical_pose(coefficients)
    assert pose.margin == pytest.approx(0, abs=1e-9)
    assert pose.symmetries.is_symmetric
    there = fsh.rotate_coefficients(coefficients, pose)
    for rotation in Rotation.random(4, rng=rng).as_matrix():
        turned = fsh.rotate_coefficients(coefficients, rotation)
        again = fsh.rotate_coefficients(turned, canonical_pose(turned))
        assert np.linalg.norm(again - there) < 1e-6 * np.linalg.norm(there)


def test_weak_degrees_decide_what_strong_ones_leave_open(rng: np.random.Generator) -> None:
    """An ellipsoid, symmetric in its strong degree 2, with two percent of something else."""
    transform = fsh.SphericalHarmonicTransform(10)
    coefficients = transform.forward(1 / np.linalg.norm(transform.grid.directions / [1.0, 1.4, 2.0], axis=1))
    other = smooth(rng, 1, 10)[0]
    other[:4] = 0
    coefficients = coefficients + 0.02 * np.linalg.norm(coefficients) / np.linalg.norm(other) * other
    pose = canonical_pose(coefficients)
    assert pose.margin > 0.003
    rotation = Rotation.random(rng=rng).as_matrix()
    found = canonical_pose(fsh.rotate_coefficients(coefficients, rotation))
    assert found.rotation @ rotation == pytest.approx(pose.rotation, abs=1e-7)


def test_a_pose_is_its_matrix(rng: np.random.Generator) -> None:
    pose = canonical_pose(smooth(rng, 3))
    assert np.array_equal(np.asarray(pose), pose.rotation)
    assert np.asarray(pose, dtype=np.float32).dtype == np.float32
    copy = np.array(pose)
    copy[:] = 0
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    with pytest.raises(ValueError, match="read-only"):
        pose.rotation[0] = 0


def test_size_and_mean_do_not_matter(rng: np.random.Generator) -> None:
    coefficients = smooth(rng, 4)
    pose = canonical_pose(coefficients)
    changed = 1e-100 * coefficients
    changed[:, 0] *= 3
    assert canonical_pose(changed).rotation == pytest.approx(pose.rotation, abs=1e-8)
    low = canonical_pose(fsh.truncate(coefficients, 8))
    assert np.array_equal(low.rotation, pose.rotation)


def test_linear_function_points_somewhere(rng: np.random.Generator) -> None:
    coefficients = np.zeros(4)
    coefficients[1:] = rng.standard_normal(3)
    rotation = Rotation.random(rng=rng).as_matrix()
    turned = fsh.rotate_coefficients(coefficients, rotation)
    first = fsh.rotate_coefficients(coefficients, canonical_pose(coefficients))
    assert fsh.rotate_coefficients(turned, canonical_pose(turned)) == pytest.approx(first, abs=1e-7)
    assert canonical_pose(coefficients).symmetries.of_revolution


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        (np.eye(16)[0], "constant on the sphere"),
        (np.zeros(16), "coefficients are zero"),
        ([2.0], "constant on the sphere"),
        (np.ones(7), "coefficients must have shape"),
        (np.full(9, np.nan), "coefficients must be finite"),
    ],
)
def test_bad_input(coefficients: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        canonical_pose(coefficients)
