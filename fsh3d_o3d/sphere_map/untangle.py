"""Local untangling: lays the surroundings of flipped triangles out evenly again."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import BoolArray
from fsh3d_o3d.sphere_map.laplacian import factorised
from fsh3d_o3d.sphere_map.mobius import normalized
from fsh3d_o3d.sphere_map.validity import orientations

# Vertices whose distance from a flipped triangle is at most so many edges are free, round by round. A choice.
_RINGS = (0, 0, 1, 1, 2, 2, 3, 4, 5, 6, 8, 10, 12, 16)
_REPROJECTIONS = 3  # rounds, a choice: on a curved patch the even layout and the projection to the sphere take turns


def untangled(sphere: Float64Array, triangles: IntArray) -> Float64Array:
    """Return the map with the patches around flipped triangles relaxed until none is left, or the rounds are.

    In a patch each free vertex goes to the mean of its neighbours (Tutte's embedding, valid where the rim of the patch
    is convex); where that does not do, the next round takes a wider patch. A round that leaves more flipped triangles
    than there were is undone. The result need not be valid.
    """
    n = len(sphere)
    start, end = triangles.ravel(), triangles[:, (1, 2, 0)].ravel()
    # Every edge is a half-edge of two triangles, once each way.
    adjacency = csr_array((np.ones(len(start)), (start, end)), shape=(n, n))
    flipped = orientations(sphere, triangles) <= 0
    for rings in _RINGS:
        if not flipped.any():
            break
        free = np.zeros(n, dtype=np.bool_)
        free[triangles[flipped]] = True
        for _ in range(rings):
            free |= adjacency @ free > 0
        if free.all():
            break
        relaxed = _relaxed(sphere, adjacency, free)
        still = orientations(relaxed, triangles) <= 0
        if np.count_nonzero(still) <= np.count_nonzero(flipped):
            sphere, flipped = relaxed, still
    return sphere


def _relaxed(sphere: Float64Array, adjacency: csr_array, free: BoolArray) -> Float64Array:
    inner = np.flatnonzero(free)
    rows = adjacency[inner]
    valence = rows.sum(axis=1)
    factors = factorised(csc_array(diags_array(valence) - rows[:, inner]))
    result = sphere.copy()
    for _ in range(_REPROJECTIONS):
        # Solved for the move, so that rounding is relative to the patch and not to the sphere.
        moved = result[inner] + factors.solve(rows @ result - valence[:, None] * result[inner])
        result[inner] = normalized(moved)
    return result
