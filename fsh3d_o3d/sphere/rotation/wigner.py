"""Wigner's D of all degrees of a bandwidth at many rotations at once.

D(m, m') = exp(−imα) d(m, m'; β) exp(−im'γ) in the basis of complex harmonics with the Condon–Shortley phase. Rotated
real functions are real, so D(−m, −m') is the conjugate of D(m, m') but for a sign, and orders m >= 0 are enough: some
⅔b³ numbers side by side. As a function of β each is a sum of cosines (m + m' even) or of sines (odd), which makes all
of d one matrix product, without a recursion.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray

Complex128Array = NDArray[np.complex128]


class WignerTable:
    """D at many rotations for one bandwidth, (k, N): all degrees, orders m >= 0 and |m'| <= l."""

    def __init__(self, bandwidth: int) -> None:
        self.bandwidth = b = bandwidth
        degree, order, other = (
            grid.ravel() for grid in np.meshgrid(np.arange(b), np.arange(b), np.arange(1 - b, b), indexing="ij")
        )
        odd = (order + other) % 2
        inside = np.flatnonzero((order <= degree) & (np.abs(other) <= degree))
        inside = inside[np.argsort(odd[inside], kind="stable")]  # even first
        self.degree: IntArray = degree[inside]
        """(N,) l."""
        self.order: IntArray = order[inside]
        """(N,) m >= 0."""
        self.other: IntArray = other[inside]
        """(N,) m'."""
        self._even = int(np.count_nonzero(odd[inside] == 0))
        self._cosines, self._sines = self._series()

    def __call__(self, rotations: Float64Array) -> Complex128Array:
        """Return D (k, N) at rotations (k, 3, 3), accurate for any of them."""
        b = self.bandwidth
        alpha, beta, gamma = euler_angles(rotations)
        left = np.exp(-1j * alpha[:, None] * np.arange(b))
        right = np.exp(-1j * gamma[:, None] * np.arange(1 - b, b))
        phases = (left[:, :, None] * right[:, None]).reshape(len(rotations), -1)
        return np.asarray(self.tilts(beta) * phases[:, self.order * (2 * b - 1) + self.other + b - 1])

    def tilts(self, beta: Float64Array) -> Float64Array:
        """Return d (k, N) at angles (k,)."""
        phase = beta[:, None] * np.arange(self.bandwidth)
        result = np.empty((len(beta), len(self.degree)))
        np.matmul(np.cos(phase), self._cosines, out=result[:, : self._even])
        np.matmul(np.sin(phase), self._sines, out=result[:, self._even :])
        return result

    def _series(self) -> tuple[Float64Array, Float64Array]:
        """The Fourier coefficients of d: of cosines (b, even), of sines (b, odd)."""
        series = np.zeros((self.bandwidth, len(self.degree)))
        for degree in range(self.bandwidth):
            own = self.degree == degree
            vectors = _tilt_axes(degree)
            # exp(−iβ J_y) from the eigenvectors of J_y, whose eigenvalues are −l … l.
            terms = vectors[self.order[own] + degree] * vectors[self.other[own] + degree].conj()
            up, down = terms[:, degree:], terms[:, degree::-1]
            total = up + down
            total[:, 0] /= 2
            odd = (self.order[own] + self.other[own]) % 2 == 1
            series[: degree + 1, own] = np.where(odd[:, None], (up - down).imag, total.real).T
        return series[:, : self._even].copy(), series[:, self._even :].copy()


def euler_angles(rotations: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """α, β, γ (k,) of R = R_z(α) R_y(β) R_z(γ), (k, 3, 3), accurate for any β, 0 and π included."""
    alpha = np.arctan2(rotations[:, 1, 2], rotations[:, 0, 2])
    beta = np.arctan2(np.hypot(rotations[:, 0, 2], rotations[:, 1, 2]), rotations[:, 2, 2])
    # Second row of R_z(−α) R, which R_y leaves alone. Where β is 0 or π, α is arbitrary and γ makes up for it.
    row = np.cos(alpha)[:, None] * rotations[:, 1] - np.sin(alpha)[:, None] * rotations[:, 0]
    return alpha, beta, np.arctan2(row[:, 0], row[:, 1])


def _tilt_axes(degree: int) -> Complex128Array:
    """Eigenvectors of J_y in the columns, in order of their eigenvalues −l … l, rows m = −l … l."""
    order = np.arange(-degree, degree)
    raising = np.diag(np.sqrt(degree * (degree + 1.0) - order * (order + 1.0)), -1)
    return np.asarray(np.linalg.eigh((raising - raising.T) / 2j)[1])


@functools.lru_cache(maxsize=16)
def wigner_table(bandwidth: int) -> WignerTable:
    """The (cached) table of a bandwidth."""
    return WignerTable(bandwidth)
