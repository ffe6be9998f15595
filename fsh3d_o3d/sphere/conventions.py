"""Coefficients of real functions in the layouts of other software and of the paper.

Ours: real, orthonormal, no Condon–Shortley phase, index l² + l + m (m > 0 cosine, m < 0 sine, √2). The others:

- ``"condon_shortley"``: complex, index l² + l + m, for the harmonics of ``scipy.special.sph_harm_y``;
- ``"paper"``: complex, index l² + l + m, for the harmonics of the paper's Eq. (1), which are (−1)^m times those: its P
  carries the Condon–Shortley phase (as in the authors' MATLAB) and the factor (−1)^m in front cancels it;
- packed: complex, m >= 0 only, grouped by m, with the Condon–Shortley phase, as healpy and ducc0 store a_lm.

A real function has f̂(l, −m) = (−1)^m conj f̂(l, m) in all three.
"""

from __future__ import annotations

import functools
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import FloatArray, IntArray
from fsh3d_o3d.sphere.harmonics import degrees_and_orders

__all__ = ["from_complex", "from_packed", "to_complex", "to_packed"]

ComplexArray = NDArray[np.complexfloating[Any, Any]]
Convention = Literal["condon_shortley", "paper"]


def to_complex(coefficients: object, convention: Convention = "condon_shortley") -> ComplexArray:
    """Return (…, b²) real coefficients as (…, b²) complex ones, orders −l … l.

    Raises:
        ValueError: The last axis is not a square number, values are not finite, or the convention is unknown.

    Example:
        >>> real = np.array([1.0, 2.0, 0.0, 3.0])  # of degree 1: orders −1 (sine), 0, 1 (cosine)
        >>> fsh.to_complex(real).round(3)
        array([ 1.   +0.j   ,  2.121+1.414j,  0.   +0.j   , -2.121+1.414j])
    """
    check.choice(convention, "convention", ("condon_shortley", "paper"))
    values, b = check.coefficients(coefficients)
    degree, order = degrees_and_orders(b)
    centre = degree * degree + degree
    cosine, sine = values[..., centre + np.abs(order)], values[..., centre - np.abs(order)]
    scale = np.where(order == 0, 1.0, np.sqrt(0.5)) * np.where(order < 0, 1.0 - 2.0 * (order % 2), 1.0)
    if convention == "condon_shortley":
        scale = scale * (1.0 - 2.0 * (order % 2))
    scale = scale.astype(values.dtype)
    return np.asarray(scale * (cosine - 1j * np.sign(order).astype(values.dtype) * sine))


def from_complex(coefficients: object, convention: Convention = "condon_shortley") -> FloatArray:
    """Return the real coefficients of a real function from its complex ones; the inverse of ``to_complex``.

    Raises:
        ValueError: As for ``to_complex``, or the coefficients are not those of a real function (to 1e-6 of the
            largest).

    Example:
        >>> real = np.array([1.0, 2.0, 0.0, 3.0])
        >>> np.allclose(fsh.from_complex(fsh.to_complex(real)), real)
        True
    """
    check.choice(convention, "convention", ("condon_shortley", "paper"))
    values = np.asarray(check.unmasked(coefficients, "coefficients"))
    if values.dtype.kind not in "fiuc":
        raise TypeError(f"coefficients must be numbers, got dtype {values.dtype}")
    values = values.astype(np.complex64 if values.dtype == np.complex64 else np.complex128)
    real, b = check.coefficients(values.real)
    imaginary, _ = check.coefficients(values.imag)
    degree, order = degrees_and_orders(b)
    centre, size = degree * degree + degree, np.abs(order)
    phase = 1.0 - 2.0 * (size % 2) if convention == "condon_shortley" else np.ones(len(order))
    scale = (np.where(order == 0, 1.0, np.sqrt(2.0)) * phase).astype(real.dtype)
    result = np.where(order < 0, -imaginary[..., centre + size], real[..., centre + size]) * scale
    difference = np.abs(to_complex(result, convention) - values).max(initial=0.0)
    if difference > 1e-6 * np.abs(values).max(initial=0.0):
        raise ValueError(
            "coefficients are not those of a real function: "
            f"f̂(l, −m) differs from (−1)^m conj f̂(l, m) by up to {difference:.3g}"
        )
    return np.asarray(result, dtype=real.dtype)


def to_packed(coefficients: object) -> ComplexArray:
    """Return (…, b²) real coefficients in the layout of healpy and ducc0: (…, b(b+1)/2) complex, l_max = b − 1.

    Example:
        >>> fsh.to_packed(np.array([1.0, 2.0, 0.0, 3.0])).round(3)  # (0, 0), (1, 0), (1, 1)
        array([ 1.   +0.j   ,  0.   +0.j   , -2.121+1.414j])
    """
    values, b = check.coefficients(coefficients)
    return packed_layout(b).pack(values)


def from_packed(packed: object) -> FloatArray:
    """Return the real coefficients (…, b²) of packed ones (…, b(b+1)/2); the inverse of ``to_packed``.

    Raises:
        ValueError: The last axis is not b(b+1)/2 for any b, or values are not finite.

    Example:
        >>> real = np.arange(9.0)
        >>> np.allclose(fsh.from_packed(fsh.to_packed(real)), real)
        True
    """
    values = np.asarray(check.unmasked(packed, "packed coefficients"))
    size = values.shape[-1] if values.ndim else 0
    b = int((np.sqrt(8 * size + 1) - 1) / 2 + 0.5)
    if size == 0 or b * (b + 1) // 2 != size:
        raise ValueError(f"packed coefficients must have shape (…, b(b+1)/2), got {values.shape}")
    if values.dtype.kind not in "fiuc":
        raise TypeError(f"packed coefficients must be numbers, got dtype {values.dtype}")
    values = values.astype(np.complex64 if values.dtype == np.complex64 else np.complex128)
    if not np.isfinite(values).all():
        raise ValueError("packed coefficients must be finite")
    imaginary = np.abs(values.imag[..., :b]).max(initial=0.0)
    if imaginary > 1e-6 * np.abs(values).max(initial=0.0):
        raise ValueError(
            "packed coefficients are not those of a real function: "
            f"order 0 has imaginary parts of up to {imaginary:.3g}"
        )
    return packed_layout(b).unpack(values)


class PackedLayout:
    """Index arrays between the real layout and the packed one for one bandwidth."""

    def __init__(self, bandwidth: int) -> None:
        self.bandwidth = bandwidth
        degree = np.concatenate([np.arange(m, bandwidth) for m in range(bandwidth)])
        order = np.repeat(np.arange(bandwidth), bandwidth - np.arange(bandwidth))
        self._cosine: IntArray = degree * degree + degree + order
        self._sine: IntArray = degree * degree + degree - order
        self._phase = 1.0 - 2.0 * (order % 2)
        self._positive = order > 0
        self._scales: dict[tuple[float, str], FloatArray] = {}

    def pack(self, coefficients: FloatArray) -> ComplexArray:
        """a(l, m) = (−1)^m (c(l, m) − i c(l, −m)) / √2 for m > 0, c(l, 0) for m = 0."""
        scale = self._scale(np.sqrt(0.5), coefficients.dtype)
        complex_type = np.complex64 if coefficients.dtype == np.float32 else np.complex128
        result = np.empty((*coefficients.shape[:-1], len(scale)), dtype=complex_type)
        result.real = coefficients[..., self._cosine] * scale
        result.imag = coefficients[..., self._sine] * -scale
        result.imag[..., : self.bandwidth] = 0  # m = 0, which comes first
        return result

    def unpack(self, packed: ComplexArray) -> FloatArray:
        """The inverse of ``pack``."""
        real_type = np.float32 if packed.dtype == np.complex64 else np.float64
        scale = self._scale(np.sqrt(2.0), np.dtype(real_type))
        result = np.empty((*packed.shape[:-1], self.bandwidth**2), dtype=real_type)
        result[..., self._sine] = packed.imag * -scale
        result[..., self._cosine] = packed.real * scale  # after the sine, which shares m = 0
        return result

    def _scale(self, factor: float, dtype: np.dtype[Any]) -> FloatArray:
        """The phase, times ``factor`` for m > 0, kept for each precision."""
        key = (factor, dtype.str)
        if key not in self._scales:
            self._scales[key] = (np.where(self._positive, factor, 1.0) * self._phase).astype(dtype)
        return self._scales[key]


@functools.lru_cache(maxsize=8)
def packed_layout(bandwidth: int) -> PackedLayout:
    """The (cached) layout of a bandwidth."""
    return PackedLayout(bandwidth)
