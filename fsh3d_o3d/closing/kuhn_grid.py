"""The cubic grid cut into tetrahedra along its diagonals: neighbours, simple vertices, iso-surfaces.

Every cube is cut into the six tetrahedra around its diagonal (0, 0, 0)–(1, 1, 1) (Kuhn 1960, Freudenthal 1942), so that
neighbouring cubes agree on their common face. Each vertex then has 14 neighbours. The surface between the vertices of
two labels, cut by marching tetrahedra, is a manifold whatever the labels are: no case is ambiguous, as with cubes.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import BoolArray, MeshArrays, components

HALF_NEIGHBORS: IntArray = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)])
"""(7, 3) offsets of one half of a vertex' neighbours; the other half are their opposites."""
NEIGHBORS: IntArray = np.concatenate((HALF_NEIGHBORS, -HALF_NEIGHBORS))
"""(14, 3) offsets of a vertex' neighbours. None is even in all three: vertices alike in parity are not neighbours."""

# The paths from corner 0 to corner 7 of a cube along its edges, corner c at the bits (c & 1, c >> 1 & 1, c >> 2).
_TETRAHEDRA = np.array([(0, 1 << i, 1 << i | 1 << j, 7) for i, j, _ in itertools.permutations(range(3))])
_CORNERS = np.array([(c & 1, c >> 1 & 1, c >> 2) for c in range(8)])


def flat_offsets(offsets: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Return offsets (m, 3) as differences of flat indices into an array of that shape."""
    return np.asarray(offsets @ np.array([shape[1] * shape[2], shape[2], 1]), dtype=np.int64)


def structure() -> BoolArray:
    """Return the neighbourhood as the (3, 3, 3) element that ``scipy.ndimage`` takes."""
    element = np.zeros((3, 3, 3), dtype=np.bool_)
    element[tuple((NEIGHBORS + 1).T)] = True
    element[1, 1, 1] = True
    return element


@functools.cache
def simple_vertices() -> BoolArray:
    """Return which vertices are simple, (2¹⁴,), looked up by which of ``NEIGHBORS`` are in the body (bit k: number k).

    A vertex is simple if taking it out of the body, or into it, changes neither the body's topology nor its
    surroundings': around it, on the sphere that its neighbours span, those in the body hang together, and so do the
    others, and there are some of both.
    """
    # Neighbours are neighbours of each other where their difference is one of the 14 offsets.
    adjacent = (NEIGHBORS[:, None, None] - NEIGHBORS[:, None] == NEIGHBORS).all(axis=3).any(axis=2)
    first, second = np.nonzero(adjacent)
    code = np.arange(2**14)
    member = (code[:, None] >> np.arange(14) & 1).astype(np.bool_)
    alike = member[:, first] == member[:, second]
    row, edge = np.nonzero(alike)
    _, label = components(row * 14 + first[edge], row * 14 + second[edge], 14 * len(code))
    parts = np.sort(label.reshape(-1, 14), axis=1)
    number = 1 + np.count_nonzero(np.diff(parts, axis=1), axis=1)
    # One connected group on either side; the two codes with all members alike have one group in all.
    simple: BoolArray = number == 2
    simple &= member.any(axis=1) & ~member.all(axis=1)
    simple.setflags(write=False)
    return simple


def between(body: BoolArray, values: Float64Array, clearance: float) -> tuple[MeshArrays, IntArray]:
    """Return the surface between a body and its surroundings, wound outward, by marching tetrahedra.

    Args:
        body: (nx, ny, nz) which vertices of the grid belong to the body; none on the faces of the grid.
        values: (nx, ny, nz) how far each vertex is from the surface, not negative.
        clearance: Least distance of the surface from the ends of the edges it crosses, in lengths of the edge, in
            (0, 0.5): smaller ones make smaller triangles.

    Returns:
        The mesh, in units of the grid, and the ends (v, 2) of the edge each of its vertices is on: flat indices into
        the grid, in the body first.
    """
    shape = body.shape
    inside, flat = body.ravel(), values.ravel()
    corner = flat_offsets(_CORNERS, shape)
    count = np.zeros(tuple(n - 1 for n in shape), dtype=np.int8)
    for offset in _CORNERS:
        count += body[tuple(slice(o, n - 1 + o) for o, n in zip(offset, shape, strict=True))]
    cubes = np.stack(np.nonzero((count > 0) & (count < 8)), axis=1) @ flat_offsets(np.eye(3, dtype=np.int64), shape)
    cells = (cubes[:, None, None] + corner[_TETRAHEDRA]).reshape(-1, 4)
    # The corners of odd permutations run the other way round.
    parity = np.tile(np.array([_sign(tetrahedron) for tetrahedron in _TETRAHEDRA]), len(cubes))
    cells[parity < 0] = cells[parity < 0][:, (1, 0, 2, 3)]
    case = (inside[cells] << np.arange(4)).sum(axis=1)
    starts, ends = [], []
    for number in range(1, 15):
        chosen = cells[case == number]
        for triangle in _cuts(number):
            starts.append(chosen[:, [a for a, _ in triangle]])
            ends.append(chosen[:, [b for _, b in triangle]])
    start, end = np.concatenate(starts), np.concatenate(ends)
    edges, index = np.unique(start * np.int64(inside.size) + end, return_inverse=True)
    ends_of = np.column_stack(np.divmod(edges, inside.size))
    near, far = flat[ends_of[:, 0]], flat[ends_of[:, 1]]
    total = near + far
    share = np.clip(np.where(total > 0, near / np.where(total > 0, total, 1), 0.5), clearance, 1 - clearance)
    low, high = (np.stack(np.unravel_index(ends_of[:, k], shape), axis=1) for k in range(2))
    vertices = low + share[:, None] * (high - low)
    return MeshArrays(vertices, index.reshape(-1, 3)), ends_of


def _cuts(case: int) -> list[tuple[tuple[int, int], ...]]:
    """The triangles that cut a positively oriented tetrahedron, seen from outside the body; corners as edges.

    Bit k of ``case`` tells whether corner k is in the body; an edge runs from within it to without.
    """
    body = [k for k in range(4) if case >> k & 1]
    rest = [k for k in range(4) if not case >> k & 1]
    if len(body) == 2:
        (a, b), (c, d) = body, rest
        ring = [(a, c), (a, d), (b, d), (b, c)]
    else:
        ring = [(a, b) for a in body for b in rest]
    # Around a single corner of the body the ring runs as the others do, around one of the rest the other way.
    even = _even((*body, *rest)) if len(body) < 3 else not _even((*rest, *body))
    ring = ring if even else ring[::-1]
    return [(ring[0], *ring[k : k + 2]) for k in range(1, len(ring) - 1)]


def _even(order: tuple[int, ...]) -> bool:
    return sum(a > b for a, b in itertools.combinations(order, 2)) % 2 == 0


def _sign(tetrahedron: NDArray[np.int64]) -> int:
    a, b, c, d = _CORNERS[tetrahedron]
    return int(np.sign(np.linalg.det(np.stack((b - a, c - a, d - a)).astype(float))))
