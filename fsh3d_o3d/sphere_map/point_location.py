"""Point location on the sphere: the triangle that holds a direction, and where in it; exact at any size.

All decisions are signs of determinants det[a, b, d], taken from differences of nearby vectors where that tells the
sign for certain and from an exact sum where it does not. Each direction therefore has an answer, and the answer does
not depend on the way it was found.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import EdgeTable

_BLOCK = 2**16  # directions at a time: some 40 MB of temporaries
_NEARLY_NEAREST = (
    0.5  # relative error of the nearest middle, a choice: a tight cluster is as far everywhere, and searched slowly
)
_PAIRS = 2**18  # directions times triangles at a time in the exhaustive search: some 150 MB of temporaries
# The rounding of det[near, end − start, d] is below 8 unit roundoffs of the product of the three lengths: one for each
# difference, three for the products and sums of the cross product and three for those with d.
_UNCERTAIN = 16 * np.finfo(np.float64).eps
_SPLITTER = 2.0**27 + 1  # halves the digits of a float64 (Veltkamp 1968)


def locate(sphere: Float64Array, triangles: IntArray, directions: Float64Array) -> tuple[IntArray, Float64Array]:
    """Find the spherical triangle around each direction and the direction's coordinates in it.

    From the triangle whose middle is nearest, each direction walks across edges that it lies beyond (Devillers, Pion
    and Teillaud 2001, "Walking in a triangulation") until there is none. A direction on an edge or vertex goes to the
    first of the triangles there.

    Args:
        sphere: (n, 3) unit vectors, all in use.
        triangles: (t, 3) of a closed manifold, oriented outward, that covers the sphere once.
        directions: (m, 3) unit vectors.

    Returns:
        The triangle (m,) of each direction, and its barycentric coordinates (m, 3): non-negative, of sum 1, those of
        the point where the direction meets the plane of the triangle's corners, d = λ(αa + βb + γc).

    Raises:
        GeometryError: A direction lies in no triangle: they do not cover the sphere.
    """
    search = TriangleSearch(sphere, triangles)
    found = np.empty(len(directions), dtype=np.int64)
    weights = np.empty((len(directions), 3))
    for start in range(0, len(directions), _BLOCK):
        block = slice(start, start + _BLOCK)
        found[block], weights[block] = search.locate(directions[block])
    return found, weights


class TriangleSearch:
    """Triangles on the sphere and what the search needs to know about them."""

    def __init__(self, sphere: Float64Array, triangles: IntArray) -> None:
        self._sphere = sphere
        self._triangles = triangles
        self._neighbors = EdgeTable(triangles).neighbors()
        middles = sphere[triangles].sum(axis=1)
        # A middle of exactly zero would take three corners on a great circle, which no valid triangle has.
        self._tree = KDTree(middles / np.linalg.norm(middles, axis=1, keepdims=True))
        # Of the triangles at each vertex the one with the lowest index, to settle ties.
        self._first = np.full(len(sphere), len(triangles))
        np.minimum.at(self._first, triangles, np.arange(len(triangles))[:, None])
        self._most_steps = 64 + 4 * math.isqrt(len(triangles))

    def locate(self, directions: Float64Array) -> tuple[IntArray, Float64Array]:
        """Return triangles (m,) and coordinates (m, 3) of directions (m, 3)."""
        found, volumes = self.walked(directions)
        lost = np.flatnonzero(found < 0)
        if lost.size:
            found[lost] = self.searched(directions[lost])
            volumes[lost] = self._volumes(found[lost], directions[lost])
        settled = self._settled(found, volumes)
        moved = np.flatnonzero(settled != found)
        found[moved], volumes[moved] = settled[moved], self._volumes(settled[moved], directions[moved])
        return found, volumes / volumes.sum(axis=1, keepdims=True)

    def walked(self, directions: Float64Array) -> tuple[IntArray, Float64Array]:
        """Walk from the nearest middle; triangles (m,), −1 where the walk does not end, and volumes (m, 3)."""
        found = np.full(len(directions), -1, dtype=np.int64)
        volumes = np.empty((len(directions), 3))
        # Where several edges are in the way one is drawn: the walk then ends, where a rule might lead in a circle.
        random = np.random.default_rng(0)
        walking = np.arange(len(directions))
        here = np.asarray(self._tree.query(directions, eps=_NEARLY_NEAREST)[1], dtype=np.int64)
        for _ in range(self._most_steps):
            seen = self._volumes(here, directions[walking])
            outside = seen < 0
            arrived = ~outside.any(axis=1)
            found[walking[arrived]], volumes[walking[arrived]] = here[arrived], seen[arrived]
            if arrived.all():
                break
            walking, here, outside = walking[~arrived], here[~arrived], outside[~arrived]
            # Corner k is opposite the edge k + 1.
            across = (np.argmax(outside * random.random(outside.shape), axis=1) + 1) % 3
            here = self._neighbors[here, across]
        return found, volumes

    def searched(self, directions: Float64Array) -> IntArray:
        """Return the first triangle around each direction, by trying all."""
        found = np.empty(len(directions), dtype=np.int64)
        step = max(1, _PAIRS // len(self._triangles))
        for start in range(0, len(directions), step):
            block = directions[start : start + step]
            every = np.tile(np.arange(len(self._triangles)), len(block))
            volumes = self._volumes(every, np.repeat(block, len(self._triangles), axis=0))
            inside = (volumes.min(axis=1) >= 0) & (volumes.max(axis=1) > 0)
            inside = inside.reshape(len(block), -1)
            if not inside.any(axis=1).all():
                raise GeometryError("the triangles do not cover the sphere: a direction lies in none of them")
            found[start : start + step] = inside.argmax(axis=1)
        return found

    def _settled(self, triangle: IntArray, volumes: Float64Array) -> IntArray:
        """Return the first of the triangles that share the edge or vertex a direction lies on."""
        settled = triangle.copy()
        on = volumes == 0
        (edge,) = np.nonzero(on.sum(axis=1) == 1)
        across = self._neighbors[triangle[edge], (on[edge].argmax(axis=1) + 1) % 3]
        settled[edge] = np.minimum(triangle[edge], across)
        (vertex,) = np.nonzero(on.sum(axis=1) == 2)
        corner = volumes[vertex].argmax(axis=1)
        settled[vertex] = self._first[self._triangles[triangle[vertex], corner]]
        return settled

    def _volumes(self, triangle: IntArray, directions: Float64Array) -> Float64Array:
        """Return det[b, c, d], det[c, a, d], det[a, b, d] (m, 3): the unnormalised coordinates of d in a, b, c."""
        corners = self._sphere[self._triangles[triangle]]
        starts, ends = corners[:, (1, 2, 0)], corners[:, (2, 0, 1)]
        repeated = np.broadcast_to(directions[:, None], corners.shape)
        return determinants(starts.reshape(-1, 3), ends.reshape(-1, 3), repeated.reshape(-1, 3)).reshape(-1, 3)


def determinants(start: Float64Array, end: Float64Array, direction: Float64Array) -> Float64Array:
    """Return det[start, end, direction] (m,) of unit vectors (m, 3), each with the right sign (zero included)."""
    edge = end - start
    to_start, to_end = start - direction, end - direction
    # det[a, b, d] = det[a − d, b − a, d] = det[b − d, b − a, d]: the shorter difference is the more exact.
    closer = np.einsum("ij,ij->i", to_start, to_start) <= np.einsum("ij,ij->i", to_end, to_end)
    near = np.where(closer[:, None], to_start, to_end)
    result = np.asarray(np.einsum("ij,ij->i", np.cross(near, edge), direction))
    size = np.einsum("ij,ij->i", near, near) * np.einsum("ij,ij->i", edge, edge)
    unsure = np.flatnonzero(np.abs(result) <= _UNCERTAIN * np.sqrt(size))
    result[unsure] = _exact_determinants(start[unsure], end[unsure], direction[unsure])
    return result


def _exact_determinants(a: Float64Array, b: Float64Array, c: Float64Array) -> Float64Array:
    """Return det[a, b, c] (m,) correctly rounded: all products without error, summed exactly."""
    first, second, third = (0, 1, 2, 0, 1, 2), (1, 2, 0, 2, 0, 1), (2, 0, 1, 1, 2, 0)
    sign = np.array([1.0, 1, 1, -1, -1, -1])
    high, low = _product(a[:, first] * sign, b[:, second])
    terms = np.concatenate((*_product(high, c[:, third]), *_product(low, c[:, third])), axis=1)
    # fsum is exact, and few determinants come here: those of directions on an edge to within rounding.
    return np.array([math.fsum(row) for row in terms.tolist()])


def _product(x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return xy rounded and the rounding error, whose sum is xy exactly (Dekker 1971)."""
    product = x * y
    x_high, x_low = _halves(x)
    y_high, y_low = _halves(y)
    return product, ((x_high * y_high - product) + x_high * y_low + x_low * y_high) + x_low * y_low


def _halves(x: Float64Array) -> tuple[Float64Array, Float64Array]:
    large = _SPLITTER * x
    high = large - (large - x)
    return high, x - high
