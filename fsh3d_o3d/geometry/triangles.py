"""Arithmetic of triangles given by their corners (t, 3, 3): normals, areas, volumes, closest points, even samples."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array

# A triangle is degenerate when twice its area is below this fraction of its longest edge squared: rounding of float64
# coordinates near the unit frame's size then leaves no digit of its normal.
_DEGENERATE = 1e-15
# The first two powers of the inverse of the plastic number: the Kronecker sequence of lowest discrepancy known in two
# dimensions.
_PLASTIC = np.array([[0.7548776662466927], [0.5698402909980532]])


def triangle_normals(corners: Float64Array) -> Float64Array:
    """Return (b − a) × (c − a) (…, 3) of triangles (…, 3, 3): along the normals, and twice the areas long."""
    a, b, c = np.moveaxis(corners, -2, 0)
    return np.cross(b - a, c - a)


def triangle_areas(corners: Float64Array) -> Float64Array:
    """Return the areas (t,) of triangles (t, 3, 3)."""
    normals = triangle_normals(corners)
    return np.asarray(np.sqrt(_dot(normals, normals)) / 2)


def longest_edges(corners: Float64Array) -> Float64Array:
    """Return the squared length (t,) of each triangle's longest edge."""
    edges = (corners[:, k] - corners[:, k - 1] for k in range(3))
    return functools.reduce(np.maximum, (_dot(edge, edge) for edge in edges))


def degenerate(corners: Float64Array) -> NDArray[np.bool_]:
    """Return which triangles, given as corners (t, 3, 3) of order one, have no area that float64 can tell from zero."""
    return np.asarray(2 * triangle_areas(corners) <= _DEGENERATE * longest_edges(corners))


def solid_volume(corners: Float64Array) -> tuple[float, Float64Array | None]:
    """Return the sum of the signed tetrahedra between triangles and the origin, and the centroid (3,) of the solid.

    Without a centroid of its own, None, is what is flat to the rounding of the sum.
    """
    weight = _dot(corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = float(weight.sum())
    if abs(volume) <= 1e-14 * float(np.abs(weight).sum()):
        return volume, None
    return volume, weight @ corners.sum(axis=1) / (4 * volume)


def even_places(number: NDArray[Any], start: Float64Array | float = 0.0) -> Float64Array:
    """Return places (2, n) in a triangle, evenly spread: u, v of a + u (b − a) + v (c − a).

    Places of consecutive numbers (n,) are even, whatever the first. ``start``, one for both or (2, 1), moves them
    round the unit square, whose half beyond the triangle is folded back.
    """
    places = np.mod(start + _PLASTIC * number, 1.0)
    return np.asarray(np.where(places.sum(axis=0) > 1, 1 - places, places))


def points_at(corners: Float64Array, places: Float64Array) -> Float64Array:
    """Return the points (t, 3) of triangles (t, 3, 3) at places (2, t), as ``even_places`` gives them."""
    a, b, c = np.moveaxis(corners, 1, 0)
    u, v = places[:, :, None]
    return np.asarray(a + u * (b - a) + v * (c - a))


def point_triangle_offsets(points: Float64Array, corners: Float64Array) -> Float64Array:
    """Return the way (n, 3) from each point (n, 3) to the closest point of its triangle (n, 3, 3), flat ones included.

    Everything is seen from the point, so that no digits are lost to its position.
    """
    seen = corners - points[:, None]
    best = _to_edge(seen[:, 0], seen[:, 1])
    least = _dot(best, best)
    for k in (1, 2):
        way = _to_edge(seen[:, k], seen[:, k - 2])
        square = _dot(way, way)
        best = np.where((square < least)[:, None], way, best)
        least = np.minimum(square, least)
    normal = triangle_normals(seen)
    length = _dot(normal, normal)
    above = length > 0
    for k in range(3):
        above &= _dot(np.cross(seen[:, k], seen[:, k - 2]), normal) >= 0
    height = _dot(seen[:, 0], normal) / np.where(above, length, 1.0)
    # Of a needle the plane is made of rounding, and an edge may be closer than where it seems to be.
    above &= np.square(height) * length < least
    return np.where(above[:, None], height[:, None] * normal, best)


def corner_shares(points: Float64Array, corners: Float64Array) -> Float64Array:
    """Return the shares (n, 3) of the corners in points (n, 3) on triangles (n, 3, 3): not negative, of sum 1.

    Outside of a triangle, by rounding, none is below 0. A triangle without area gives all to the corner next to it.
    """
    seen = corners - points[:, None]
    normal = triangle_normals(corners)
    shares = np.stack([_dot(np.cross(seen[:, k - 2], seen[:, k - 1]), normal) for k in range(3)], axis=1)
    shares = np.maximum(shares, 0)
    total = shares.sum(axis=1, keepdims=True)
    nearest = np.linalg.norm(seen, axis=2).argmin(axis=1)
    return np.where(total > 0, shares / np.where(total > 0, total, 1.0), np.eye(3)[nearest])


def point_triangle_distance(points: Float64Array, corners: Float64Array) -> Float64Array:
    """Return the distance (n,) from each point (n, 3) to its triangle (n, 3, 3), flat triangles included."""
    return np.asarray(np.linalg.norm(point_triangle_offsets(points, corners), axis=1))


def _to_edge(start: Float64Array, end: Float64Array) -> Float64Array:
    """Return the point (n, 3) of each edge closest to the origin."""
    along = end - start
    length = _dot(along, along)
    place = np.clip(-_dot(start, along) / np.where(length > 0, length, 1.0), 0, 1)
    return np.asarray(start + place[:, None] * along)


def _dot(u: Float64Array, v: Float64Array) -> Float64Array:
    return np.asarray(np.einsum("ij,ij->i", u, v))
