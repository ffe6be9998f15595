"""Many rotations at once, each with functions of its own.

Degree l is the middle (2l+1) × (2l+1) part of a (2b−1) × (2b−1) matrix, orders −(b−1) … b−1, zero outside: small
bandwidths lose little by the padding, and one batched product does the work of a loop over rotations.
"""

from __future__ import annotations

import functools

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere.rotation.rotation import rotate_coefficients
from fsh3d_o3d.sphere.rotation.wigner import euler_angles

_QUARTER_TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # about x, takes z to y


def rotate_each(rows: Float64Array, rotations: Float64Array, *, inverse: bool = False) -> Float64Array:
    """Rotate coefficients (n or 1, R, b²) by rotations (n, 3, 3), or by their inverses: (n, R, b²).

    The same as ``rotate_coefficients`` one by one; faster for small bandwidths and few functions.
    """
    b = int(np.sqrt(rows.shape[-1]) + 0.5)
    matrices = _matrices(rotations, b)
    if not inverse:
        matrices = np.swapaxes(matrices, 2, 3)
    result = np.empty((len(rotations), *rows.shape[1:]))
    for degree in range(b):
        part, inner = slice(degree**2, (degree + 1) ** 2), slice(b - 1 - degree, b + degree)
        result[:, :, part] = rows[:, :, part] @ matrices[:, degree, inner, inner]
    return result


def _matrices(rotations: Float64Array, bandwidth: int) -> Float64Array:
    """The matrices D, (n, b, 2b−1, 2b−1), of rotations: the rotated coefficients are D c."""
    orders = np.arange(1.0 - bandwidth, bandwidth)
    alpha, beta, gamma = euler_angles(rotations)
    # R_y is R_z between two quarter turns about x, and R_z only mixes the orders m and −m.
    turn = _quarter_turn(bandwidth)
    middle = _turn_columns(turn, beta, orders) @ np.swapaxes(turn, 1, 2)
    left = np.swapaxes(_turn_columns(np.swapaxes(middle, 2, 3), -alpha, orders), 2, 3)
    return _turn_columns(left, gamma, orders)


@functools.lru_cache(maxsize=8)
def _quarter_turn(bandwidth: int) -> Float64Array:
    b = bandwidth
    columns = rotate_coefficients(np.eye(b * b), _QUARTER_TURN, threads=1).T
    result = np.zeros((b, 2 * b - 1, 2 * b - 1))
    for degree in range(b):
        part, inner = slice(degree**2, (degree + 1) ** 2), slice(b - 1 - degree, b + degree)
        result[degree, inner, inner] = columns[part, part]
    result.setflags(write=False)
    return result


def _turn_columns(matrices: Float64Array, angles: Float64Array, orders: Float64Array) -> Float64Array:
    """Matrices (…, b, 2b−1, 2b−1) times those of rotations about z by angles (n,)."""
    # Row −m, column m of the factor is sin mθ; both signs in one formula.
    phase = angles[:, None] * orders
    cosine, sine = np.cos(phase)[:, None, None], np.sin(phase)[:, None, None]
    return np.asarray(matrices * cosine + matrices[..., ::-1] * sine)
