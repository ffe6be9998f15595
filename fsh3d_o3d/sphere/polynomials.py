"""Harmonics of low degree as polynomials of x, y, z: no angles, no recursion, float32 where that is enough."""

from __future__ import annotations

import functools
import math

import numpy as np

from fsh3d_o3d._validation import FloatArray

_VANISHING = 1e-12  # of coefficients of order one and more; below, they are zeros with rounding


def polynomial_harmonics(directions: FloatArray, bandwidth: int) -> FloatArray:
    """Evaluate every harmonic of degree < b: (3, n) rows x, y, z of unit vectors → (b², n), row l² + l + m.

    As ``spherical_harmonics``, but several times faster for few degrees, in the type of what is given. With Q(l, m)
    the m-th derivative of the Legendre polynomial and its factor, Y(l, m) is Q(z) Re (x + iy)^m, Y(l, −m) the same with
    the imaginary part.
    """
    x, y, z = directions
    rows = np.empty((bandwidth**2, len(z)), dtype=directions.dtype)
    powers = [z]
    for _ in range(2, bandwidth):
        powers.append(powers[-1] * z)
    real, imaginary = x, y
    for m in range(bandwidth):
        if m > 1:
            real, imaginary = real * x - imaginary * y, real * y + imaginary * x
        for degree in range(m, bandwidth):
            centre = degree * degree + degree
            constant, terms = _legendre_factor(degree, m)
            sum_ = rows[centre + m]
            sum_.fill(constant)
            for power, factor in terms:
                sum_ += powers[power - 1] * directions.dtype.type(factor)
            if m:
                np.multiply(sum_, imaginary, out=rows[centre - m])
                sum_ *= real
    return rows


@functools.cache
def _legendre_factor(degree: int, order: int) -> tuple[float, tuple[tuple[int, float], ...]]:
    """The m-th derivative of the Legendre polynomial, orthonormal: its constant, and exponents with their factors."""
    series = np.polynomial.Legendre.basis(degree).convert(kind=np.polynomial.Polynomial)
    series = series.deriv(order) if order else series
    ratio = math.factorial(degree - order) / math.factorial(degree + order)
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * ratio * (2 if order else 1))
    factors = [norm * float(factor) for factor in series.coef]
    terms = tuple((power, factor) for power, factor in enumerate(factors) if power and abs(factor) > _VANISHING)
    return (factors[0] if abs(factors[0]) > _VANISHING else 0.0), terms
