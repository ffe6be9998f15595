"""Decimation of a closed genus-0 triangulation down to a tetrahedron, in rounds of independent collapses.

A round removes vertices no two of which are adjacent (Dobkin and Kirkpatrick 1985), each by collapsing it onto a
neighbour, so that a round is a handful of array operations and there are O(log n) of them. A collapse onto u replaces
the star of the removed vertex by the fan of triangles from u. It keeps a simplicial sphere exactly when none of the new
edges exists already (the link condition); the edges outside a star that join its rim are planar, so every vertex has at
least two neighbours to go to, and a round never comes out empty. Stars of non-adjacent vertices share no triangle; what
two collapses of a round could still do is make the same new edge, so the dearer of them waits for the next round.

Which vertices go, and where to, follows the quadrics of Garland and Heckbert (1997): the coarse meshes look like the
surface, so that what is optimised on them is worth keeping on the finer ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import BoolArray, triangle_normals

_MAXIMUM_DEGREE = 9  # of a vertex to remove, a choice: the mean is below 6, so 4/7 of the vertices qualify at any time
_CHEAPEST = 0.6  # the share of those that a round may touch, a choice: the rest is what gives the surface its shape
_PASSES = 3  # of growing the independent set; more find almost nothing
_COST_SPREAD = 4.0  # largest random factor of a cost, a choice: on an even slope it makes many local minima of one
_POINT_WEIGHT = 1e-2  # of distances to points beside distances to planes: in flat parts the spacing decides; a choice
_LEAST_QUALITY = 0.05  # 1 if equilateral: a fan's worst triangle, folded or not, counts as this good; a choice
_HUB_DEGREE = 7  # beyond which a collapse costs more, a choice: hubs leave the rounds for good
_SEED = 20030727  # any: it is fixed so that the same mesh gives the same hierarchy


@dataclass(frozen=True, eq=False)
class Stars:
    """Vertices of equal degree that a level has and the next coarser one has not."""

    vertices: IntArray
    """(m,) the vertices."""
    rings: IntArray
    """(m, d) their neighbours, counter-clockwise, all of them vertices of the coarser level."""


@dataclass(frozen=True, eq=False)
class Level:
    """One triangulation of the hierarchy: the vertices 0 … ``count`` − 1, so that levels are slices of one array."""

    count: int
    """Number of vertices."""
    triangles: IntArray
    """(2 count − 4, 3) outward triangles."""
    stars: tuple[Stars, ...]
    """What the level adds to the next coarser one, by degree; empty at the coarsest."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Triangulations of the sphere from a tetrahedron to the mesh itself."""

    order: IntArray
    """(n,) the mesh's vertices in the order of the levels: vertex i of a level is vertex ``order[i]`` of the mesh."""
    levels: tuple[Level, ...]
    """Coarsest first; the last one has the mesh's own triangles, in the mesh's order."""


@dataclass(frozen=True, eq=False)
class _Round:
    """A decimation round in the numbering of the triangulation it starts from."""

    triangles: IntArray
    removed: tuple[Stars, ...]
    coarse: IntArray
    kept: IntArray


def build_hierarchy(vertices: Float64Array, triangles: IntArray) -> Hierarchy:
    """Decimate a closed genus-0 mesh to a tetrahedron.

    Args:
        vertices: (n, 3) float64 positions, n >= 4; they steer the choice of collapses only, any will do.
        triangles: (2n − 4, 3) int64, consistently oriented, using every vertex: a simplicial sphere.
    """
    generator = np.random.default_rng(_SEED)
    points = _normalised(vertices)
    quadrics = _quadrics(points, triangles)
    names = np.arange(len(points))
    rounds: list[tuple[IntArray, _Round]] = []
    while len(names) > 4:
        step = _decimate(points, triangles, quadrics, generator)
        rounds.append((names, step))
        names, points, quadrics, triangles = names[step.kept], points[step.kept], quadrics[step.kept], step.coarse
    # In the mesh's order within a round, for the sake of locality.
    removed = [names[np.sort(np.concatenate([stars.vertices for stars in step.removed]))] for names, step in rounds]
    order = np.concatenate((names, *removed[::-1]))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    levels = [Level(len(names), place[names[triangles]], ())]
    for fine, step in reversed(rounds):
        at = place[fine]
        stars = tuple(Stars(at[group.vertices], at[group.rings]) for group in step.removed)
        levels.append(Level(len(fine), at[step.triangles], stars))
    return Hierarchy(order, tuple(levels))


def _decimate(
    points: Float64Array, triangles: IntArray, quadrics: Float64Array, generator: np.random.Generator
) -> _Round:
    """Remove an independent set of vertices; ``quadrics`` (k, 10) of those that stay take up those that go."""
    count = len(points)
    origin, target = triangles.ravel(), triangles[:, (1, 2, 0)].ravel()
    degree = np.bincount(origin, minlength=count)
    cost = np.full(count, np.inf)
    np.minimum.at(cost, origin, _evaluate(quadrics[origin], points[target]))
    eligible = degree <= _MAXIMUM_DEGREE
    cost = (cost + 1e-30) * _COST_SPREAD ** generator.random(count)
    eligible &= cost <= np.quantile(cost[eligible], _CHEAPEST)
    chosen = _independent(cost, eligible, origin, target)
    edges = np.sort(origin[origin < target] * count + target[origin < target])
    fans = [_best_fans(stars, points, quadrics, degree, edges) for stars in _stars(triangles, chosen, degree)]
    accepted = _compatible(fans, cost, count)
    fans = [Stars(stars.vertices[good], stars.rings[good]) for stars, good in zip(fans, accepted, strict=True)]
    fans = [stars for stars in fans if len(stars.vertices)]
    gone = np.zeros(count, dtype=np.bool_)
    for stars in fans:
        gone[stars.vertices] = True
        np.add.at(quadrics, stars.rings[:, 0], quadrics[stars.vertices])
    kept = np.flatnonzero(~gone)
    new = [_fan(stars.rings).reshape(-1, 3) for stars in fans]
    place = np.cumsum(~gone) - 1
    coarse = place[np.concatenate((triangles[~gone[triangles].any(axis=1)], *new))]
    return _Round(triangles, tuple(fans), coarse, kept)


def _independent(cost: Float64Array, eligible: BoolArray, origin: IntArray, target: IntArray) -> BoolArray:
    """Return eligible vertices no two of which are adjacent: those cheaper than every neighbour, a few times over."""
    waiting = np.where(eligible, cost, np.inf)
    chosen = np.zeros(len(cost), dtype=np.bool_)
    for _ in range(_PASSES):
        around = np.full(len(cost), np.inf)
        np.minimum.at(around, origin, waiting[target])
        lowest = waiting < around
        chosen |= lowest
        waiting[lowest] = np.inf
        waiting[target[lowest[origin]]] = np.inf
    return chosen


def _stars(triangles: IntArray, chosen: BoolArray, degree: IntArray) -> Iterator[Stars]:
    """Yield the chosen vertices by degree, with their neighbours in counter-clockwise order."""
    corner = np.flatnonzero(chosen[triangles])
    vertex = triangles.ravel()[corner]
    corner = corner[np.argsort(vertex, kind="stable")]
    first, second = (triangles.ravel()[corner - corner % 3 + (corner + k) % 3] for k in (1, 2))
    vertices = np.flatnonzero(chosen)
    start = np.cumsum(degree[vertices]) - degree[vertices]
    for d in np.unique(degree[vertices]):
        of_degree = degree[vertices] == d
        slots = start[of_degree][:, None] + np.arange(d)
        follower, ahead = second[slots], first[slots]
        rings = np.empty_like(slots)
        rings[:, 0] = ahead[:, 0]
        for k in range(1, d):
            slot = (ahead == rings[:, k - 1, None]).argmax(axis=1)
            rings[:, k] = np.take_along_axis(follower, slot[:, None], axis=1)[:, 0]
        yield Stars(vertices[of_degree], rings)


def _best_fans(stars: Stars, points: Float64Array, quadrics: Float64Array, degree: IntArray, edges: IntArray) -> Stars:
    """Return the stars with each ring turned so that it begins with the neighbour to collapse onto."""
    rings, d = stars.rings, stars.rings.shape[1]
    blocked = np.zeros(rings.shape, dtype=np.bool_)
    for i, j in _chords(d):
        key = np.minimum(rings[:, i], rings[:, j]) * len(points) + np.maximum(rings[:, i], rings[:, j])
        exists = edges[np.minimum(np.searchsorted(edges, key), len(edges) - 1)] == key
        blocked[:, i] |= exists
        blocked[:, j] |= exists
    corners = points[rings]
    error = np.abs(_evaluate(quadrics[stars.vertices][:, None], corners)) + 1e-30
    hub = 1.0 + np.square(np.maximum(degree[rings] + d - 4.0 - _HUB_DEGREE, 0.0))
    normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)
    normal /= np.sqrt(np.einsum("mx,mx->m", normal, normal))[:, None] + 1e-300
    turn = (np.arange(d)[:, None] + np.arange(d)) % d
    quality = np.stack([_quality(corners[:, turn[i]], normal) for i in range(d)], axis=1)
    score = np.where(blocked, np.inf, error * hub / quality)
    best = score.argmin(axis=1)
    return Stars(stars.vertices, np.take_along_axis(rings, turn[best], axis=1))


def _chords(d: int) -> list[tuple[int, int]]:
    """Return the pairs of corners of a polygon of d corners that are not neighbours."""
    return [(i, j) for i in range(d) for j in range(i + 2, min(d, i + d - 1))]


def _quality(ring: Float64Array, normal: Float64Array) -> Float64Array:
    """Return how good (m,) the worst triangle of the fan from a ring's (m, d, 3) first point is, 1 if equilateral."""
    spoke = ring[:, 1:] - ring[:, :1]
    rim = spoke[:, 1:] - spoke[:, :-1]
    square = np.einsum("mdx,mdx->md", spoke, spoke)
    lengths = square[:, 1:] + square[:, :-1] + np.einsum("mdx,mdx->md", rim, rim)
    area = np.einsum("mdx,mx->md", np.cross(spoke[:, :-1], spoke[:, 1:]), normal)
    return np.asarray(np.maximum(2 * np.sqrt(3) * area / (lengths + 1e-300), _LEAST_QUALITY).min(axis=1))


def _compatible(stars: list[Stars], cost: Float64Array, count: int) -> list[BoolArray]:
    """Return which collapses (m,) of each group to do: the cheapest of those that would make the same edge."""
    owners, keys = [], []
    for group in stars:
        hub, rest = group.rings[:, :1], group.rings[:, 2:-1]
        keys.append((np.minimum(hub, rest) * count + np.maximum(hub, rest)).ravel())
        owners.append(np.repeat(group.vertices, rest.shape[1]))
    owner, key = np.concatenate(owners), np.concatenate(keys)
    order = np.lexsort((owner, cost[owner], key))
    repeated = order[1:][key[order][1:] == key[order][:-1]]
    late = np.zeros(count, dtype=np.bool_)
    late[owner[repeated]] = True
    chosen = np.concatenate([group.vertices for group in stars])
    ranked = chosen[np.lexsort((chosen, cost[chosen], late[chosen]))]
    late[ranked[count - 4 :]] = True  # a tetrahedron is left
    return [~late[group.vertices] for group in stars]


def _fan(rings: IntArray) -> IntArray:
    """Return the triangles (m, d − 2, 3) of the fans from the first vertices of rings (m, d)."""
    first = np.broadcast_to(rings[:, :1], (len(rings), rings.shape[1] - 2))
    return np.stack((first, rings[:, 1:-1], rings[:, 2:]), axis=-1)


def _normalised(vertices: Float64Array) -> Float64Array:
    """Return the vertices about the middle of their box, in units of its longest side."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float((high - low).max())
    return np.asarray((vertices - (low + high) / 2) / (size if size > 0 else 1.0))


def _quadrics(points: Float64Array, triangles: IntArray) -> Float64Array:
    """Return for each vertex (n, 10) the area-weighted squared distance to its triangles, as a polynomial.

    Coefficients of x², y², z², xy, yz, zx, x, y, z, 1; distances to the planes plus a little of those to the vertex.
    """
    corners = points[triangles]
    cross = triangle_normals(corners)
    area = np.sqrt(np.einsum("ij,ij->i", cross, cross)) / 2
    n = cross / (2 * area + 1e-300)[:, None]
    offset = -np.einsum("ij,ij->i", n, corners[:, 0])
    plane = np.column_stack((n * n, 2 * n * n[:, (1, 2, 0)], 2 * offset[:, None] * n, offset * offset)) * area[:, None]
    total = np.zeros((len(points), 10))
    mass = np.zeros(len(points))
    for k in range(3):
        np.add.at(total, triangles[:, k], plane)
        np.add.at(mass, triangles[:, k], area)
    mass *= _POINT_WEIGHT
    total[:, :3] += mass[:, None]
    total[:, 6:9] -= 2 * mass[:, None] * points
    total[:, 9] += mass * np.einsum("ij,ij->i", points, points)
    return total


def _evaluate(quadrics: Float64Array, points: Float64Array) -> Float64Array:
    """Return the values (…) of quadrics (…, 10) at points (…, 3)."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    monomials = np.stack((x * x, y * y, z * z, x * y, y * z, z * x, x, y, z, np.ones_like(x)), axis=-1)
    return np.asarray(np.einsum("...k,...k->...", quadrics, monomials))
