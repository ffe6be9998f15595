"""Intrinsic Delaunay triangulation: flips edges within the surface, which itself does not change.

Fisher, Springborn, Schröder and Bobenko, An Algorithm for the Construction of Intrinsic Delaunay Triangulations, 2007.
Edges are flipped in rounds of many that share no triangle, each round a handful of array operations.
"""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray

_ROUNDS = 1000  # of flips, far more than any surface takes; they only ever lower an energy
_COCIRCULAR = 1e-12  # of a cotangent sum, far above rounding: cocircular corners must not flip back and forth


def intrinsic_delaunay(triangles: IntArray, lengths: Float64Array) -> tuple[IntArray, Float64Array]:
    """Return the intrinsic Delaunay triangles (t, 3) and edge lengths (t, 3) of a closed oriented surface.

    ``lengths`` holds the edge from each corner to the next. Edges of the result are geodesics of the surface: two may
    join the same vertices, and one may lead back to its vertex.
    """
    corner = triangles.ravel().copy()
    length = lengths.ravel().copy()
    twin = _twins(triangles)
    # Of each edge its first half-edge stands for it.
    pending = np.flatnonzero(np.arange(len(twin)) < twin)
    for _ in range(_ROUNDS):
        pending = pending[pending // 3 != twin[pending] // 3]  # between a triangle and itself nothing can flip
        weight = _cotangent(length, pending) + _cotangent(length, twin[pending])
        violating = weight < -_COCIRCULAR
        if not violating.any():
            break
        chosen = _independent(pending[violating], twin, weight[violating])
        touched = np.concatenate((chosen // 3, twin[chosen] // 3))
        _flip(chosen, corner, length, twin)
        around = (3 * touched[:, None] + np.arange(3)).ravel()
        again = np.concatenate((pending[violating], around))
        pending = np.unique(np.minimum(again, twin[again]))
    return corner.reshape(-1, 3), length.reshape(-1, 3)


def _twins(triangles: IntArray) -> IntArray:
    """Return the half-edge (3t,) that runs against each; half-edge h starts at corner h % 3 of triangle h // 3."""
    start, end = triangles.ravel(), triangles[:, (1, 2, 0)].ravel()
    count = np.int64(triangles.max()) + 1
    forth, back = np.argsort(start * count + end), np.argsort(end * count + start)
    twin = np.empty_like(forth)
    twin[forth] = back
    return twin


def _next(half_edge: IntArray) -> IntArray:
    return np.asarray(np.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1))


def _cotangent(length: Float64Array, half_edge: IntArray) -> Float64Array:
    """Return the cotangent of the angle opposite each half-edge, ±1e300 or so where the triangle is flat."""
    base, x, y = length[half_edge], length[_next(half_edge)], length[_next(_next(half_edge))]
    return np.asarray((x * x + y * y - base * base) / np.maximum(2 * _double_area(base, x, y), 1e-300))


def _double_area(x: Float64Array, y: Float64Array, z: Float64Array) -> Float64Array:
    c, b, a = np.sort(np.stack((x, y, z)), axis=0)
    return np.asarray(np.sqrt(np.maximum((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c)), 0.0)) / 2)


def _independent(edges: IntArray, twin: IntArray, weight: Float64Array) -> IntArray:
    """Return those of ``edges`` that are the worst of both their triangles, so that no two share one."""
    rank = np.empty(len(edges), dtype=np.int64)
    rank[np.lexsort((edges, weight))] = np.arange(len(edges))
    one, other = edges // 3, twin[edges] // 3
    best = np.full(len(twin) // 3, len(edges))
    np.minimum.at(best, one, rank)
    np.minimum.at(best, other, rank)
    return np.asarray(edges[(best[one] == rank) & (best[other] == rank)])


def _flip(edges: IntArray, corner: IntArray, length: Float64Array, twin: IntArray) -> None:
    """Replace the edge a → b of triangles (a, b, c) and (b, a, d) by that of (a, d, c) and (d, b, c), in place."""
    ab, ba = edges, twin[edges]
    bc, ad = _next(ab), _next(ba)
    ca, db = _next(bc), _next(ad)
    a, b, c, d = corner[ab], corner[ba], corner[ca], corner[db]
    base = length[ab]
    # Both triangles unfolded into the plane of the shared edge.
    along_c = (base**2 + length[ca] ** 2 - length[bc] ** 2) / (2 * base)
    along_d = (base**2 + length[ad] ** 2 - length[db] ** 2) / (2 * base)
    height = (_double_area(base, length[bc], length[ca]) + _double_area(base, length[ad], length[db])) / base
    diagonal = np.maximum(np.hypot(along_c - along_d, height), 1e-12 * base)

    first, second = ab - ab % 3, ba - ba % 3
    old = (ad, ca, db, bc)
    new = (first, first + 2, second, second + 1)
    place = np.arange(len(twin))
    for source, target in zip(old, new, strict=True):
        place[source] = target
    outer = np.concatenate(old)
    partner, lengths = twin[outer], length[outer]
    target = place[outer]
    twin[target] = place[partner]
    twin[place[partner]] = target
    twin[first + 1], twin[second + 2] = second + 2, first + 1
    length[target] = lengths
    length[first + 1] = length[second + 2] = diagonal
    for offset, (x, y) in enumerate(((a, d), (d, b), (c, c))):
        corner[first + offset], corner[second + offset] = x, y
