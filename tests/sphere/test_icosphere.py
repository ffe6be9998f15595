"""The subdivided icosahedron: counts, topology, orientation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import fsh3d_o3d as fsh


@pytest.mark.parametrize("f", [1, 2, 3, 5, 16])
def test_closed_oriented_and_complete(f: int) -> None:
    directions, triangles = fsh.icosphere(f)
    assert directions.shape == (10 * f * f + 2, 3)
    assert triangles.shape == (20 * f * f, 3)
    assert np.abs(np.linalg.norm(directions, axis=1) - 1).max() < 1e-15
    edges = {(int(a), int(b)) for a, b in np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])}
    assert len(edges) == 60 * f * f  # every directed edge once: manifold and consistently oriented
    assert edges == {(b, a) for a, b in edges}
    a, b, c = (directions[triangles[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    assert volume.min() > 0  # outward
    solid = 2 * np.arctan2(
        volume, 1 + np.einsum("ij,ij->i", a, b) + np.einsum("ij,ij->i", b, c) + np.einsum("ij,ij->i", c, a)
    )
    assert solid.sum() == pytest.approx(4 * np.pi, rel=1e-13)  # the triangles cover the sphere once


def test_single_points_are_not_doubled() -> None:
    directions, _ = fsh.icosphere(12)
    distance, _ = cKDTree(directions).query(directions, k=2)
    assert distance[:, 1].min() > 0.5 * np.sqrt(4 * np.pi / len(directions))


def test_corners_are_the_icosahedron() -> None:
    directions, _ = fsh.icosphere(1)
    cosines = np.sort((directions @ directions.T).ravel())
    expected = np.repeat([-1, -1 / np.sqrt(5), 1 / np.sqrt(5), 1], [12, 60, 60, 12])
    assert np.abs(cosines - expected).max() < 1e-15
    assert directions[0].tolist() == [0, 0, 1]


def test_each_call_gives_arrays_of_its_own() -> None:
    """They are cached, and may be written into: Open3D takes no other."""
    for array, again in zip(fsh.icosphere(2), fsh.icosphere(2), strict=True):
        array[0] = 7
        assert not np.shares_memory(array, again)
    for array, again in zip(fsh.icosphere(2), fsh.icosphere(2), strict=True):
        np.testing.assert_array_equal(array, again)
        assert (array[0] != 7).any()


def test_the_frequency_is_checked() -> None:
    with pytest.raises(ValueError, match=r"frequency must be between 1 and 2000, got 0"):
        fsh.icosphere(0)
