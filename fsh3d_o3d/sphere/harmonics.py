"""Real orthonormal spherical harmonics without the Condon–Shortley phase.

For m >= 0 with N the orthonormal factor and P the associated Legendre function without phase,

    Y(l, 0) = N P,   Y(l, m) = √2 N P cos mφ,   Y(l, −m) = √2 N P sin mφ,

at index l² + l + m. Values come from the three-term recursion in l, started at m = l, in the orthonormal scaling,
which is stable in the forward direction (Holmes and Featherstone 2002).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, IntArray

__all__ = ["degrees_and_orders", "spherical_harmonics"]

MAXIMUM_RECURSION = 1900
"""Bandwidth up to which the recursion holds: beyond, (sin θ)^m underflows where the harmonic does not."""
_CHUNK = 512  # points at a time, a choice, so that the recursion stays in the processor's cache


def spherical_harmonics(directions: object, bandwidth: int) -> Float64Array:
    """Evaluate every harmonic of degree < b at given directions.

    Args:
        directions: (n, 3) unit vectors.
        bandwidth: b, up to 1900; ``evaluate`` has no such limit.

    Returns:
        (n, b²) float64, column l² + l + m.

    Raises:
        ValueError: Directions are not unit vectors, or the bandwidth is out of range.
        MemoryEstimateError: The matrix would not fit.

    Example:
        >>> grid = fsh.fibonacci_grid(200)
        >>> Y = fsh.spherical_harmonics(grid.directions, 4)
        >>> weights = fsh.analytic_weights(grid, 4).weights
        >>> np.allclose(Y.T @ (weights[:, None] * Y), np.eye(16))  # orthonormal
        True
    """
    b = check.integer(bandwidth, "bandwidth", minimum=1, maximum=MAXIMUM_RECURSION)
    vectors = check.directions(directions)
    check.memory(8.0 * len(vectors) * b * b * 2.1, f"the matrix of {b * b} harmonics at {len(vectors)} directions")
    rows = np.empty((b * b, len(vectors)))
    for degree, cosine, sine in harmonics_by_degree(vectors, b):
        rows[degree * degree + degree : (degree + 1) ** 2] = cosine
        rows[degree * degree : degree * degree + degree] = sine[::-1]
    return np.ascontiguousarray(rows.T)


def degrees_and_orders(bandwidth: int) -> tuple[IntArray, IntArray]:
    """Return the degree l and order m of each of the b² coefficients, two (b²,) int64 arrays.

    Example:
        >>> degrees, orders = fsh.degrees_and_orders(3)
        >>> degrees
        array([0, 1, 1, 1, 2, 2, 2, 2, 2])
        >>> orders
        array([ 0, -1,  0,  1, -2, -1,  0,  1,  2])
    """
    b = check.bandwidth(bandwidth)
    index = np.arange(b * b)
    degree = np.sqrt(index).astype(np.int64)
    return degree, index - degree * degree - degree


def harmonics_by_degree(directions: Float64Array, bandwidth: int) -> Iterator[tuple[int, Float64Array, Float64Array]]:
    """Yield (l, cosine, sine) for l = 0 … b − 1: (l+1, n) harmonics of order 0 … l, and (l, n) of order −1 … −l.

    The arrays are fresh for each degree. Orders whose harmonic underflows near the poles are exactly zero there.
    """
    cosine, sine = _circular(directions, bandwidth)
    for degree, legendre in enumerate(_legendre_by_degree(directions, bandwidth)):
        yield degree, legendre * cosine[: degree + 1], legendre[1:] * sine[1 : degree + 1]


def analyse_exactly(directions: Float64Array, values: Float64Array, bandwidth: int) -> Float64Array:
    """Σ_j v_j Y(l, m; ω_j) to rounding, (n,) → (b²,), without holding the matrix of harmonics."""
    result = np.zeros(bandwidth**2)
    for start in range(0, len(values), _CHUNK):
        own = slice(start, start + _CHUNK)
        cosine, sine = (values[own] * factor for factor in _circular(directions[own], bandwidth))
        for degree, legendre in enumerate(_legendre_by_degree(directions[own], bandwidth)):
            centre = degree * degree + degree
            result[centre : centre + degree + 1] += np.einsum("mn,mn->m", legendre, cosine[: degree + 1])
            result[centre - degree : centre] += np.einsum("mn,mn->m", legendre[1:], sine[1 : degree + 1])[::-1]
    return result


def _circular(directions: Float64Array, bandwidth: int) -> tuple[Float64Array, Float64Array]:
    """√2 cos mφ and √2 sin mφ for m < b, (b, n) each; the rows of m = 0 are 1 and 0."""
    angle = np.arange(bandwidth, dtype=np.float64)[:, None] * np.arctan2(directions[:, 1], directions[:, 0])
    cosine, sine = np.cos(angle), np.sin(angle)
    cosine[1:] *= np.sqrt(2.0)
    sine[1:] *= np.sqrt(2.0)
    return cosine, sine


def _legendre_by_degree(directions: Float64Array, bandwidth: int) -> Iterator[Float64Array]:
    """Yield the orthonormal Legendre functions of order 0 … l for l = 0 … b − 1, (l+1, n).

    Each array is overwritten once the one after next is drawn: three buffers serve all degrees.
    """
    z, rho = directions[:, 2], np.hypot(directions[:, 0], directions[:, 1])
    buffers = np.empty((3, bandwidth, len(z)))
    buffers[0, 0] = np.sqrt(1 / (4 * np.pi))
    yield buffers[0, :1]
    m = np.arange(bandwidth, dtype=np.float64)[:, None]
    for degree in range(1, bandwidth):
        before, last, current = (buffers[(degree + shift) % 3] for shift in (1, 2, 0))
        up = np.sqrt((4 * degree**2 - 1) / (degree**2 - m[:degree] ** 2))
        np.multiply(z, last[:degree], out=current[:degree])
        if degree >= 2:
            inner = slice(0, degree - 1)
            before[inner] *= np.sqrt(((degree - 1) ** 2 - m[inner] ** 2) / (4 * (degree - 1) ** 2 - 1))
            current[inner] -= before[inner]
        current[:degree] *= up
        np.multiply(np.sqrt((2 * degree + 1) / (2 * degree)) * rho, last[degree - 1], out=current[degree])
        yield current[: degree + 1]
