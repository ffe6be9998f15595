"""Which engine carries out a transform.

The crossovers were measured (``benchmarks/transform.py``): a matrix product beats the fast transform for small
bandwidths always, and up to b = 40 for batches large enough to keep BLAS busy; beyond, the matrices only cost memory.
"""

from __future__ import annotations

from typing import Literal, Protocol

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere.dense_engine import DenseEngine
from fsh3d_o3d.sphere.grids import SphericalGrid
from fsh3d_o3d.sphere.nufft_engine import NufftEngine

EngineName = Literal["auto", "dense", "nufft"]

_SMALLEST_DENSE_BATCH = {24: 1, 32: 8, 40: 24}  # functions, by the bandwidth up to which so many suffice; measured
_DENSE_BYTES = 2**29  # of one matrix, a choice; the fast transform needs none


class Engine(Protocol):
    """Sums over points and over harmonics of degree < b on one grid."""

    grid: SphericalGrid
    bandwidth: int

    def analyse(self, values: FloatArray, threads: int | None = None) -> FloatArray:
        """Yᵀ (w v): (batch, n) → (batch, b²)."""

    def synthesise(self, coefficients: FloatArray, threads: int | None = None) -> FloatArray:
        """Y c: (batch, b²) → (batch, n)."""


class EnginePair:
    """Both engines of one grid, bandwidth and weights, made when first needed; picks by batch size."""

    def __init__(
        self, grid: SphericalGrid, bandwidth: int, weights: Float64Array | None = None, engine: EngineName = "auto"
    ) -> None:
        self._choice = check.choice(engine, "engine", ("auto", "dense", "nufft"))
        self._dense = DenseEngine(grid, bandwidth, weights)
        self._nufft = NufftEngine(grid, bandwidth, weights)

    def pick(self, batch: int) -> Engine:
        """The engine for a batch of so many functions."""
        if self._choice == "dense":
            return self._dense
        if self._choice == "nufft":
            return self._nufft
        bandwidth, points = self._dense.bandwidth, len(self._dense.grid)
        small = any(bandwidth <= limit and batch >= least for limit, least in _SMALLEST_DENSE_BATCH.items())
        return self._dense if small and 8 * bandwidth**2 * points <= _DENSE_BYTES else self._nufft
