"""How far it is from anywhere to the nearest point of a cloud, also from where very many points are about as near."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray

Progress = Callable[[float], object]
"""Told the share, 0 … 1, of a long computation that is done."""

_CHUNK = 2**14  # places at a time, a choice: fractions of a second, so that progress is seen to be made
_CELLS = 48  # along the longest side of the cloud, a choice: some ten thousand occupied cells of a surface


def nearest_distances(
    places: Float64Array, cloud: Float64Array, *, farthest: float = np.inf, progress: Progress | None = None
) -> Float64Array:
    """Return the distance (m,) from places (m, 3) to the nearest point of a cloud (n, 3), in float64.

    At the centre of a round cloud all points are about equally near, and a search has to look at very many of them.
    SciPy's tree keeps a queue of all it might still look at, which takes fifty times as long there as the walk of
    nanoflann, in Open3D, that keeps none. Where distances beyond ``farthest`` do not matter, these are given as
    infinity wherever cells of the cloud show that they are so large: the search at the centre is spared.

    Args:
        places: (m, 3) finite.
        cloud: (n, 3) finite, n >= 1.
        farthest: Distances that are certainly larger become infinite.
        progress: Told the share that is done, now and then.
    """
    result = np.full(len(places), np.inf)
    wanted = np.arange(len(places))
    if np.isfinite(farthest):
        middles, reach = _cells(cloud)
        wanted = np.flatnonzero(_searched(places, middles, None) <= farthest + reach)
    if wanted.size:
        result[wanted] = _searched(places[wanted], cloud, progress)
    return result


def nearest_points(places: Float64Array, cloud: Float64Array, *, progress: Progress | None = None) -> IntArray:
    """Return which point (m,) of a cloud (n, 3) is nearest to each of some places (m, 3)."""
    o3d = open3d()
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor(np.ascontiguousarray(cloud)))
    search.knn_index()
    nearest = np.empty(len(places), dtype=np.int64)
    for start in range(0, len(places), _CHUNK):
        part = np.ascontiguousarray(places[start : start + _CHUNK])
        nearest[start : start + _CHUNK] = search.knn_search(o3d.core.Tensor(part), 1)[0].numpy()[:, 0]
        if progress is not None:
            progress((start + len(part)) / len(places))
    return nearest


def _searched(places: Float64Array, cloud: Float64Array, progress: Progress | None) -> Float64Array:
    return np.asarray(np.linalg.norm(places - cloud[nearest_points(places, cloud, progress=progress)], axis=1))


def _cells(cloud: Float64Array) -> tuple[Float64Array, float]:
    """Middles (k, 3) of the cells of a grid that hold points, and how far from its middle a point may lie."""
    low = cloud.min(axis=0)
    side = float((cloud.max(axis=0) - low).max()) / _CELLS
    if side == 0:
        return cloud[:1], 0.0
    cell = np.floor((cloud - low) / side).astype(np.int64)
    key = (cell[:, 0] * (_CELLS + 1) + cell[:, 1]) * (_CELLS + 1) + cell[:, 2]
    first = np.unique(key, return_index=True)[1]
    # Half of a cell's diagonal, and a little for rounding at its faces.
    return low + (cell[first] + 0.5) * side, 0.5 * float(np.sqrt(3)) * side * (1 + 1e-9)
