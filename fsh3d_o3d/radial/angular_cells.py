"""Scattered directions sorted into cells of equal area, and the largest cap they leave empty.

The cells are HEALPix pixels (Górski et al. 2005): equal in area, similar in shape, and found from a vector without a
search, so that a million directions are sorted in a few hundredths of a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, ceil, sqrt

import ducc0
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere import fibonacci_grid

_PROBES = 12 * 48**2  # directions that are looked from, 1.2 degrees apart; refinement starts at the widest
_LOCAL_PROBES = 1024  # of each refinement: a twentieth of its reach apart
_CAPS_REFINED = 8  # a choice: the widest cap as seen on cells need not be the widest; time grows in proportion
_FAR = 8  # times the reach of the probes; a direction farther away may have very many equally far beside it
_SECTORS = 2048  # about a centre: what is behind in one is at most 1e-4 radians nearer than what is in front


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
    cells = AngularCells.of(directions, min(_PROBES, 2 * len(directions)))
    first = np.empty(len(cells.count), dtype=np.int64)
    first[cells.index] = np.arange(len(directions))
    probes = fibonacci_grid(_PROBES).directions
    distance = np.asarray(KDTree(directions[first]).query(probes)[0])
    # One direction a cell stands for all; those it hides lie within a cell's diameter, hence several candidates.
    best = _separated(probes, distance, 3 / sqrt(cells.total))
    reach = 2.5 / sqrt(min(cells.total, _PROBES)) + 2.5 / sqrt(_PROBES)
    for _ in range(2):
        local = np.stack([_cap_points(center, reach) for center in best])
        distance = np.stack([_nearest(directions, around, reach) for around in local])
        best = local.reshape(-1, 3)[[int(distance.argmax())]]
        reach /= 8
    # By all directions, not by those that stood for others.
    chord = float(np.sqrt(np.square(directions - best[0]).sum(axis=1).min()))
    return 2 * asin(min(1.0, chord / 2)), best[0]


def _separated(probes: Float64Array, distance: Float64Array, gap: float) -> Float64Array:
    """Probes farthest from any direction, no two closer than ``gap``; at most _CAPS_REFINED."""
    open_, chosen = distance.copy(), []
    for _ in range(_CAPS_REFINED):
        top = int(open_.argmax())
        if open_[top] <= 0.5 * distance.max():
            break
        chosen.append(probes[top])
        open_[np.linalg.norm(probes - probes[top], axis=1) < gap] = 0
    return np.array(chosen) if chosen else probes[:1]


def _cap_points(center: Float64Array, reach: float) -> Float64Array:
    """A sunflower of unit vectors within ``reach`` of ``center``, itself the first."""
    step = np.arange(_LOCAL_PROBES)
    angle = step * np.pi * (3 - sqrt(5))
    radius = reach * np.sqrt(step / _LOCAL_PROBES)
    u, v = _tangents(center)
    points = center + radius[:, None] * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _tangents(center: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Two unit vectors that stand at right angles to ``center`` and to each other."""
    u = np.cross(center, np.eye(3)[int(np.abs(center).argmin())])
    u /= np.linalg.norm(u)
    return u, np.cross(center, u)


def _nearest(directions: Float64Array, probes: Float64Array, reach: float) -> Float64Array:
    """Chord from each probe, all within ``reach`` of the first, to the nearest direction."""
    center = probes[0]
    along = directions @ center
    nearest = sqrt(max(0.0, 2 - 2 * float(along.max())))
    close = along >= 1 - min(2.0, nearest + 2.1 * reach) ** 2 / 2  # farther ones are nearest to no probe
    chosen, along = directions[close], along[close]
    if nearest < _FAR * reach:
        return np.asarray(KDTree(chosen).query(probes)[0])
    # Very many may be equally far, as those of a flat cloud are from its axis, and a search would look at each of them.
    # Seen from far off, what lies nearest to the centre in a narrow sector is nearer to any probe than the rest.
    u, v = _tangents(center)
    sector = ((np.arctan2(chosen @ v, chosen @ u) / (2 * np.pi) + 0.5) * _SECTORS).astype(np.int64) % _SECTORS
    front = np.full(_SECTORS, -1)
    order = np.argsort(along, kind="stable")
    front[sector[order]] = order  # the last one written is the nearest
    cosine = (probes @ chosen[front[front >= 0]].T).max(axis=1)
    return np.asarray(np.sqrt(np.maximum(0.0, 2 - 2 * cosine)))
