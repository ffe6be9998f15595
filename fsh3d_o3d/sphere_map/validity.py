"""Whether a sphere map is one to one, and how far it is from conformal and from area-preserving.

A map takes the vertices of a closed surface to the unit sphere and its triangles to spherical ones. It is one to one,
*valid*, where no triangle is flipped or flat and the triangles cover the sphere once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray

# Twice a triangle's area over an edge squared, below which the shape is made of rounding: such a triangle's ratio is as
# large as its weight is small, and their product noise.
_FLAT = 1e-10


def edge_vectors(points: Float64Array, triangles: IntArray) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the first corners and the edges to the second and third, (3, t) each."""
    # Coordinates first: NumPy reduces over three long rows several times faster than over rows of three.
    a, b, c = (points.T[:, triangles[:, k]] for k in range(3))
    return a, b - a, c - a


def cross(u: Float64Array, v: Float64Array) -> Float64Array:
    """Return the cross product of the columns of (3, t) arrays."""
    return np.stack((u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]))


def tangents(columns: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return two orthonormal tangents (3, n) at unit vectors (3, n)."""
    axis = np.zeros_like(columns)
    axis[np.abs(columns).argmin(axis=0), np.arange(columns.shape[1])] = 1.0
    first = cross(columns, axis)
    first /= np.sqrt((first * first).sum(axis=0))
    return first, cross(columns, first)


def orientations(sphere: Float64Array, triangles: IntArray) -> Float64Array:
    """Return det[a, b − a, c − a] (t,) of each spherical triangle: positive where it is not flipped.

    Differences first: they are exact for neighbours, so that the sign holds for triangles far below 1e-16 of the
    sphere. The sign does not depend on the lengths of the positions.
    """
    a, u, v = edge_vectors(sphere, triangles)
    return np.asarray((a * cross(u, v)).sum(axis=0))


def solid_angles(sphere: Float64Array, triangles: IntArray) -> Float64Array:
    """Return the signed solid angle (t,) of each spherical triangle, in (−2π, 2π].

    tan(Ω/2) = det / (1 + ab + bc + ca): Van Oosterom and Strackee, 1983.
    """
    a, u, v = edge_vectors(sphere, triangles)
    b, c = a + u, a + v
    determinant = (a * cross(u, v)).sum(axis=0)
    return np.asarray(2 * np.arctan2(determinant, 1 + (a * b + b * c + c * a).sum(axis=0)))


def degree(sphere: Float64Array, triangles: IntArray) -> int:
    """Return how many times the triangles cover the sphere, flipped ones counting backwards."""
    return round(float(solid_angles(sphere, triangles).sum()) / (4 * math.pi))


def is_valid(sphere: Float64Array, triangles: IntArray) -> bool:
    """Return whether every triangle is positively oriented and together they cover the sphere once."""
    # Written so that NaN fails.
    return bool((orientations(sphere, triangles) > 0).all()) and degree(sphere, triangles) == 1


@dataclass(frozen=True)
class Distortion:
    """How far a map is from conformal and from area-preserving; means are over the area of the surface."""

    mean: float
    """Mean of the quasi-conformal ratio σ₁/σ₂ ≥ 1 of the linear map of each triangle."""
    percentile_99: float
    """The ratio that 99 % of the area does not exceed."""
    area: float
    """Root mean square of the natural logarithm of the area ratio: share of the sphere / share of the surface."""


def distortion(vertices: Float64Array, triangles: IntArray, sphere: Float64Array) -> Distortion:
    """Measure a map from triangles of the surface to the flat triangles between their images.

    Triangles without area, as far as float64 can tell, weigh nothing; an image without area has an infinite ratio.
    """
    double_area, double_image, trace = _stretches(vertices, triangles, sphere)
    _, u, v = edge_vectors(vertices, triangles)
    counted = double_area > _FLAT * np.maximum(_dot(u, u), _dot(v, v))
    double_area, double_image, trace = double_area[counted], double_image[counted], trace[counted]
    with np.errstate(divide="ignore", over="ignore"):
        half = np.maximum(trace / (2 * double_area * double_image), 1.0)  # (σ₁/σ₂ + σ₂/σ₁) / 2
        ratio = half + np.sqrt(half - 1) * np.sqrt(half + 1)
        stretch = np.log(double_image / double_image.sum()) - np.log(double_area / double_area.sum())
    weight = double_area / double_area.sum()
    order = np.argsort(ratio, kind="stable")
    place = int(np.searchsorted(np.cumsum(weight[order]), 0.99))
    return Distortion(
        mean=float((weight * ratio).sum()),
        percentile_99=float(ratio[order[min(place, len(order) - 1)]]),
        area=math.sqrt(float((weight * stretch * stretch).sum())),
    )


def conformality_deficit(vertices: Float64Array, triangles: IntArray, sphere: Float64Array) -> float:
    """Return the mean of 1 − 2 σ₁σ₂ / (σ₁² + σ₂²) over the area of the surface, σ₁σ₂ < 0 where a triangle is flipped.

    From 0, conformal everywhere, to 2, conformal but inside out. Bounded for every triangle, unlike the ratio, so that
    it still tells two maps apart of which both have some degenerate triangles.
    """
    double_area, double_image, trace = _stretches(vertices, triangles, sphere)
    signed = np.sign(orientations(sphere, triangles)) * double_image
    cosine = np.divide(2 * double_area * signed, trace, out=np.zeros_like(trace), where=trace > 0)
    return 1 - float((double_area * cosine).sum() / double_area.sum())


def _stretches(
    vertices: Float64Array, triangles: IntArray, sphere: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return twice the areas A of the triangles and A' of their images (t,), and 4 A² (σ₁² + σ₂²)."""
    _, u, v = edge_vectors(vertices, triangles)
    _, p, q = edge_vectors(sphere, triangles)
    normal, image = cross(u, v), cross(p, q)
    # Gram matrices G of the triangle, H of its image: σ₁² + σ₂² = trace(G⁻¹ H), det G = |u × v|².
    trace = _dot(v, v) * _dot(p, p) - 2 * _dot(u, v) * _dot(p, q) + _dot(u, u) * _dot(q, q)
    return np.sqrt(_dot(normal, normal)), np.sqrt(_dot(image, image)), trace


def _dot(u: Float64Array, v: Float64Array) -> Float64Array:
    return np.asarray((u * v).sum(axis=0))
