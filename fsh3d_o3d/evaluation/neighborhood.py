"""Rankings that use the library itself: who is near to whom else (Zhong et al., k-reciprocal encoding, CVPR 2017).

Unsupervised, but no longer a property of two shapes alone: adding models to the library changes all distances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array

__all__ = ["neighborhood_distances"]

_OWN_SHARE = 0.3  # of the distance itself in the mix, as in the paper
_COMMON_SHARE = 2 / 3  # of a neighbour's neighbours that have to be one's own before the rest join; as in the paper


def neighborhood_distances(distances: object, *, neighbors: int = 10) -> Float64Array:
    """Return distances (N, N) by which models are near whose neighbours are the same.

    Two models are neighbours if each is among the ``neighbors`` nearest of the other; a neighbour's closest such
    circle joins where most of it belongs already. The Jaccard distance of these weighted neighbourhoods, averaged over
    the nearest few, is mixed with the distance itself.

    Args:
        distances: (N, N), rows are rankings, the diagonal smallest; need not be symmetric.
        neighbors: About the size of a class, at least 2.

    Raises:
        ValueError: Not a square matrix, or not finite.
    """
    table = np.asarray(check.real_array(distances, "distances"), dtype=np.float64)
    if table.ndim != 2 or table.shape[0] != table.shape[1] or len(table) < 2:
        raise ValueError(f"distances must have shape (N, N) with N >= 2, got {table.shape}")
    n = len(table)
    k = min(check.integer(neighbors, "neighbors", minimum=2), n - 1)
    check.memory(80.0 * n * n, f"neighbourhoods of {n} models")
    order = np.argsort(table, axis=1, kind="stable")
    ranks = np.empty_like(order)
    np.put_along_axis(ranks, order, np.broadcast_to(np.arange(n), table.shape), axis=1)
    circle, inner = _mutual(ranks, k), _mutual(ranks, k // 2)
    shared = inner.astype(np.float32) @ circle.T.astype(np.float32)  # (whose inner circle, whose circle)
    agreed = _COMMON_SHARE * inner.sum(axis=1)
    joining = circle & (agreed < shared.T)
    circle |= joining.astype(np.float32) @ inner.astype(np.float32) > 0
    scale = float(np.median(np.take_along_axis(table, order[:, 1 : k + 1], axis=1)))
    nearness = np.where(circle, np.exp(-table / (scale if scale > 0 else 1.0)), 0.0)
    nearness /= nearness.sum(axis=1, keepdims=True)
    averaged = _averaged(nearness, order[:, : max(1, k // 3)])
    largest = float(table.max())
    return _OWN_SHARE * table * (2 / largest if largest > 0 else 1.0) + (1 - _OWN_SHARE) * _jaccard(averaged)


def _mutual(ranks: NDArray[np.int64], k: int) -> NDArray[np.bool_]:
    near = ranks <= k
    return near & near.T


def _averaged(nearness: Float64Array, nearest: NDArray[np.int64]) -> Float64Array:
    """The mean over each model's nearest few, without a third axis in memory."""
    total = nearness[nearest[:, 0]]
    for place in nearest.T[1:]:
        total += nearness[place]
    return np.asarray(total / nearest.shape[1])


def _jaccard(weights: Float64Array) -> Float64Array:
    """1 − Σ min / Σ max of rows (N, N) that sum to 1."""
    result = np.empty_like(weights)
    columns = np.ascontiguousarray(weights.T)
    for row, own in enumerate(weights):
        present = np.flatnonzero(own)  # a few dozen
        common = np.minimum(columns[present], own[present, None]).sum(axis=0)
        result[row] = 1 - common / (2 - common)
    return result
