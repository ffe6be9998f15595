"""Harmonics of what lies around single points: sums over the neighbours, in the frame of the local normal.

For a key point k, its neighbours x_i, d_i = x_i − k, and windows φ_s of the distance,

    c(s, l, m) = Σ_i w_i φ_s(|d_i|) Y(l, m; A d_i / |d_i|),

w being areas and A the rotation into the frame of k. There is no grid of directions, nothing is looked up or
interpolated, and a rotation of the points is a rotation of the coefficients to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere import polynomial_harmonics

Float32Array = NDArray[np.float32]

_KEYS_AT_ONCE = 64  # a choice: their pairs fit into the processor's cache
_SEARCH_MARGIN = 1.001  # of the squared radius: the first look at distances is rounded
_FRAME_SHARE = 0.6  # of the radius: what lies farther does not take part in the normal
_FIRST_SHELL = 0.75  # of the shells' distance: the innermost stands so far from the point, the outermost ends at 1
_TILTED = 0.9  # component of the normal from which on another axis is used to build the frame


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """What is known of the surroundings of k points."""

    frames: Float64Array
    """(k, 3, 3) rotations into the local frames; rows are the axes, the last is the normal up to its sign."""
    coefficients: Float32Array
    """(k, S, b²) in those frames."""
    counts: IntArray
    """(k,) how many points lie within the radius."""
    offsets: Float64Array
    """(k,) distance along the surface from the point to the mean of its neighbours, in radii: large at borders."""

    def take(self, index: IntArray | NDArray[np.bool_]) -> Neighbourhoods:
        """Those of some of the points."""
        return Neighbourhoods(self.frames[index], self.coefficients[index], self.counts[index], self.offsets[index])


def neighbourhoods(
    points: Float64Array, areas: Float64Array, keys: Float64Array, radius: float, *, bandwidth: int, shells: int
) -> Neighbourhoods:
    """Expand the surroundings of ``keys`` (k, 3) among ``points`` (n, 3) that stand for ``areas`` (n,)."""
    weights = areas.astype(np.float32)
    axis = int(np.ptp(points, axis=0).argmax())
    across = np.argsort(points[:, axis], kind="stable")
    places = points[across, axis]
    order = np.argsort(keys[:, axis], kind="stable")
    reach = radius * _SEARCH_MARGIN
    frames = np.empty((len(keys), 3, 3))
    coefficients = np.empty((len(keys), shells, bandwidth**2), dtype=np.float32)
    counts, offsets = np.empty(len(keys), dtype=np.int64), np.empty(len(keys))
    for some in _blocks(len(keys)):
        own = order[some]
        low, high = np.searchsorted(places, (keys[own[0], axis] - reach, keys[own[-1], axis] + reach))
        # In the order that they were given, so that sums do not depend on what lies elsewhere.
        near = np.sort(across[low:high])
        pairs = _Pairs.of(points[near], weights[near], keys[own], radius)
        counts[own] = np.diff(pairs.starts)
        frames[own], offsets[own] = pairs.frames()
        coefficients[own] = pairs.coefficients(frames[own], bandwidth, shells)
    return Neighbourhoods(frames, coefficients, counts, offsets)


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, _KEYS_AT_ONCE):
        yield slice(start, start + _KEYS_AT_ONCE)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Key points with their neighbours, key by key."""

    difference: Float32Array
    """(3, p) from the key point to the neighbour, in radii."""
    distance: Float32Array
    """(p,) its length, up to 1 but for the margin of the search."""
    area: Float32Array
    """(p,) that the neighbour stands for."""
    starts: NDArray[np.int32]
    """(k + 1,) where the pairs of each key point begin."""

    @classmethod
    def of(cls, points: Float64Array, areas: Float32Array, keys: Float64Array, radius: float) -> _Pairs:
        """All pairs within the radius."""
        # |x|² − 2 k·x + |k|² tells who may be near: relative to one of the key points, so that little cancels.
        there, here = (points - keys[0]) / radius, (keys - keys[0]) / radius
        square = np.einsum("ij,ij->i", there, there) - (2 * here) @ there.T
        near = square < _SEARCH_MARGIN - np.einsum("ij,ij->i", here, here)[:, None]
        row, column = np.divmod(np.flatnonzero(near), len(points))
        points, columns = np.ascontiguousarray(points.T), np.ascontiguousarray(keys.T)
        exact = (np.take(points, column, axis=1) - np.take(columns, row, axis=1)) / radius
        distance = np.sqrt(exact[0] * exact[0] + exact[1] * exact[1] + exact[2] * exact[2])
        # A few lie just outside; all windows are zero there.
        starts = np.searchsorted(row, np.arange(len(keys) + 1)).astype(np.int32)
        return cls(exact.astype(np.float32), distance.astype(np.float32), areas[column], starts)

    def _summed(self, rows: Float32Array) -> Float32Array:
        """Σ (c, k) over the pairs of each key point of rows (c, p)."""
        filled = np.flatnonzero(np.diff(self.starts))
        result = np.zeros((len(rows), len(self.starts) - 1), dtype=np.float32)
        if len(filled):
            result[:, filled] = np.add.reduceat(rows, self.starts[filled], axis=1)
        return result

    def summed(self, window: Float32Array, values: Float32Array) -> Float32Array:
        """Σ area · window · value (k, c) over the pairs of each key point; values are (p, c)."""
        weights = window * self.area
        columns = np.arange(len(weights), dtype=np.int32)
        shape = (len(self.starts) - 1, len(weights))
        return np.asarray(sparse.csr_matrix((weights, columns, self.starts), shape=shape) @ values)

    def frames(self) -> tuple[Float64Array, Float64Array]:
        """Rotations (k, 3, 3) into frames whose z axis is where the neighbours spread least, and offsets (k,)."""
        x, y, z = self.difference
        weight = np.maximum(np.float32(_FRAME_SHARE) - self.distance, 0) * self.area
        rows = np.empty((10, len(weight)), dtype=np.float32)
        rows[0] = weight
        rows[1], rows[2], rows[3] = weighted = weight * x, weight * y, weight * z
        pairs = ((0, x), (0, y), (0, z), (1, y), (1, z), (2, z))
        for row, (first, second) in zip(rows[4:], pairs, strict=True):
            np.multiply(weighted[first], second, out=row)
        moments = self._summed(rows).T.astype(np.float64)
        moments /= np.maximum(moments[:, :1], np.finfo(np.float32).tiny)
        mean = moments[:, 1:4]
        scatter = moments[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None]
        normal = np.linalg.eigh(scatter)[1][:, :, 0]
        beside = np.where(np.abs(normal[:, :1]) < _TILTED, [[1.0, 0, 0]], [[0, 1.0, 0]])
        first = beside - np.einsum("ki,ki->k", beside, normal)[:, None] * normal
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        frames = np.stack([first, np.cross(normal, first), normal], axis=1)
        along = mean - np.einsum("ki,ki->k", mean, normal)[:, None] * normal
        return frames, np.linalg.norm(along, axis=1)

    def coefficients(self, frames: Float64Array, bandwidth: int, shells: int) -> Float32Array:
        """The harmonics (k, S, b²) in the frames (k, 3, 3)."""
        count = np.diff(self.starts)
        turned = np.empty_like(self.difference)
        for axis, row in enumerate(turned):
            a, b, c = (np.repeat(frames[:, axis, i].astype(np.float32), count) for i in range(3))
            row[:] = a * self.difference[0] + b * self.difference[1] + c * self.difference[2]
        turned /= np.maximum(self.distance, np.finfo(np.float32).tiny)
        values = np.ascontiguousarray(polynomial_harmonics(turned, bandwidth).T)
        width = 1 / (shells - 1 + _FIRST_SHELL + 1)  # hats: the outermost ends where the radius does
        result = np.empty((len(count), shells, bandwidth**2), dtype=np.float32)
        off_center = self.distance > 0  # the key point itself has no direction
        for shell in range(shells):
            window = 1 - np.abs(self.distance / np.float32(width) - np.float32(shell + _FIRST_SHELL))
            result[:, shell] = self.summed(np.maximum(window, 0) * off_center, values)
        return result
