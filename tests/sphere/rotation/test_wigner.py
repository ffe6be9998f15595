"""Wigner's D in packed form, against formulas written out and against rotation of coefficients."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere.rotation.wigner import euler_angles, wigner_table

POLES = np.stack([np.diag(signs) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]).astype(float)
NEARLY = Rotation.from_rotvec([[1e-9, -2e-9, 3e-10], [np.pi - 1e-9, 1e-10, 0], [1e-13, 0, 0]]).as_matrix()


def cases(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate((POLES, NEARLY, Rotation.random(5, rng=rng).as_matrix()))


def test_angles_give_the_rotation_back(rng: np.random.Generator) -> None:
    rotations = cases(rng)
    alpha, beta, gamma = euler_angles(rotations)
    assert ((beta >= 0) & (beta <= np.pi)).all()
    again = Rotation.from_euler("ZYZ", np.stack((alpha, beta, gamma), axis=1)).as_matrix()
    # A few roundings of numbers of order one.
    assert np.abs(again - rotations).max() < 2e-15


def test_table_holds_each_order_of_each_degree_once() -> None:
    table = wigner_table(5)
    found = sorted(zip(table.degree.tolist(), table.order.tolist(), table.other.tolist(), strict=True))
    expected = [(l, m, k) for l in range(5) for m in range(l + 1) for k in range(-l, l + 1)]  # noqa: E741
    assert found == expected


def test_low_degrees_written_out() -> None:
    table = wigner_table(3)
    beta = np.array([0.0, 0.3, 1.2, np.pi / 2, 2.9, np.pi])
    cosine, sine = np.cos(beta), np.sin(beta)
    written = {
        (0, 0, 0): np.ones(6),
        (1, 0, 0): cosine,
        (1, 1, 1): (1 + cosine) / 2,
        (1, 1, -1): (1 - cosine) / 2,
        (1, 1, 0): -sine / np.sqrt(2),
        (1, 0, 1): sine / np.sqrt(2),
        (2, 0, 0): (3 * cosine**2 - 1) / 2,
        (2, 1, 0): -np.sqrt(3 / 8) * np.sin(2 * beta),
        (2, 2, 0): np.sqrt(3 / 8) * sine**2,
        (2, 1, 1): (2 * cosine**2 + cosine - 1) / 2,
        (2, 2, -2): (1 - cosine) ** 2 / 4,
    }
    values = table.tilts(beta)
    for index, key in enumerate(zip(table.degree.tolist(), table.order.tolist(), table.other.tolist(), strict=True)):
        if key in written:
            # Sums of five cosines of order one.
            assert values[:, index] == pytest.approx(written.pop(key), abs=2e-15)
    assert not written


@pytest.mark.parametrize("bandwidth", [1, 2, 7, 16])
def test_rotates_complex_coefficients(bandwidth: int, rng: np.random.Generator) -> None:
    table = wigner_table(bandwidth)
    coefficients = rng.standard_normal(bandwidth**2)
    before = fsh.to_complex(coefficients)
    rotations = cases(rng)
    for rotation, matrix in zip(rotations, table(rotations), strict=True):
        after = fsh.to_complex(fsh.rotate_coefficients(coefficients, rotation))
        turned = np.zeros(bandwidth**2, dtype=complex)
        centre = table.degree**2 + table.degree
        np.add.at(turned, centre + table.order, matrix * before[centre + table.other])
        kept = np.unique(centre + table.order)
        # 2l + 1 products of order one, each with the rounding of its factors.
        assert np.abs(turned[kept] - after[kept]).max() < 1e-13


def test_rows_are_orthonormal(rng: np.random.Generator) -> None:
    table = wigner_table(32)
    matrix = table(Rotation.random(1, rng=rng).as_matrix())[0]
    for degree, order in ((31, 0), (31, 31), (20, 7)):
        own = (table.degree == degree) & (table.order == order)
        assert np.linalg.norm(matrix[own]) == pytest.approx(1, abs=1e-13)
