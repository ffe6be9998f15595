"""Thinning: as good as random, and the same points in every order and every pose."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry.arrays import PointArrays
from fsh3d_o3d.geometry.thinning import thinned


def scan(count: int, rng: np.random.Generator) -> np.ndarray:
    """Hilly ground whose density falls with the distance from a scanner, and some birds far above it."""
    radius, angle = np.exp(rng.uniform(np.log(2), np.log(300), count)), rng.uniform(0, 2 * np.pi, count)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = 15 * np.sin(x / 60) * np.cos(y / 45)
    z[:20] += 400
    return np.stack([x, y, z], axis=1)


def test_the_same_points_in_every_pose_and_order(rng, random_rotation):
    points = scan(20_000, rng)
    kept = thinned(points, 5000)
    assert len(np.unique(kept)) == 5000
    turned = thinned(3 * points @ random_rotation.T + [1, 2, 3], 5000)
    # A point that lies within rounding, 1e-15, of a step's edge may change places; steps are 1e-5.
    assert len(np.intersect1d(kept, turned)) >= 4998
    # In single precision, as files have it, rounding moves one distance in some hundred to the next step.
    rounded = thinned(points.astype(np.float32).astype(np.float64), 5000)
    assert len(np.intersect1d(kept, rounded)) > 4500
    order = rng.permutation(len(points))
    assert points[order][thinned(points[order], 5000)].tobytes() == points[kept].tobytes()


@pytest.mark.parametrize("shape", ["sphere", "grid", "rows"])
def test_no_part_of_a_regular_cloud_is_preferred(shape):
    """All distances are equal on a sphere, and many on a grid; rows are what counting would fall into step with."""
    if shape == "sphere":
        points = fsh.fibonacci_grid(40_000).directions
    else:
        x, y = np.meshgrid(np.arange(200.0), np.arange(200.0) * (1 if shape == "grid" else 50))
        points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    kept = thinned(points, 10_000)
    low, high = points.min(axis=0), points.max(axis=0)
    for axis in range(3 if shape == "sphere" else 2):
        slab = np.minimum(16 * (points[:, axis] - low[axis]) / (high - low)[axis], 15).astype(int)
        share = np.bincount(slab[kept], minlength=16) / np.bincount(slab)
        # A quarter of some 2,500 points at random: 0.25 ± 0.009; of a grid in groups of eight mirror images, ± 0.025.
        assert np.abs(share - 0.25).max() < 0.06


def test_copies_count_once():
    points = np.repeat(np.arange(12.0).reshape(4, 3) * [1, -1, 1], 1000, axis=0)
    points[:500, 0] = -0.0
    assert sorted(map(tuple, points[thinned(points, 100)])) == [(0, -1, 2), (3, -4, 5), (6, -7, 8), (9, -10, 11)]
    assert len(thinned(points, 3)) == 3


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_tiny_and_huge(scale, rng):
    points = scan(2000, rng)
    assert len(np.intersect1d(thinned(scale / 1000 * points, 500), thinned(points, 500))) >= 498


def test_a_feature_of_many_points_turns_with_them(rng, random_rotation):
    """As that of fewer points does: by what voxels make of the pose. Near duplicates are within 0.05."""
    option = fsh.SHDOption.best()
    points = scan(130_000, rng)
    first, second = (fsh.shd_descriptor(PointArrays(cloud), option) for cloud in (points, points @ random_rotation.T))
    assert np.abs(first - second).sum() < 0.03
