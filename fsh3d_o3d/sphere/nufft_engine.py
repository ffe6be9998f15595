"""Spherical harmonics by fast transforms: ducc0's spherical harmonic transform with a non-uniform FFT.

Cost grows as n + b³ instead of n b²; accuracy is 1e-13 in float64 and 1e-6 in float32.

ducc0's own threads add up floating-point sums in an order that varies from run to run. Here every ducc0 call has one
thread and the calls run side by side, one a function or one a fixed block of points, so that results do not depend on
the number of threads.
"""

from __future__ import annotations

import functools
import itertools

import ducc0
import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere.conventions import packed_layout
from fsh3d_o3d.sphere.grids import SphericalGrid
from fsh3d_o3d.sphere.threads import resolve_threads, run_all

_TOLERANCE = {np.dtype(np.float64).str: 3e-13, np.dtype(np.float32).str: 2e-6}  # asked of ducc0, relative
# A single function on fewer points, or on fewer for its bandwidth, is not split: each block repeats the part of the
# work that does not depend on the points. Both are choices.
_SPLIT_POINTS = 2**17
_SPLIT_RATIO = 2  # points over b²


class NufftEngine:
    """Fast transforms of degree < b at any directions."""

    def __init__(self, grid: SphericalGrid, bandwidth: int, weights: Float64Array | None = None) -> None:
        self.grid = grid
        self.bandwidth = bandwidth
        self._weights = weights
        self._locations = np.stack([grid.colatitude, grid.longitude], axis=1)

    def analyse(self, values: FloatArray, threads: int | None = None) -> FloatArray:
        """Yᵀ (w v): (batch, n) → (batch, b²)."""
        self._check_memory(values.dtype)
        blocks = self._blocks(len(values))
        jobs = [functools.partial(self._analyse_one, row, block) for row in values for block in blocks]
        parts = run_all(jobs, resolve_threads(threads))
        sums = [functools.reduce(np.add, parts[i : i + len(blocks)]) for i in range(0, len(parts), len(blocks))]
        if len(sums) == 1:
            return sums[0][None]
        return np.stack(sums) if sums else np.empty((0, self.bandwidth**2), dtype=values.dtype)

    def synthesise(self, coefficients: FloatArray, threads: int | None = None) -> FloatArray:
        """Y c: (batch, b²) → (batch, n)."""
        self._check_memory(coefficients.dtype)
        blocks = self._blocks(len(coefficients))
        values = np.empty((len(coefficients), len(self.grid)), dtype=coefficients.dtype)
        jobs = [
            functools.partial(self._synthesise_one, row, block, out)
            for row, out in zip(coefficients, values, strict=True)
            for block in blocks
        ]
        run_all(jobs, resolve_threads(threads))
        return values

    def _analyse_one(self, values: FloatArray, block: slice) -> FloatArray:
        own = values[block]
        if self._weights is not None:
            own = own * self._weights[block].astype(values.dtype, copy=False)
        # ducc0's adjoint is that of the m >= 0 sum with the conjugate counted once, Σ v conj Y.
        packed = ducc0.sht.adjoint_synthesis_general(
            map=np.ascontiguousarray(own)[None],
            spin=0,
            lmax=self.bandwidth - 1,
            loc=self._locations[block],
            epsilon=_TOLERANCE[values.dtype.str],
            nthreads=1,
        )
        return packed_layout(self.bandwidth).unpack(packed[0])

    def _synthesise_one(self, coefficients: FloatArray, block: slice, out: FloatArray) -> None:
        ducc0.sht.synthesis_general(
            alm=packed_layout(self.bandwidth).pack(coefficients)[None],
            spin=0,
            lmax=self.bandwidth - 1,
            loc=self._locations[block],
            epsilon=_TOLERANCE[coefficients.dtype.str],
            nthreads=1,
            map=out[None, block],
        )

    def _blocks(self, functions: int) -> list[slice]:
        """Blocks of points for one call; they depend on the sizes alone, never on the number of threads."""
        n = len(self.grid)
        if functions > 1 or n < max(_SPLIT_POINTS, _SPLIT_RATIO * self.bandwidth**2):
            return [slice(0, n)]
        count = max(2, min(8, n // (32 * self.bandwidth**2)))
        edges = np.linspace(0, n, count + 1).astype(int)
        return [slice(start, stop) for start, stop in itertools.pairwise(edges)]

    def _check_memory(self, dtype: np.dtype[np.generic]) -> None:
        # ducc0 oversamples the (2b)² torus about 2.5 times, twice over, in complex numbers.
        estimate = 2 * dtype.itemsize * (2 * 2.5 * (2 * self.bandwidth) ** 2 + 4 * len(self.grid))
        check.memory(estimate, f"the fast transform of bandwidth {self.bandwidth} on {len(self.grid)} points")


def synthesise_gradient(coefficients: FloatArray, bandwidth: int, grid: SphericalGrid) -> FloatArray:
    """∂f/∂θ and (1/sin θ) ∂f/∂φ of one function at the grid's directions: (b²,) → (2, n) float64."""
    packed = packed_layout(bandwidth).pack(coefficients.astype(np.float64))
    if bandwidth == 1:
        return np.zeros((2, len(grid)))
    gradient: FloatArray = ducc0.sht.synthesis_general(
        alm=packed[None],
        spin=1,
        lmax=bandwidth - 1,
        mode="DERIV1",
        loc=np.stack([grid.colatitude, grid.longitude], axis=1),
        epsilon=_TOLERANCE["<f8"],
        nthreads=1,
    )
    return gradient


def analyse_directly(values: Float64Array, bandwidth: int, grid: SphericalGrid) -> Float64Array:
    """Σ_j v_j Y(l, m; ω_j) summed point by point, (n,) → (b²,): n b² work, without the fast transform's error."""
    rings = np.empty((1, len(grid), bandwidth), dtype=np.complex128)
    powers = rings[0]  # v exp(−imφ), each doubling of m from one product
    powers[:, 0] = values
    rotation = np.exp(-1j * grid.longitude)[:, None]
    known = 1
    while known < bandwidth:
        more = min(known, bandwidth - known)
        np.multiply(powers[:, :more], rotation, out=powers[:, known : known + more])
        rotation = rotation * rotation
        known *= 2
    packed = ducc0.sht.leg2alm(leg=rings, spin=0, lmax=bandwidth - 1, theta=grid.colatitude, nthreads=1)
    return np.asarray(packed_layout(bandwidth).unpack(packed[0]), dtype=np.float64)
