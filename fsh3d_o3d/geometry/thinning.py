"""Fewer points of a cloud that is larger than needed: the same ones in every pose and every order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray

_STEPS = (
    2.0**16
)  # to the median distance from the mean, a choice: far coarser than rounding, far finer than points lie apart
_FARTHEST = 2.0**62  # steps; farther ones count as this far, which int64 holds
# SplitMix64 (Steele, Lea and Flood 2014): a bijection of 64-bit numbers whose output passes for random.
_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX = ((np.uint64(30), np.uint64(0xBF58476D1CE4E5B9)), (np.uint64(27), np.uint64(0x94D049BB133111EB)))


def thinned(points: Float64Array, most: int) -> IntArray:
    """Return the indices of the different ones among (n, 3) points, ``most`` of them at most, in the order of z, y, x.

    Which are left out depends on a hash of their distances to the mean, to the point farthest from it and to the
    point farthest from that. So it is as good as random, whatever the pattern of the points; it does not depend on
    their order; and neither on the pose, but for the few points at the edge of a step, and for shapes whose farthest
    point is not the only one: their points are chosen anew, at random, in every pose.
    """
    order = np.lexsort(points.T)
    ordered = points[order]
    different = np.concatenate(([True], (ordered[1:] != ordered[:-1]).any(axis=1)))
    order, ordered = order[different], ordered[different]
    if len(order) <= most:
        return order
    # Those at equal distances, as mirror images are, take turns by their coordinates.
    chosen = np.lexsort((_hashed((ordered + 0.0).view(np.uint64)), _hashed(_distances(ordered))))[:most]  # no -0.0
    return order[np.sort(chosen)]


def _distances(points: Float64Array) -> NDArray[np.uint64]:
    """Distances (n, 3) of each point to three that turn and move with the cloud, in whole steps."""
    size = float(np.abs(points).max()) or 1.0  # squares neither overflow nor vanish
    relative = points / size
    relative = relative - relative.mean(axis=0)
    own = np.linalg.norm(relative, axis=1)
    first = np.linalg.norm(relative - relative[own.argmax()], axis=1)
    second = np.linalg.norm(relative - relative[first.argmax()], axis=1)
    step = (float(np.median(own)) or float(own.max())) / _STEPS
    whole = np.floor(np.minimum(np.stack([own, first, second], axis=1) / step, _FARTHEST))
    return whole.astype(np.int64).view(np.uint64)


def _hashed(rows: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A number for each row (n, k), as good as random, the same for the same row."""
    result = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:
        result = result + _INCREMENT + column
        for shift, factor in _MIX:
            result = (result ^ (result >> shift)) * factor
        result ^= result >> np.uint64(31)
    return result
