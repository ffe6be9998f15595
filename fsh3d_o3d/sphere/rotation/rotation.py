"""Rotation of functions on the sphere, exactly, coefficient by coefficient."""

from __future__ import annotations

import ducc0
import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere.conventions import packed_layout
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.rotation.wigner import euler_angles
from fsh3d_o3d.sphere.threads import resolve_threads, run_all

__all__ = ["reflect_coefficients", "rotate_coefficients"]

_ROWS = 16  # functions a job, a choice; fixed, so that results do not depend on the number of threads


def rotate_coefficients(coefficients: object, rotation: object, *, threads: int | None = None) -> FloatArray:
    """Return the coefficients of the rotated functions f'(ω) = f(Rᵀω): (…, b²) → (…, b²).

    What was in direction ω is in direction R ω afterwards. Exact: a Wigner matrix for each degree, applied by ducc0
    (Reinecke and Seljebotn, 2023); energies of degrees are kept to rounding. float32 stays float32.

    Args:
        coefficients: (…, b²).
        rotation: R, (3, 3), orthogonal to 1e-6 and of determinant +1; the nearest rotation is used.
        threads: At most this many; None: what the process may use.

    Raises:
        ValueError: Wrong shapes, values that are not finite, or R is no rotation (a reflection included: see
            ``reflect_coefficients``).

    Example:
        >>> coefficients = np.random.default_rng(0).normal(size=16)
        >>> R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
        >>> turned = fsh.rotate_coefficients(coefficients, R)
        >>> np.allclose(fsh.evaluate(turned, [[0, 1, 0]]), fsh.evaluate(coefficients, [[1, 0, 0]]))
        True
        >>> np.allclose(fsh.degree_energies(turned), fsh.degree_energies(coefficients))
        True
    """
    values, b = check.coefficients(coefficients)
    alpha, beta, gamma = (float(angle[0]) for angle in euler_angles(check.rotation(rotation)[None]))
    count = resolve_threads(threads)
    rows = values.reshape(-1, b * b)
    layout = packed_layout(b)
    result = np.empty_like(rows)

    def rotate(start: int) -> None:
        part = slice(start, start + _ROWS)
        packed = layout.pack(rows[part])
        rotated = ducc0.sht.rotate_alm(packed, b - 1, gamma, beta, alpha, nthreads=1)
        result[part] = layout.unpack(rotated)

    run_all([lambda start=start: rotate(start) for start in range(0, len(rows), _ROWS)], count)  # type: ignore[misc]
    return result.reshape(values.shape)


def reflect_coefficients(coefficients: object) -> FloatArray:
    """Return the coefficients of f'(ω) = f(−ω), the reflection through the origin: odd degrees change sign.

    With a rotation it gives every reflection: a matrix Q of determinant −1 acts as the rotation −Q and this.

    Example:
        >>> coefficients = np.random.default_rng(0).normal(size=16)
        >>> directions = np.eye(3)
        >>> reflected = fsh.evaluate(fsh.reflect_coefficients(coefficients), directions)
        >>> np.allclose(reflected, fsh.evaluate(coefficients, -directions))
        True
    """
    values, b = check.coefficients(coefficients)
    return np.asarray(values * parity(b).astype(values.dtype))


def parity(bandwidth: int) -> Float64Array:
    """(−1)^l of every coefficient, (b²,)."""
    return np.asarray(1.0 - 2.0 * (degrees_and_orders(bandwidth)[0] % 2), dtype=np.float64)
