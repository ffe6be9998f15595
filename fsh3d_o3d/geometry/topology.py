"""Edges of a triangle mesh and what follows from them, by sorting instead of walking."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from fsh3d_o3d._validation import IntArray

BoolArray = NDArray[np.bool_]


class EdgeTable:
    """The half-edges of triangles (t, 3) without repeated corners, grouped by undirected edge."""

    def __init__(self, triangles: IntArray) -> None:
        self.triangles = triangles
        start = triangles.ravel()
        end = triangles[:, (1, 2, 0)].ravel()
        low, high = np.minimum(start, end), np.maximum(start, end)
        key = low * (np.int64(triangles.max(initial=0)) + 1) + high
        self.order: IntArray = np.argsort(key, kind="stable")
        """(3t,) half-edges, edge by edge; half-edge h runs from corner h % 3 of triangle h // 3 to the next one."""
        key = key[self.order]
        first = np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1])))
        self.first: IntArray = first
        """(e,) place in ``order`` of each edge's first half-edge."""
        self.faces: IntArray = np.diff(first, append=len(key))
        """(e,) number of triangles at each edge."""
        self.ends: IntArray = np.column_stack((low[self.order[first]], high[self.order[first]]))
        """(e, 2) vertices of each edge."""
        self._forward = start < end

    @property
    def balanced(self) -> bool:
        """Whether every edge runs as often one way as the other, so that the surface bounds a volume."""
        sign = np.where(self._forward[self.order], 1, -1)
        return not np.add.reduceat(sign, self.first).any()

    def pairs(self) -> IntArray:
        """Return the half-edges (p, 2) of edges with exactly two triangles."""
        first = self.first[self.faces == 2]
        return np.column_stack((self.order[first], self.order[first + 1]))

    def opposite(self, pairs: IntArray) -> BoolArray:
        """Return for each pair whether its two half-edges run in opposite directions."""
        return np.asarray(self._forward[pairs[:, 0]] != self._forward[pairs[:, 1]])

    def neighbors(self) -> IntArray:
        """Return a triangle (t, 3) across each edge of each triangle, itself at a boundary.

        Around an edge of more than two triangles each names the next, so that walking on visits all of them.
        """
        following = np.roll(self.order, -1)
        last = self.first + self.faces - 1
        following[last] = self.order[self.first]
        across = np.empty_like(self.order)
        across[self.order] = following // 3
        return across.reshape(-1, 3)

    def fans(self) -> int:
        """Return the number of groups of corners that meet at a vertex and hang together by edges there."""
        # Corners at the same end of an edge are linked. Edges of more than two triangles link each to the first.
        anchor = np.repeat(self.order[self.first], self.faces)
        linked = anchor != self.order
        one, other = anchor[linked], self.order[linked]
        same = self._forward[one] == self._forward[other]
        one_end, other_end = _next_corner(one), _next_corner(other)
        rows = np.concatenate((one, one_end))
        columns = np.concatenate((np.where(same, other, other_end), np.where(same, other_end, other)))
        return components(rows, columns, self.triangles.size)[0]

    def flips(self) -> BoolArray | None:
        """Return which triangles (t,) to turn over to orient all alike; None: not orientable.

        Of the two ways to orient a component, the one that turns over fewer triangles.
        """
        pairs = self.pairs()
        count = len(self.triangles)
        opposite = self.opposite(pairs)
        if opposite.all():
            return np.zeros(count, dtype=np.bool_)
        # Two copies of each triangle, as given and turned over; consistent copies are linked.
        one, other = pairs[:, 0] // 3, pairs[:, 1] // 3
        shift = np.where(opposite, 0, count)
        rows = np.concatenate((one, one + count))
        columns = np.concatenate((other + shift, other + count - shift))
        number, label = components(rows, columns, 2 * count)
        if np.any(label[:count] == label[count:]):
            return None
        size = np.bincount(label[:count], minlength=number)  # triangles that a labelled side keeps as given
        kept, turned = size[label[:count]], size[label[count:]]
        return np.asarray((turned > kept) | ((turned == kept) & (label[count:] < label[:count])))


def components(rows: IntArray, columns: IntArray, count: int) -> tuple[int, NDArray[Any]]:
    """Return the number of connected components of a graph of ``count`` nodes and the label (count,) of each."""
    graph = csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    number, label = connected_components(graph, directed=False)
    return int(number), label


def _next_corner(half_edge: IntArray) -> IntArray:
    return np.asarray(np.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1))
