"""Carving: a body of grid vertices around a given set that is topologically a ball, whatever the set.

A box is a ball. A vertex whose removal changes nothing of the topology (a *simple* vertex, ``kuhn_grid``) can be
taken away, and the ball stays one. Taking away what is farthest from the set first, until nothing more can go, leaves
the set and, where its topology is not a ball's, membranes across its handles, threads between its parts, and its voids
filled: what a falling flood of the distance meets last. (Homotopic thinning guided by distance; for the removal of many
simple vertices at once see Bertrand and Couprie 2014.)
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.closing.kuhn_grid import NEIGHBORS, flat_offsets, simple_vertices
from fsh3d_o3d.geometry import BoolArray

_BAND = 0.5  # edges of the grid, a choice: vertices whose distances differ by less are carved at once


def carve(kept: BoolArray) -> BoolArray:
    """Return the vertices (nx, ny, nz) of a ball that holds all vertices of ``kept``, which must not be empty.

    The faces of the grid stay outside; ``kept`` must not touch them.
    """
    shape = kept.shape
    body = np.zeros(shape, dtype=np.uint8)
    body[1:-1, 1:-1, 1:-1] = 1
    level = np.ceil(scipy.ndimage.distance_transform_edt(~kept) / _BAND).astype(np.int16)
    level[body == 0] = 0
    alive, rank = body.ravel(), level.ravel()
    order = np.flatnonzero(rank)  # level 0 is what is kept
    order = order[np.argsort(-rank[order], kind="stable")]
    levels, starts = np.unique(-rank[order], return_index=True)
    stops = np.append(starts, len(order))[1:]
    for least, start, stop in zip(-levels, starts, stops, strict=True):
        _carve_band(alive, rank, int(least), order[start:stop], shape)
    return body.astype(np.bool_)


def _carve_band(
    alive: NDArray[np.uint8], rank: NDArray[np.int16], least: int, active: IntArray, shape: tuple[int, ...]
) -> None:
    """Remove simple vertices of rank ``least`` or more until none is left that can go, beginning with ``active``."""
    offsets = flat_offsets(NEIGHBORS, shape)
    bits = (1 << np.arange(len(offsets))).astype(np.int16)
    simple = simple_vertices()
    while active.size:
        removed = []
        # No two vertices of equal parity are neighbours: none changes whether another one is simple.
        x, y, z = np.unravel_index(active, shape)
        parity = (x & 1) << 2 | (y & 1) << 1 | z & 1
        for each in range(8):
            some = active[parity == each]
            code = alive[some[:, None] + offsets] @ bits
            gone = some[simple[code]]
            alive[gone] = 0
            removed.append(gone)
        around = np.unique(np.concatenate(removed)[:, None] + offsets)
        active = around[(alive[around] != 0) & (rank[around] >= least)]
