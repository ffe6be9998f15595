"""Surfaces given by three band-limited functions, position over the sphere: values, normals, volume."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from scipy.sparse import csr_array

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import MeshArrays, corner_shares, fibonacci_triangulation, sphere_mesh
from fsh3d_o3d.sphere import SphericalGrid, SphericalHarmonicTransform, evaluate, evaluate_gradient, fibonacci_grid

Triangulation = Literal["icosphere", "fibonacci"]

_FEWEST_POINTS = 10_242  # vertices: an icosahedron subdivided five times, smooth to look at
_FEWEST_POINTS_OF_A_LEVEL = 162  # subdivided twice: the least that is still round
_USUAL_POINTS = 400_000  # vertices, a quarter of a GB to make: more only where 6b² are needed; a choice
_CONSTANT = math.sqrt(4 * math.pi)  # the coefficient of the function 1


def usual_resolution(bandwidth: int) -> int:
    """Vertices of a mesh that shows all of a surface of this bandwidth smoothly: 24b², within reason."""
    return max(6 * bandwidth**2, min(24 * bandwidth**2, _USUAL_POINTS), _FEWEST_POINTS)


def level_resolution(bandwidth: int) -> int:
    """Vertices of a mesh as one level of detail: 24b² also where that is few."""
    return max(6 * bandwidth**2, min(24 * bandwidth**2, _USUAL_POINTS), _FEWEST_POINTS_OF_A_LEVEL)


def decoding_sphere(points: int, triangulation: str) -> tuple[Float64Array, IntArray]:
    """Return directions (v, 3) and triangles: an icosphere of at least so many points, or a Fibonacci grid of these."""
    check.choice(triangulation, "triangulation", ("icosphere", "fibonacci"))
    count = check.integer(points, "resolution", minimum=12, maximum=10**8)
    check.memory(600.0 * count, f"a mesh of {count} vertices")
    if triangulation == "fibonacci":
        return fibonacci_triangulation(fibonacci_grid(count).directions)
    return sphere_mesh(count)


def mean_position(coefficients: Float64Array) -> Float64Array:
    """Return the mean over the sphere (k,) of functions (k, b²)."""
    return np.asarray(coefficients[..., 0] / _CONSTANT)


def moved(coefficients: Float64Array, offset: Float64Array) -> Float64Array:
    """Return the coefficients (k, b²) of the functions plus constants (k,)."""
    result = coefficients.copy()
    result[..., 0] += offset * _CONSTANT
    return result


def scaled(coefficients: Float64Array, factor: float) -> Float64Array:
    """Return the coefficients (k, b²) of the functions scaled about their mean."""
    result = coefficients * factor
    result[..., 0] = coefficients[..., 0]
    return result


def values_at(coefficients: Float64Array, directions: object, threads: int | None = None) -> Float64Array:
    """Return functions (b²,) or (k, b²) at directions (m, 3): (m,) or (m, k).

    The mean is added last, so that a surface far from the origin keeps its digits.
    """
    mean = mean_position(coefficients)
    return np.asarray(evaluate(moved(coefficients, -mean), directions, threads=threads).T + mean, dtype=np.float64)


def area_normals(coefficients: Float64Array, grid: SphericalGrid) -> Float64Array:
    """Return x_θ × x_φ / sin θ (m, 3) of positions (3, b²), outward where the map keeps the orientation.

    Its length is the ratio of areas, surface to sphere. With the gradients of x, y, z on the sphere and the direction
    ω it is (ω·∇y×∇z, ω·∇z×∇x, ω·∇x×∇y).
    """
    x, y, z = (evaluate_gradient(row, grid) for row in coefficients)
    pairs = ((y, z), (z, x), (x, y))
    return np.stack([np.einsum("ij,ij->i", grid.directions, np.cross(a, b)) for a, b in pairs], axis=1)


def unit_normals(coefficients: Float64Array, grid: SphericalGrid) -> Float64Array:
    """Return ``area_normals`` at length one, in any units."""
    scale = float(np.abs(coefficients[:, 1:]).max(initial=0.0)) or 1.0
    return unit_rows(area_normals(coefficients / scale, grid))


def interpolation(mesh: MeshArrays, points: Float64Array, triangle: IntArray) -> csr_array:
    """Return the matrix (m, v) that interpolates vertex values linearly at points (m, 3) on their triangles (m,)."""
    corners = mesh.triangles[triangle]
    weights = corner_shares(points, mesh.vertices[corners])
    start = np.arange(0, corners.size + 1, 3)
    return csr_array((weights.ravel(), corners.ravel(), start), shape=(len(points), len(mesh.vertices)))


def unit_rows(vectors: Float64Array) -> Float64Array:
    """Return vectors (m, 3) at length one; +z where there is no direction, at a point where a surface degenerates."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors, (0.0, 0.0, 1.0)) / np.where(length > 0, length, 1.0)


def volume_side(coefficients: Float64Array) -> float:
    """Return ∛V of the signed volume V = ⅓ ∫ x · x_θ × x_φ dθ dφ, exact for positions (3, b²) of any b and size."""
    b = math.isqrt(coefficients.shape[-1])
    scale = float(np.abs(coefficients[:, 1:]).max(initial=0.0))
    if scale == 0:
        return 0.0
    shape = moved(coefficients, -mean_position(coefficients)) / scale
    # Three factors of degree < b make degree 3(b − 1); a grid of bandwidth 1.5 b integrates it.
    transform = SphericalHarmonicTransform(-(-3 * b // 2))
    positions = evaluate(shape, transform.grid).T
    density = np.einsum("ij,ij->i", positions, area_normals(shape, transform.grid))
    return float(np.cbrt(transform.weights @ density / 3)) * scale
