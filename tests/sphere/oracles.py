"""Independent implementations that the sphere layer is held to: scipy's harmonics, sums written out."""

from __future__ import annotations

import numpy as np
from scipy.special import sph_harm_y_all


def angles(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = directions.T
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def complex_harmonics(directions: np.ndarray, bandwidth: int) -> np.ndarray:
    """scipy's harmonics with the Condon–Shortley phase, (n, b²), column l² + l + m."""
    table = sph_harm_y_all(bandwidth - 1, bandwidth - 1, *angles(directions))  # [l, m], negative m from the end
    return np.concatenate([table[l, np.arange(-l, l + 1)] for l in range(bandwidth)]).T  # noqa: E741


def real_harmonics(directions: np.ndarray, bandwidth: int) -> np.ndarray:
    """Orthonormal real harmonics without the phase, (n, b²), from scipy's complex ones."""
    table = complex_harmonics(directions, bandwidth)
    degree = np.repeat(np.arange(bandwidth), 2 * np.arange(bandwidth) + 1)
    order = np.arange(bandwidth**2) - degree**2 - degree
    positive = table[:, degree**2 + degree + np.abs(order)] * (-1.0) ** np.abs(order)
    return np.where(order == 0, positive.real, np.sqrt(2) * np.where(order > 0, positive.real, positive.imag))


def real_moments(directions: np.ndarray, values: np.ndarray, bandwidth: int) -> np.ndarray:
    """Σ_j v_j Y(l, m; ω_j), (b²,), in blocks of points that fit in memory."""
    sums = np.zeros((bandwidth, 2 * bandwidth - 1), dtype=complex)  # [l, m], negative m from the end
    for start in range(0, len(values), 128):
        own = slice(start, start + 128)
        sums += sph_harm_y_all(bandwidth - 1, bandwidth - 1, *angles(directions[own])) @ values[own]
    degree = np.repeat(np.arange(bandwidth), 2 * np.arange(bandwidth) + 1)
    order = np.arange(bandwidth**2) - degree**2 - degree
    positive = sums[degree, np.abs(order)] * (-1.0) ** np.abs(order)
    return np.where(order == 0, positive.real, np.sqrt(2) * np.where(order > 0, positive.real, positive.imag))


def misses(directions: np.ndarray, weights: np.ndarray, bandwidth: int) -> float:
    """Largest |ŝ(l, m) − e₀| of Eq. (8) over l < 2b."""
    spectrum = real_moments(directions, weights, 2 * bandwidth) / np.sqrt(4 * np.pi)
    spectrum[0] -= 1
    return float(np.abs(spectrum).max())


def scattered(rng: np.random.Generator, n: int) -> np.ndarray:
    """n random directions, uniformly distributed."""
    vectors = rng.standard_normal((n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def relative_l2(value: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(value - truth) / np.linalg.norm(truth))
