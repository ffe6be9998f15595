"""Scattered directions sorted into cells of equal area, and the largest cap they leave empty (private).

The cells are HEALPix pixels (Górski et al. 2005): equal in area, similar in shape, and found from a vector without a
search, so that a million directions are sorted in a few hundredths of a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt

import ducc0
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere.grids import fibonacci_grid

_PROBE_CELLS = 12 * 48**2
_LOCAL_PROBES = 1024
_CANDIDATES = 8


@dataclass(frozen=True, eq=False)
class AngularCells:
    """Which of the equal-area cells each direction lies in."""

    index: IntArray
    """(n,) cell of each direction, 0 … k − 1, occupied cells only."""
    count: IntArray
    """(k,) number of directions in each cell, >= 1."""
    total: int
    """Number of cells on the whole sphere, occupied or not."""

    @staticmethod
    def of(directions: Float64Array, total: float) -> AngularCells:
        """Sort (n, 3) unit vectors into at least ``total`` cells, but no fewer than 12."""
        nside = max(1, ceil(sqrt(total / 12)))
        # Healpix_Base fails where the longitude is so little below 2π that it rounds to it.
        safe = np.where(np.abs(directions) < 1e-15, 0.0, directions)
        pixel = ducc0.healpix.Healpix_Base(nside, "RING").vec2pix(safe)
        count = np.bincount(pixel, minlength=12 * nside * nside)
        place = np.cumsum(count > 0) - 1
        return AngularCells(place[pixel], count[count > 0], 12 * nside * nside)

    def sums(self, values: NDArray[np.generic]) -> Float64Array:
        """Sum (n,) values by cell, giving (k,)."""
        return np.asarray(np.bincount(self.index, values, minlength=len(self.count)), dtype=np.float64)

    def maxima(self, values: Float64Array) -> Float64Array:
        """Largest of (n,) non-negative values in each cell, (k,)."""
        largest = np.zeros(len(self.count))
        np.maximum.at(largest, self.index, values)
        return largest

    def medians(self, values: Float64Array) -> Float64Array:
        """Return the lower median of (n,) values in each cell, (k,)."""
        # One sort of cell + (value scaled into [0, 1)) costs half of sorting by two keys; the scaled value keeps
        # 1e-11 of the range, far below the noise that a median is asked to overcome.
        low, high = float(values.min()), float(values.max())
        width = (high - low) * (1 + 1e-9) or 1.0
        key = np.sort(self.index + (values - low) / width)
        middle = np.cumsum(self.count) - self.count + (self.count - 1) // 2
        fraction = key[middle] - np.arange(len(self.count))
        return np.asarray(np.clip(low + width * fraction, low, high))

    def mean_directions(self, directions: Float64Array, weights: Float64Array | None = None) -> Float64Array:
        """Return the normalised mean of the directions in each cell, (k, 3); its weights must not vanish in a cell."""
        means = np.stack([self.sums(axis if weights is None else axis * weights) for axis in directions.T], axis=1)
        return np.asarray(means / np.linalg.norm(means, axis=1, keepdims=True))


def largest_empty_cap(directions: Float64Array) -> tuple[float, Float64Array]:
    """Return the angular radius in radians and the centre of the largest cap without any of the (n, 3) directions.

    The centre is searched among probes on a fine grid and then, twice, among finer probes around the best ones; the
    radius is that of an empty cap for certain, and within a few thousandths of a radian of the largest.
    """
    cells = AngularCells.of(directions, min(_PROBE_CELLS, 2 * len(directions)))
    first = np.empty(len(cells.count), dtype=np.int64)
    first[cells.index] = np.arange(len(directions))
    probes = fibonacci_grid(_PROBE_CELLS).directions
    distance = _nearest(directions[first], probes, 2.0)
    # One direction a cell stands for all; those it hides lie within a cell's diameter, hence several candidates.
    best = _separated(probes, distance, 3 / sqrt(cells.total))
    reach = 2.5 / sqrt(min(cells.total, _PROBE_CELLS)) + 2.5 / sqrt(_PROBE_CELLS)
    for _ in range(2):
        local = np.concatenate([_around(center, reach) for center in best])
        near = _nearest(directions, local, float(distance.max()) + 2 * reach)
        distance = near
        best = local[[int(near.argmax())]]
        reach /= 8
    return float(2 * np.arcsin(min(1.0, distance.max() / 2))), best[0]


def _separated(probes: Float64Array, distance: Float64Array, gap: float) -> Float64Array:
    """Probes farthest from any direction, no two closer than ``gap``; at most _CANDIDATES."""
    open_, chosen = distance.copy(), []
    for _ in range(_CANDIDATES):
        top = int(open_.argmax())
        if open_[top] <= 0.5 * distance.max():
            break
        chosen.append(probes[top])
        open_[np.linalg.norm(probes - probes[top], axis=1) < gap] = 0
    return np.array(chosen) if chosen else probes[:1]


def _around(center: Float64Array, reach: float) -> Float64Array:
    """A sunflower of unit vectors within ``reach`` of ``center``, itself the first."""
    step = np.arange(_LOCAL_PROBES)
    angle = step * np.pi * (3 - sqrt(5))
    radius = reach * np.sqrt(step / _LOCAL_PROBES)
    helper = np.eye(3)[int(np.abs(center).argmin())]
    u = np.cross(center, helper)
    u /= np.linalg.norm(u)
    v = np.cross(center, u)
    ways = center + radius[:, None] * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def _nearest(directions: Float64Array, probes: Float64Array, reach: float) -> Float64Array:
    """Chord from each probe to the nearest direction, of those that could be it."""
    center = probes[:: max(1, len(probes) // _CANDIDATES)]
    # A direction farther than this from every group of probes is nearest to none of them.
    close = np.zeros(len(directions), dtype=np.bool_)
    for one in center:
        close |= directions @ one >= 1 - min(2.0, reach) ** 2 / 2
    chosen = directions[close] if close.any() else directions
    return np.asarray(KDTree(chosen).query(probes)[0])
