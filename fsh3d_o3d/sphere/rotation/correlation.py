"""The correlation of functions over all rotations: on a grid of SO(3), and uphill from there.

C(R) = Σ ⟨t, R s⟩ over functions s, t on the sphere is Σ_l ⟨D_l(R), M_l⟩ with products M_l = Σ t_l s_lᵀ, whatever the
number of functions. Both the grid and the ascent treat R and Rᵀ alike, so that exchanging s and t gives the inverse.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, FloatArray, IntArray
from fsh3d_o3d.sphere.rotation.derivatives import Derivatives
from fsh3d_o3d.sphere.rotation.wigner import wigner_table

_LONGEST_STEP = 0.25  # radians, a choice: about the spacing of the grid of b = 8
_CONVERGED = 1e-6  # radians: the step after this one is about its square, which is rounding
_ROUNDING = 1e-14  # of a correlation: some fifty roundings of float64; the last steps change less
_CROSS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64
)
"""Vectors (k, 3) times this are their cross-product matrices (k, 9)."""


class Correlator:
    """Correlations over SO(3) for one bandwidth."""

    def __init__(self, bandwidth: int, fineness: int = 3) -> None:
        self.bandwidth = b = bandwidth
        self._turns = n = 2 * max(4, (fineness * b + 1) // 2)
        """Steps of α and of γ; even, so that the grid holds the inverses of its rotations."""
        tilts = n // 2
        angles = 2 * np.pi * np.arange(n) / n
        tilt = np.pi * (np.arange(tilts) + 0.5) / tilts
        self.shape = (tilts, n, n)
        """Steps of β, γ and α of the grid's R_z(α) R_y(β) R_z(γ)."""
        self.rotations = _zyz(angles, tilt, angles)
        """(tilts · n · n, 3, 3)."""
        self._table = table = wigner_table(b)
        self._derivatives = Derivatives(table)
        self._place = (table.order, table.other + b - 1, table.degree)
        self._wigner = np.zeros((b, 2 * b - 1, tilts, b), dtype=np.float32)  # m, m', tilt, degree
        self._wigner.transpose(0, 1, 3, 2)[self._place] = table.tilts(tilt).T
        order = np.arange(1 - b, b)
        self._gamma = np.exp(-1j * order[:, None] * angles).astype(np.complex64)
        twice = np.where(np.arange(b) == 0, 1.0, 2.0)[:, None]  # −m adds the conjugate of m
        phase = np.arange(b)[:, None] * angles
        self._alpha = np.concatenate((twice * np.cos(phase), twice * np.sin(phase))).astype(np.float32)

    def products(self, source: FloatArray, target: FloatArray) -> Float64Array:
        """M of sources (n, S, b²) with one target (S, b²): every degree's (2l+1)² numbers, (n, b(4b²−1)/3)."""
        parts = []
        for degree in range(self.bandwidth):
            part = slice(degree**2, (degree + 1) ** 2)
            parts.append((target[:, part].T @ source[:, :, part]).reshape(len(source), -1))
        return np.concatenate(parts, axis=1, dtype=np.float64)

    def on_grid(self, products: Float64Array) -> NDArray[np.float32]:
        """C at the grid's rotations, (n, tilts, n_γ, n_α): an FFT on SO(3) as a few matrix products."""
        n, b = len(products), self.bandwidth
        tilts, turns, _ = self.shape
        mixed = np.zeros((b, 2 * b - 1, b, n), dtype=np.complex64)
        mixed[self._place] = self._derivatives.mixed(products).T
        sums = (self._wigner @ mixed.view(np.float32)).view(np.complex64)  # m, m', tilt, n
        turned = np.ascontiguousarray(sums.transpose(3, 2, 0, 1)).reshape(-1, 2 * b - 1) @ self._gamma
        turned = turned.reshape(n, tilts, b, turns).transpose(0, 1, 3, 2)
        both = np.concatenate((turned.real, turned.imag), axis=-1)
        return (both.reshape(-1, 2 * b) @ self._alpha).reshape(n, tilts, turns, turns)

    def peaks(self, values: NDArray[np.float32], count: int) -> IntArray:
        """Indices (n, count) into ``rotations`` of the highest local maxima on the grid, best first.

        Where there are fewer, other points of the grid follow.
        """
        n = len(values)
        around = values
        for axis in (3, 2):
            around = np.maximum(around, np.maximum(np.roll(around, 1, axis), np.roll(around, -1, axis)))
        # Beyond a pole, α and γ go on half a turn further.
        half = self._turns // 2
        over = np.roll(around[:, [0, -1]], (half, half), (2, 3))
        padded = np.concatenate((over[:, :1], around, over[:, 1:]), axis=1)
        around = np.maximum(around, np.maximum(padded[:, :-2], padded[:, 2:]))
        scores = np.where(values >= around, values, values - 4 * np.abs(values).max(axis=(1, 2, 3), keepdims=True))
        flat = scores.reshape(n, -1)
        best = np.argpartition(flat, -count, axis=1)[:, -count:]
        order = np.argsort(-np.take_along_axis(flat, best, 1), axis=1, kind="stable")
        return np.take_along_axis(best, order, 1)

    def ascend(
        self, products: Float64Array, rotations: Float64Array, steps: int
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Climb from rotations (k, 3, 3), each on its own products (k, …) or all on the same (1, …).

        Newton's method with the curvatures' absolute values, so that it climbs from anywhere, and limited steps; a
        step that does not climb is halved.

        Returns:
            Rotations (k, 3, 3), correlations (k,) and their Hessians (k, 3, 3), per radian² about fixed axes.
        """
        weights = self._derivatives.weights(products)
        shared = len(products) == 1
        current = rotations.copy()
        value, gradient, hessian = self._expansion(weights, rotations)
        limit = np.full(len(rotations), _LONGEST_STEP)
        climbing = np.arange(len(rotations))
        for _ in range(steps):
            step = _newton_step(gradient[climbing], hessian[climbing], limit[climbing])
            length = _lengths(step)
            trial = exponential(step) @ current[climbing]
            every = shared or len(climbing) == len(rotations)
            found = self._expansion(weights if every else weights[climbing], trial)
            better = found[0] >= value[climbing] - _ROUNDING * np.abs(value[climbing])
            limit[climbing] = np.where(better, np.minimum(_LONGEST_STEP, 2 * limit[climbing]), length / 2)
            up = climbing[better]
            current[up] = trial[better]
            value[up], gradient[up], hessian[up] = (part[better] for part in found)
            climbing = climbing[length > _CONVERGED]
            if not len(climbing):
                break
        return current, value, hessian

    def values(self, products: Float64Array, rotations: Float64Array) -> Float64Array:
        """C at rotations (k, 3, 3), all for the same products (1, …): (k,)."""
        return self._expansion(self._derivatives.weights(products), rotations)[0]

    def _expansion(
        self, weights: Float64Array, rotations: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """C, its gradient and its Hessian at rotations, along exp(ω) R."""
        matrices = self._table(rotations).view(np.float64)
        terms = matrices @ weights[0].T if len(weights) == 1 else (weights @ matrices[..., None])[..., 0]
        return terms[:, 0], terms[:, 1:4], terms[:, [4, 7, 8, 7, 5, 9, 8, 9, 6]].reshape(-1, 3, 3)


def _newton_step(gradient: Float64Array, hessian: Float64Array, limit: Float64Array) -> Float64Array:
    curvature, axes = np.linalg.eigh(hessian)
    size = np.abs(curvature)
    size = np.maximum(size, 1e-6 * size.max(axis=1, keepdims=True) + np.finfo(float).tiny)
    along = (gradient[:, None] @ axes)[:, 0] / size
    step = (axes @ along[:, :, None])[..., 0]
    return np.asarray(step * np.minimum(1.0, limit / np.maximum(_lengths(step), 1e-300))[:, None])


def _lengths(vectors: Float64Array) -> Float64Array:
    return np.asarray(np.sqrt(np.einsum("ki,ki->k", vectors, vectors)))


def exponential(vectors: Float64Array) -> Float64Array:
    """Rotations (k, 3, 3) about vectors (k, 3) by their lengths in radians (Rodrigues)."""
    angle = _lengths(vectors)
    cross = (vectors @ _CROSS).reshape(-1, 3, 3)
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross))


def _zyz(alpha: Float64Array, beta: Float64Array, gamma: Float64Array) -> Float64Array:
    """R_z(α) R_y(β) R_z(γ) for all combinations, α fastest and β slowest, (k, 3, 3)."""
    beta, gamma, alpha = (grid.ravel() for grid in np.meshgrid(beta, gamma, alpha, indexing="ij"))
    return _about_axis(2, alpha) @ _about_axis(1, beta) @ _about_axis(2, gamma)


def _about_axis(axis: int, angles: Float64Array) -> Float64Array:
    return exponential(angles[:, None] * np.eye(3)[axis])


@functools.lru_cache(maxsize=16)
def correlator(bandwidth: int, fineness: int = 3) -> Correlator:
    """The (cached) correlator of a bandwidth."""
    return Correlator(bandwidth, fineness)
