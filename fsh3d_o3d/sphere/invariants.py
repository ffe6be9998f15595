"""Rotation invariants of several functions on the sphere together."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere.coefficients import degree_energies


def gram_powers(coefficients: Float64Array, bandwidth: int, power: float, epsilon: float) -> Float64Array:
    """Fractional powers of the Gram matrices of R functions: (R, b²) → (b, R(R+1)/2).

    G_l = X_l X_lᵀ holds the inner products ⟨f_i, f_j⟩ of the functions' parts of degree l. A rotation multiplies X_l
    by an orthogonal matrix from the right, so G_l stays. With the singular values s of X_l, each becomes
    (s² + ε²)^p − ε^2p, which is G_l^p up to what ε damps: small values, that a small power would blow up.
    One row a degree: the upper triangle, row by row, with √2 off the diagonal, so that its norm is the matrix's.
    """
    upper = np.triu_indices(len(coefficients))
    scale = np.where(upper[0] == upper[1], 1.0, np.sqrt(2))
    rows = np.empty((bandwidth, len(scale)))
    for degree in range(bandwidth):
        part = coefficients[:, degree * degree : (degree + 1) ** 2]
        vectors, values, _ = np.linalg.svd(part, full_matrices=False)
        values = (values * values + epsilon**2) ** power - epsilon ** (2 * power)
        rows[degree] = ((vectors * values) @ vectors.T)[upper] * scale
    return rows


def energies(coefficients: Float64Array, *, quadratic: bool) -> Float64Array:
    """Energies of R functions, one column each: (R, b²) → (b, R), or (b + 1, R) with ``quadratic``.

    With ``quadratic``, the degrees 0 and 2, the quadratic form xᵀ A x on the sphere, give three numbers instead of two
    (Kazhdan, Funkhouser and Rusinkiewicz 2003): the eigenvalues of A from large to small in coordinates in which the
    distance of two triples is the L2 distance of the functions with their axes aligned. They are the first three rows;
    degrees 1, 3, 4, … follow.
    """
    rows = np.asarray(degree_energies(coefficients), dtype=np.float64)
    if not quadratic:
        return rows.T.copy()
    xy, yz, zz, xz, xx = np.sqrt(15 / np.pi) / 4 * coefficients[:, 4:9].T
    form = np.stack([xx - zz / np.sqrt(3), xy, xz, xy, -xx - zz / np.sqrt(3), yz, xz, yz, 2 * zz / np.sqrt(3)], axis=1)
    # A = c/√4π I + a part without trace, whose eigenvalues λ have the squared norm 8π/15 Σ λ² on the sphere.
    deviation = np.linalg.eigvalsh(form.reshape(-1, 3, 3))[:, ::-1] * np.sqrt(8 * np.pi / 15)
    triple = deviation + coefficients[:, :1] / np.sqrt(3)
    return np.concatenate((triple, rows[:, 1:2], rows[:, 3:]), axis=1).T.copy()
