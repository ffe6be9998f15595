"""Spherical harmonics as matrices: fastest for small bandwidths and large batches.

On a grid with the half-turn symmetry (x, y, z) → (x, −y, −z) every harmonic is either even or odd under it: the cosine
harmonics are even where l + m is even, the sine harmonics where it is odd. Folding the values into their even and odd
parts leaves two matrices of a quarter of the size each: half the work and half the memory.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray, IntArray
from fsh3d_o3d.sphere.grids import SphericalGrid, locked_directions
from fsh3d_o3d.sphere.harmonics import MAXIMUM_RECURSION, degrees_and_orders, harmonics_by_degree
from fsh3d_o3d.sphere.threads import resolve_threads, run_all, single_threaded_blas

# Sizes of a matrix product: a choice, but fixed, so that workspaces stay small and results do not depend on threads.
_CHUNK = 64  # functions
_COLUMNS = 1024  # harmonics, or points
_THREADED_SECONDS = 1e-3  # of work, a choice: starting threads takes some hundredths of it


@dataclass(frozen=True, eq=False)
class _Block:
    """The harmonics of one parity, at the points that determine them."""

    matrix: FloatArray
    """(coefficients, points)."""
    index: IntArray
    """Where each row stands among the b² coefficients."""


class DenseEngine:
    """Matrix products with the harmonics of degree < b on one grid; matrices are made when first needed."""

    def __init__(self, grid: SphericalGrid, bandwidth: int, weights: Float64Array | None = None) -> None:
        self.grid = grid
        self.bandwidth = bandwidth
        self._weights = weights
        self._symmetric = (
            len(grid) > 1
            and grid.half_turn_symmetric
            and (weights is None or bool(np.array_equal(weights, weights[::-1])))
        )
        self._half = (len(grid) + 1) // 2
        self._parity = half_turn_parity(bandwidth) if self._symmetric else np.zeros(bandwidth**2, dtype=np.int64)
        self._order = np.argsort(np.argsort(self._parity, kind="stable"), kind="stable")
        self._blocks: dict[tuple[str, bool], tuple[_Block, ...]] = {}
        self._lock = threading.Lock()
        self._local = threading.local()

    def analyse(self, values: FloatArray, threads: int | None = None) -> FloatArray:
        """Yᵀ (w v): (batch, n) → (batch, b²)."""
        threads = resolve_threads(threads)
        blocks = self._matrices(values.dtype, weighted=self._weights is not None)
        result = np.empty((len(values), self.bandwidth**2), dtype=values.dtype)
        with single_threaded_blas():
            for rows in _slices(len(values), _CHUNK):
                parts = self._fold(values[rows]) if self._symmetric else (values[rows],)
                packed = self._workspace("packed", (len(parts[0]), self.bandwidth**2), values.dtype)
                jobs, start = [], 0
                for block, part in zip(blocks, parts, strict=True):
                    for own in _slices(len(block.index), _COLUMNS):
                        target = packed[:, start + own.start : start + own.stop]
                        jobs.append(functools.partial(np.matmul, part, block.matrix[own].T, out=target))
                    start += len(block.index)
                self._run(jobs, len(parts[0]), values.dtype, threads)
                np.take(packed, self._order, axis=1, out=result[rows], mode="clip")
        return result

    def synthesise(self, coefficients: FloatArray, threads: int | None = None) -> FloatArray:
        """Y c: (batch, b²) → (batch, n)."""
        threads = resolve_threads(threads)
        blocks = self._matrices(coefficients.dtype, weighted=False)
        n, h = len(self.grid), self._half
        result = np.empty((len(coefficients), n), dtype=coefficients.dtype)
        with single_threaded_blas():
            for rows in _slices(len(coefficients), _CHUNK):
                jobs, parts = [], []
                for name, block in zip(("even", "odd"), blocks, strict=False):
                    given = np.take(coefficients[rows], block.index, axis=1)
                    part = self._workspace(name, (len(given), h), given.dtype) if self._symmetric else result[rows]
                    parts.append(part)
                    jobs += [
                        functools.partial(np.matmul, given, block.matrix[:, own], out=part[:, own])
                        for own in _slices(part.shape[1], _COLUMNS)
                    ]
                self._run(jobs, len(parts[0]), coefficients.dtype, threads)
                if self._symmetric:
                    even, odd = parts
                    np.add(even, odd, out=result[rows, :h])
                    np.subtract(even[:, : n - h], odd[:, : n - h], out=result[rows, : h - 1 : -1])
        return result

    def _run(self, jobs: Sequence[Callable[[], Any]], functions: int, dtype: np.dtype[Any], threads: int) -> None:
        """Run the products of one chunk, side by side where that is worth starting threads."""
        elements = self.bandwidth**2 * (self._half if self._symmetric else len(self.grid))
        # One core is taken to do 4e10 operations a second and to read 1e10 bytes.
        seconds = max(2 * functions * elements / 4e10, elements * dtype.itemsize / 1e10)
        run_all(jobs, threads if seconds > _THREADED_SECONDS else 1)

    def _fold(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Even and odd parts on the first half of the points; an odd grid's middle point is its own mirror image."""
        h, n = self._half, len(self.grid)
        even, odd = (self._workspace(name, (len(values), h), values.dtype) for name in ("even", "odd"))
        mirrored = values[:, : n - h - 1 : -1]
        np.add(values[:, :h], mirrored, out=even)
        np.subtract(values[:, :h], mirrored, out=odd)
        if n % 2:
            even[:, -1] = values[:, h - 1]
        return even, odd

    def _workspace(self, name: str, shape: tuple[int, int], dtype: np.dtype[Any]) -> FloatArray:
        """A scratch array of this thread: fresh pages for every call would cost as much as the products."""
        buffers: dict[str, FloatArray] = self._local.__dict__
        key, size = name + dtype.str, shape[0] * shape[1]
        if key not in buffers or buffers[key].size < size:
            buffers[key] = np.empty(size, dtype=dtype)
        return buffers[key][:size].reshape(shape)

    def _matrices(self, dtype: np.dtype[Any], *, weighted: bool) -> tuple[_Block, ...]:
        """The blocks in a precision, with the weights multiplied in (analysis) or without (synthesis)."""
        with self._lock:
            key = (dtype.str, weighted)
            if key not in self._blocks:
                blocks = self._build(dtype)
                if weighted and self._weights is not None:
                    for block in blocks:
                        np.multiply(
                            block.matrix, self._weights[: block.matrix.shape[1]], out=block.matrix, casting="same_kind"
                        )
                self._blocks[key] = blocks
            return self._blocks[key]

    def _build(self, dtype: np.dtype[Any]) -> tuple[_Block, ...]:
        points = locked_directions(self.grid)[: self._half if self._symmetric else None]
        b = check.integer(self.bandwidth, "bandwidth of the dense engine", minimum=1, maximum=MAXIMUM_RECURSION)
        check.memory(
            dtype.itemsize * b * b * len(points) * 1.1,
            f"the dense transform of bandwidth {b} on {len(self.grid)} points",
        )
        indices = [np.flatnonzero(self._parity == own) for own in range(2 if self._symmetric else 1)]
        matrices = [np.empty((len(index), len(points)), dtype=dtype) for index in indices]
        filled = [0] * len(indices)
        for degree, cosine, sine in harmonics_by_degree(points, b):
            rows = np.concatenate([sine[::-1], cosine])
            own = self._parity[degree * degree : (degree + 1) ** 2]
            for block, matrix in enumerate(matrices):
                chosen = rows[own == block]
                matrix[filled[block] : filled[block] + len(chosen)] = chosen
                filled[block] += len(chosen)
        return tuple(_Block(matrix, index) for matrix, index in zip(matrices, indices, strict=True))


def half_turn_parity(bandwidth: int) -> IntArray:
    """(b²,) 0 where the harmonic is even under the half turn about x, 1 where it is odd."""
    degree, order = degrees_and_orders(bandwidth)
    return (degree + order + (order < 0)) % 2


def _slices(count: int, length: int) -> list[slice]:
    return [slice(start, min(start + length, count)) for start in range(0, count, length)]
