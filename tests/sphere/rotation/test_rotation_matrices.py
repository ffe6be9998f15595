"""Many rotations at once against one at a time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.sphere.rotation.rotation import rotate_coefficients
from fsh3d_o3d.sphere.rotation.rotation_matrices import rotate_each


@pytest.mark.parametrize("bandwidth", [1, 2, 5, 12])
def test_it_is_rotate_coefficients_one_by_one(bandwidth):
    angles = [
        (0, 0, 0),
        (0.3, 0, 0.2),
        (0.3, np.pi, 0.2),
        (1, 1e-9, 2),
        *Rotation.random(5, random_state=1).as_euler("ZYZ"),
    ]
    rotations = Rotation.from_euler("ZYZ", angles).as_matrix()
    rows = np.random.default_rng(0).standard_normal((len(rotations), 3, bandwidth**2))
    expected = np.stack([rotate_coefficients(own, turn) for own, turn in zip(rows, rotations, strict=True)])
    # Rounding of products of three matrices.
    np.testing.assert_allclose(rotate_each(rows, rotations), expected, atol=1e-13)
    np.testing.assert_allclose(rotate_each(expected, rotations, inverse=True), rows, atol=1e-13)
    same = rotate_each(rows[:1], rotations)
    np.testing.assert_allclose(same[-1], rotate_coefficients(rows[0], rotations[-1]), atol=1e-13)
