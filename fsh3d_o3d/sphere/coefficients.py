"""What is done to coefficients: energies, truncation, filtering by degree.

Coefficients are (…, b²) arrays of orthonormal real harmonics, index l² + l + m.
"""

from __future__ import annotations

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere.harmonics import degrees_and_orders

__all__ = [
    "degree_energies",
    "filter_coefficients",
    "heat_filter",
    "ideal_filter",
    "lanczos_filter",
    "truncate",
]


def degree_energies(coefficients: object) -> FloatArray:
    """Return the norm of each degree, √Σ_m c(l, m)²: (…, b²) → (…, b). Rotation leaves it unchanged.

    Raises:
        ValueError: The last axis is not a square number, or values are not finite.

    Example:
        >>> fsh.degree_energies([5.0, 0.0, 3.0, 4.0])  # degree 0, then the three orders of degree 1
        array([5., 5.])
    """
    values, b = check.coefficients(coefficients)
    starts = np.arange(b) ** 2
    # Scaled first, each degree by its largest, so that squares neither overflow nor vanish.
    largest = np.maximum.reduceat(np.abs(values), starts, axis=-1)
    scale = np.where(largest == 0, values.dtype.type(1), largest)
    scaled = values / np.repeat(scale, 2 * np.arange(b) + 1, axis=-1)
    energies = np.sqrt(np.add.reduceat(scaled**2, starts, axis=-1)) * largest
    return np.asarray(energies, dtype=values.dtype)


def truncate(coefficients: object, bandwidth: int) -> FloatArray:
    """Return the coefficients of degree < ``bandwidth``, a copy: (…, b²) → (…, bandwidth²).

    Raises:
        ValueError: There are fewer degrees than that.

    Example:
        >>> fsh.truncate(np.arange(9.0), 2)
        array([0., 1., 2., 3.])
    """
    values, b = check.coefficients(coefficients)
    kept = check.integer(bandwidth, "bandwidth", minimum=1, maximum=b)
    return values[..., : kept * kept].copy()


def filter_coefficients(coefficients: object, gain_per_degree: object) -> FloatArray:
    """Multiply each degree by a gain: (…, b²), (b,) → (…, b²).

    Args:
        coefficients: (…, b²).
        gain_per_degree: (b,) gains, for example from ``heat_filter``, or a function of the degrees (an int64 array).

    Raises:
        ValueError: Not one finite gain a degree.

    Example:
        >>> coefficients = np.ones(9)
        >>> fsh.filter_coefficients(coefficients, fsh.ideal_filter(3, 2))
        array([1., 1., 1., 1., 0., 0., 0., 0., 0.])
        >>> fsh.filter_coefficients(coefficients, lambda degree: 1 / (1 + degree)).round(2)
        array([1.  , 0.5 , 0.5 , 0.5 , 0.33, 0.33, 0.33, 0.33, 0.33])
    """
    values, b = check.coefficients(coefficients)
    given = gain_per_degree(np.arange(b)) if callable(gain_per_degree) else gain_per_degree
    gains = check.real_array(given, "gain_per_degree")
    if gains.shape != (b,):
        raise ValueError(f"gain_per_degree must have shape (b,) = ({b},), got {gains.shape}")
    degree, _ = degrees_and_orders(b)
    return values * gains.astype(values.dtype)[degree]


def ideal_filter(bandwidth: int, cutoff: int) -> Float64Array:
    """Gains that keep degrees below ``cutoff`` and drop the rest, (b,). Rings at sharp features.

    Example:
        >>> fsh.ideal_filter(5, 3)
        array([1., 1., 1., 0., 0.])
    """
    b = check.bandwidth(bandwidth)
    return (np.arange(b) < check.integer(cutoff, "cutoff", minimum=0)).astype(np.float64)


def heat_filter(bandwidth: int, time: float) -> Float64Array:
    """Gains of the heat kernel (the Gaussian on the sphere), exp(−t l(l+1)), (b,); no ringing (Bülow 2004).

    Example:
        >>> fsh.heat_filter(4, 0.1).round(3)
        array([1.   , 0.819, 0.549, 0.301])
    """
    b = check.bandwidth(bandwidth)
    degree = np.arange(b)
    rate = check.number(time, "time", minimum=0.0)
    with np.errstate(over="ignore"):  # an infinite exponent is a gain of 0
        return np.asarray(np.exp(-rate * (degree * (degree + 1.0))))


def lanczos_filter(bandwidth: int) -> Float64Array:
    """Lanczos σ factors sin(πl/b)/(πl/b), (b,): less ringing for a little sharpness.

    Example:
        >>> fsh.lanczos_filter(4).round(3)
        array([1.   , 0.9  , 0.637, 0.3  ])
    """
    b = check.bandwidth(bandwidth)
    return np.asarray(np.sinc(np.arange(b) / b))
