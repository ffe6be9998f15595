"""Distances to the nearest point of a cloud, held to comparing all pairs."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry import nearest_distances


def every_pair(places, cloud):
    return np.linalg.norm(places[:, None] - cloud, axis=2).min(axis=1)


@pytest.mark.parametrize("count", [1, 2, 17, 3000])
def test_is_the_distance_to_the_nearest_point(rng, count):
    cloud, places = rng.standard_normal((count, 3)), rng.standard_normal((200, 3))
    assert nearest_distances(places, cloud) == pytest.approx(every_pair(places, cloud), abs=1e-15)


def test_copies_of_one_point_are_one_point():
    assert nearest_distances(np.zeros((2, 3)), np.full((5000, 3), 2.0), farthest=9.0) == pytest.approx(np.sqrt(12))


def test_only_what_is_certainly_farther_is_infinite(rng):
    cloud = fsh.fibonacci_grid(5000).directions * rng.uniform(0.98, 1.02, (5000, 1))
    places = rng.uniform(-1, 1, (2000, 3))
    exact, found = every_pair(places, cloud), nearest_distances(places, cloud, farthest=0.3)
    beyond = np.isinf(found)
    assert found[~beyond] == pytest.approx(exact[~beyond], abs=1e-15)
    assert exact[beyond].min() > 0.3
    assert beyond[exact > 0.5].all()  # the cells are finer than a fifth of the radius: the centre is not searched


def test_progress_ends_at_the_whole(rng):
    told: list[float] = []
    nearest_distances(rng.standard_normal((50_000, 3)), rng.standard_normal((10, 3)), progress=told.append)
    assert len(told) > 1
    assert told == sorted(told)
    assert told[-1] == 1.0
