"""Matrices of rotations in the basis of real harmonics, all degrees of a bandwidth at once (private).

Degree l is the middle (2l+1) × (2l+1) part of a (2b−1) × (2b−1) matrix, orders −(b−1) … b−1, zero outside: small
bandwidths lose little by the padding, and one batched product does the work of a loop over degrees.
"""

from __future__ import annotations

import functools

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere.conventions import to_complex


@functools.lru_cache(maxsize=8)
def generators(bandwidth: int) -> Float64Array:
    """Derivatives of the matrices of rotations about x, y and z at the identity, (3, b, 2b−1, 2b−1), antisymmetric."""
    b = bandwidth
    result = np.zeros((3, b, 2 * b - 1, 2 * b - 1))
    basis = to_complex(np.eye(b * b)).T  # columns: complex coefficients of each real harmonic
    for degree in range(b):
        order = np.arange(-degree, degree)
        raising = np.diag(np.sqrt(degree * (degree + 1.0) - order * (order + 1.0)), -1)
        momenta = ((raising + raising.T) / 2, (raising - raising.T) / 2j, np.diag(np.arange(-degree, degree + 1.0)))
        part = slice(degree**2, (degree + 1) ** 2)
        unitary = basis[part, part]
        inner = slice(b - 1 - degree, b + degree)
        for axis, momentum in enumerate(momenta):
            result[axis, degree, inner, inner] = (unitary.conj().T @ (-1j * momentum) @ unitary).real
    result.setflags(write=False)
    return result


@functools.lru_cache(maxsize=8)
def _quarter_turn(bandwidth: int) -> Float64Array:
    """The matrices (b, 2b−1, 2b−1) of the quarter turn about x that takes z to y."""
    # exp(−π/2 G) through the eigenvectors of the Hermitian i G, whose eigenvalues are integers known exactly.
    values, vectors = np.linalg.eigh(1j * generators(bandwidth)[0])
    phases = np.exp(0.5j * np.pi * np.round(values))
    result = ((vectors * phases[:, None]) @ np.conj(np.swapaxes(vectors, 1, 2))).real
    degree = np.arange(bandwidth)[:, None, None]
    order = np.abs(np.arange(1 - bandwidth, bandwidth))
    inside = (order <= degree) & (order[:, None] <= degree)
    result = np.where(inside, result, 0.0)
    result.setflags(write=False)
    return result


def rotation_matrices(rotations: Float64Array, bandwidth: int) -> Float64Array:
    """Return the matrices D, (k, b, 2b−1, 2b−1), of rotations (k, 3, 3): D c is what ``rotate_coefficients`` gives."""
    orders = np.arange(1.0 - bandwidth, bandwidth)
    alpha = np.arctan2(rotations[:, 1, 2], rotations[:, 0, 2])
    beta = np.arctan2(np.hypot(rotations[:, 0, 2], rotations[:, 1, 2]), rotations[:, 2, 2])
    row = np.cos(alpha)[:, None] * rotations[:, 1] - np.sin(alpha)[:, None] * rotations[:, 0]
    gamma = np.arctan2(row[:, 0], row[:, 1])
    turn = _quarter_turn(bandwidth)
    middle = _turn_columns(turn, beta, orders) @ np.swapaxes(turn, 1, 2)
    left = np.swapaxes(_turn_columns(np.swapaxes(middle, 2, 3), -alpha, orders), 2, 3)
    return _turn_columns(left, gamma, orders)


def _turn_columns(matrices: Float64Array, angles: Float64Array, orders: Float64Array) -> Float64Array:
    """Matrices (…, b, 2b−1, 2b−1) times those of rotations about z by angles (k,)."""
    # Row −m, column m of the factor is sin mθ; both signs in one formula.
    phase = angles[:, None] * orders
    cosine, sine = np.cos(phase)[:, None, None], np.sin(phase)[:, None, None]
    return matrices * cosine + matrices[..., ::-1] * sine
