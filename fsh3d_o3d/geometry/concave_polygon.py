"""One concave polygon of the plane into triangles.

Ear clipping is Manifold's: it keeps every corner and every side, those on a straight line and those of no length too,
so that neighbours still meet, and it always returns n − 2 triangles. Its time grows with the square of the corners,
so large polygons are first halved along diagonals.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import Float64Array, IntArray

_SMALL = 2000  # corners; ear clipping takes some milliseconds
_HOPELESS = 20_000  # corners; ear clipping of more takes minutes where the polygon crosses itself everywhere
_ATTEMPTS = 32  # lines on which a diagonal is looked for, a bound: each costs a sort of the corners
_GOLDEN_ANGLE = 2.399963  # radians; multiples of it fall on no axis and are spread evenly
_LEVELS = (0.5, 0.3, 0.7, 0.4, 0.6, 0.2, 0.8)  # share of the corners below the line, a choice: the middle first
_SEGMENTS = 4  # of a line inside the polygon, a choice: those with the most corners on both sides first
_BALANCED = 1 / 4  # of the corners on the smaller side of a diagonal, a choice: good enough to look no further
_LEAST_SHARE = 1 / 50  # of the corners on the smaller side, a choice: less is no progress


def triangulate(points: Float64Array) -> IntArray | None:
    """Cut a polygon whose diagonals stay inside into triangles of the same sense.

    Args:
        points: (n, 2) corners against the clock, n >= 3, about of size one.

    Returns:
        (n − 2, 3) corners, a partition where the polygon is simple. Where it crosses itself they overlap. None where
        it has very many corners and no diagonal is found.
    """
    manifold3d = import_installed("manifold3d")  # only where it is needed: reading starts sooner without

    whole = np.arange(len(points))
    triangles = []
    todo = [whole]
    while todo:
        piece = todo.pop()
        chord = _balanced_diagonal(points[piece]) if len(piece) > _SMALL else None
        if chord is not None:
            i, j = chord
            todo += [piece[i : j + 1], np.concatenate([piece[j:], piece[: i + 1]])]
        elif len(piece) > _HOPELESS:
            return None
        else:
            triangles.append(piece[manifold3d.triangulate([points[piece]])])
    return cast(IntArray, np.concatenate(triangles))


def _balanced_diagonal(points: Float64Array) -> tuple[int, int] | None:
    """Return two corners i < j that see each other and have many corners on both sides; None where none is found."""
    size = len(points)
    best, best_share = None, _LEAST_SHARE
    for attempt in range(_ATTEMPTS):
        angle = attempt * _GOLDEN_ANGLE
        line = np.array([np.cos(angle), np.sin(angle)])
        along, height = points @ line, _cross(line, points)
        level = float(np.quantile(height, _LEVELS[attempt % len(_LEVELS)]))
        for i, j in _visible_pairs(along, height, level):
            share = min(abs(i - j), size - abs(i - j)) / size
            if share > best_share and _is_diagonal(points, i, j):
                best, best_share = (min(i, j), max(i, j)), share
        if best_share >= _BALANCED:
            break
    return best


def _visible_pairs(along: Float64Array, height: Float64Array, level: float) -> list[tuple[int, int]]:
    """Return pairs of corners that see each other near a line at a height, where it runs inside the polygon."""
    above = height > level
    start = np.flatnonzero(above != np.roll(above, -1))
    stop = (start + 1) % len(height)
    slope = (along[stop] - along[start]) / (height[stop] - height[start])
    place = along[start] + (level - height[start]) * slope
    order = np.argsort(place, kind="stable")
    # Along the line the polygon begins at each second side that is met, and ends at the next.
    left, right = order[0::2], order[1::2]
    apart = np.abs(start[left] - start[right])
    balance = np.minimum(apart, len(height) - apart)
    found = []
    for segment in np.argsort(-balance, kind="stable")[:_SEGMENTS].tolist():
        a, b = left[segment], right[segment]
        up = height - level
        between = (along > place[a] + up * slope[a]) & (along < place[b] + up * slope[b])
        nearest = []
        for half, sign in ((above, 1), (~above, -1)):
            ends = [int(start[side] if half[start[side]] else stop[side]) for side in (a, b)]
            corners = np.append(np.flatnonzero(between & half), ends)
            nearest.append(int(corners[np.argmin(sign * up[corners])]))
            found.append(_bridge(along, sign * up, corners, ends[0], ends[1]))
        # Between the nearest heights on both sides the two sides span an empty trapezoid.
        found.append((nearest[0], nearest[1]))
    return found


def _bridge(along: Float64Array, up: Float64Array, corners: IntArray, a: int, b: int) -> tuple[int, int]:
    """Return one edge, with many corners on both sides, of the convex chain from a to b that keeps below ``corners``.

    The chain is what a string from a to b becomes when it is pulled down to the line at height zero.
    """
    size = len(along)
    while True:
        depth = (along[b] - along[a]) * (up[corners] - up[a]) - (up[b] - up[a]) * (along[corners] - along[a])
        if depth.min() >= 0:
            return a, b
        middle = int(corners[depth.argmin()])
        corners = corners[(depth < 0) & (corners != middle)]
        if min(abs(a - middle), size - abs(a - middle)) > min(abs(b - middle), size - abs(b - middle)):
            b = middle
        else:
            a = middle
        if not len(corners):
            return a, b


def _is_diagonal(points: Float64Array, i: int, j: int) -> bool:
    """Whether the segment between two corners lies inside and touches nothing but them."""
    size = len(points)
    if (i - j) % size in (0, 1, size - 1) or not (_in_angle(points, i, j) and _in_angle(points, j, i)):
        return False
    start = np.arange(size)
    stop = (start + 1) % size
    apart = (start != i) & (start != j) & (stop != i) & (stop != j)
    a, b = points[start[apart]], points[stop[apart]]
    chord = points[j] - points[i]
    touches = (_cross(chord, a - points[i]) * _cross(chord, b - points[i]) <= 0) & (
        _cross(b - a, points[i] - a) * _cross(b - a, points[j] - a) <= 0
    )
    return not bool(touches.any())


def _in_angle(points: Float64Array, i: int, j: int) -> bool:
    ahead, back = points[(i + 1) % len(points)] - points[i], points[i - 1] - points[i]
    chord = points[j] - points[i]
    left, right = bool(_cross(ahead, chord) > 0), bool(_cross(chord, back) > 0)
    return (left and right) if _cross(ahead, back) > 0 else (left or right)


def _cross(u: Float64Array, v: Float64Array) -> Float64Array:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
