"""Points averaged in the cells of a lattice, and the areas they stand for."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fsh3d_o3d.geometry import thinned_surface, voxel_cells, voxel_means


def test_means_are_those_of_the_cells() -> None:
    points = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1], [1.5, 0.5, 0.5], [-0.5, 0.5, 0.5]])
    np.testing.assert_allclose(voxel_means(points, 1.0), [[-0.5, 0.5, 0.5], [0.2, 0.2, 0.2], [1.5, 0.5, 0.5]])


def test_far_apart_is_no_harder() -> None:
    points = np.array([[1e30, 0.0, 0.0], [0.0, 1e30, 0.0], [0.0, 0.0, -1e30], [0.0, 1e30, 0.0]])
    order, start = voxel_cells(points, 1.0)
    assert sorted(map(sorted, np.split(order, start[1:]))) == [[0], [1, 3], [2]]


def test_areas_add_up_whatever_the_density() -> None:
    random = np.random.default_rng(0)
    square = np.concatenate((random.uniform(size=(20000, 3)), random.uniform((0.5, 0, 0), 1, size=(60000, 3))))
    square[:, 2] = 0
    turned = square @ Rotation.from_euler("xyz", [0.5, 1.0, 0.3]).as_matrix().T
    surface = thinned_surface(turned, 0.02)
    here = surface.points @ Rotation.from_euler("xyz", [0.5, 1.0, 0.3]).as_matrix()
    turn = Rotation.from_euler("xyz", [0.5, 1.0, 0.3]).as_matrix()
    np.testing.assert_allclose(np.abs(surface.normals @ turn[:, 2]), 1, atol=1e-6)
    for sparse_or_dense in (slice(0.1, 0.4), slice(0.6, 0.9)):
        inside = (here[:, 0] > sparse_or_dense.start) & (here[:, 0] < sparse_or_dense.stop)
        inside &= (here[:, 1] > 0.1) & (here[:, 1] < 0.9)
        # 0.3 × 0.8 in squares of 0.02 by 0.02.
        assert abs(surface.areas[inside].sum() / (0.3 * 0.8 / 0.02**2) - 1) < 0.03
