"""The conformal map by stereographic harmonic start and conformalised mean-curvature flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere_map.laplacian import PinnedLaplacian, edge_lengths, lumped_mass
from fsh3d_o3d.sphere_map.mobius import aligned, centered, normalized
from fsh3d_o3d.sphere_map.validity import conformality_deficit, orientations

# Two triangles differ in shape if their ratios of longest to shortest edge do by more than this, a choice: so that
# rounding of a rotated copy of a symmetric surface does not choose another triangle.
_SAME_SHAPE = 1e-6
_IDLE_STEPS = 3  # steps in a row without progress that end the flow: the first one or two may lead away


@dataclass(frozen=True, eq=False)
class Flowed:
    """Where a flow ended."""

    sphere: Float64Array
    """(n, 3) unit vectors; the map need not be valid."""
    iterations: int
    """Steps made."""


def pole_triangle(vertices: Float64Array, triangles: IntArray) -> IntArray:
    """Return the corners (3,) of the triangle whose edges differ least, which no rotation or scaling changes."""
    lengths = edge_lengths(vertices, triangles)
    shape = np.round(lengths.max(axis=1) / np.maximum(lengths.min(axis=1), 1e-300) / _SAME_SHAPE)
    return np.asarray(triangles[shape.argmin()])  # the first of those that cannot be told apart


def harmonic_start(
    vertices: Float64Array, triangles: IntArray, pole: IntArray, laplacian: PinnedLaplacian
) -> Float64Array:
    """Return a sphere map (n, 3): harmonic to the plane but for a pole in one triangle, then stereographic.

    Haker, Angenent, Tannenbaum, Kikinis, Sapiro and Halle, Conformal Surface Parameterization for Texture Mapping,
    2000.
    """
    a, b, c = pole
    along, beyond = vertices[b] - vertices[a], vertices[c] - vertices[a]
    length = np.sqrt(along @ along)
    theta = (beyond @ along) / length**2
    height = np.sqrt(max(beyond @ beyond - (theta * length) ** 2, 0.0))
    right = np.zeros((len(vertices), 2))
    right[a] = -1 / length, (1 - theta) / height
    right[b] = 1 / length, theta / height
    right[c] = 0, -1 / height
    plane = laplacian.solve(right)
    mass = lumped_mass(vertices, triangles)
    plane -= [_weighted_median(plane[:, k], mass) for k in range(2)]
    square = (plane * plane).sum(axis=1)
    scale = _weighted_median(square, mass)  # half of the surface goes to either hemisphere
    square = square / scale
    x, y = (plane / np.sqrt(scale)).T
    sphere = np.column_stack((2 * x, 2 * y, square - 1)) / (square + 1)[:, None]
    if orientations(sphere, triangles).sum() < 0:
        sphere[:, 1] *= -1
    return centered(normalized(sphere), mass)


def mean_curvature_flow(
    vertices: Float64Array,
    triangles: IntArray,
    sphere: Float64Array,
    laplacian: PinnedLaplacian,
    *,
    steps: int,
    tolerance: float,
) -> Flowed:
    """Flow a sphere map towards the conformal one: (M_k + L) x_{k+1} = M_k x_k, recentred, with area 4π.

    Kazhdan, Solomon and Ben-Chen, Can Mean-Curvature Flow be Modified to be Non-singular?, 2012, with time step 1. L
    stays that of the surface, M is the lumped mass of where the flow is. On coarse meshes the flow passes the best map
    and collapses, so the most conformal of all steps is returned. The first steps may lead away from the conformal map,
    so the flow ends when several steps in a row take less than ``tolerance`` of the ``conformality_deficit``.
    """
    points, best = sphere, sphere
    least = previous = conformality_deficit(vertices, triangles, sphere)
    iterations = idle = 0
    mass = lumped_mass(points, triangles)
    while iterations < steps and idle < _IDLE_STEPS:
        iterations += 1
        points = laplacian.solve_with_mass(mass, mass[:, None] * points, points)
        mass = lumped_mass(points, triangles)
        points -= np.einsum("n,ni->i", mass, points) / mass.sum()
        scale = 4 * np.pi / mass.sum()
        points *= np.sqrt(scale)
        mass *= scale
        candidate = normalized(points)
        deficit = conformality_deficit(vertices, triangles, candidate)
        idle = 0 if deficit < (1 - tolerance) * previous else idle + 1
        previous = deficit
        if deficit < least:
            best, least = candidate, deficit
    return Flowed(best, iterations)


def placed(sphere: Float64Array, vertices: Float64Array, triangles: IntArray) -> Float64Array:
    """Return the map centred by a Möbius transformation and turned to the pose of the surface, both area-weighted."""
    mass = lumped_mass(vertices, triangles)
    return aligned(centered(sphere, mass), vertices, mass)


def _weighted_median(values: Float64Array, weights: Float64Array) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])
