"""Relaxation of a sphere map vertex by vertex: cheap steps that even out triangles and cannot turn one over.

With the other vertices held, the area of each triangle at a vertex is linear in the vertex, and its Dirichlet energy
is quadratic. So both parts of the energy

    Σ m · (Dirichlet energy / area)  −  area_weight · Σ m · log(area),      m = share of the surface,

are convex in one vertex at a time. The first is least for a conformal map, the MIPS of Hormann and Greiner (2000). The
second is least where every triangle has its share; near there it grows as half of Σ m log²(area / m), and without bound
as a triangle vanishes. Newton's method then needs a 2 × 2 system for each vertex, does not mind how small or thin a
star is, and all vertices move at once. On one mesh that smooths short waves only; on the levels of a hierarchy, coarse
to fine, it reaches all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere_map.validity import cross, edge_vectors, orientations, tangents

AREA_WEIGHT = 5.0
"""The weight of areas beside angles that reconstructs well, without unit."""

_STEPS = 4  # for each call, a choice: on the levels of a hierarchy most has been done on the coarser ones
_DAMPING = 0.6  # of Newton's step, a choice, since the neighbours move as well
_LONGEST_MOVE = 0.5  # radians, a choice: the tangent plane is not the sphere
_THICKENED = 1e-2  # of the mean squared edge, added to each: triangles count as at most ten times as long as wide
_AREA_FLOOR = 0.1  # of the mean area, added to each, a choice: triangles without area still keep a little of the sphere
_STRETCHED = 6.0  # Dirichlet energy over area, a choice: beyond, its logarithm counts, and areas win over angles
_KEPT_AREA = 0.3  # of a triangle in one step, at least, a choice: far from flat, where the model of a step breaks down
_HALVINGS = 5  # of steps that would shrink it more, a choice; after that its corners stay
_SINGULAR = 1e-14  # smallest determinant of a 2 × 2 system, over the product of its diagonal: some fifty roundings


@dataclass(frozen=True, eq=False)
class _TriangleMetrics:
    """What the energy needs to know of the surface's triangles."""

    triangles: IntArray
    """(t, 3)"""
    mass: Float64Array
    """(t,) shares of the surface."""
    shape: Float64Array
    """(3, t) weights of the image's squared edges opposite each corner, which sum up to mass × Dirichlet energy."""

    @classmethod
    def of(cls, vertices: Float64Array, triangles: IntArray) -> _TriangleMetrics:
        """Measure a level's triangles; those that are thin count as thicker than they are."""
        _, u, v = edge_vectors(vertices, triangles)
        normal = cross(u, v)
        area = np.sqrt((normal * normal).sum(axis=0)) / 2
        squares = np.stack([(edge * edge).sum(axis=0) for edge in (v - u, v, u)])
        size = float(squares.mean())
        if size == 0:  # all vertices in one place: as good as any other shape
            area, squares, size = np.ones_like(area), np.ones_like(squares), 1.0
        mass = area / area.mean() if area.any() else np.ones_like(area)
        mass = (mass + _AREA_FLOOR) / len(mass) / (1 + _AREA_FLOOR)
        # Adding to all squared edges alike adds an equilateral triangle's metric, so the sum is a triangle again.
        squares = squares / size
        squares += _THICKENED * squares.mean(axis=0) + 1e-9
        a, b, c = squares
        thick = np.sqrt(2 * (a * b + b * c + c * a) - a * a - b * b - c * c) / 4
        return cls(triangles, mass, np.stack((b + c - a, c + a - b, a + b - c)) / 16 * (mass / thick))


def relax(
    vertices: Float64Array,
    triangles: IntArray,
    sphere: Float64Array,
    *,
    area_weight: float = AREA_WEIGHT,
    steps: int = _STEPS,
) -> Float64Array:
    """Improve a valid map by a few steps.

    Args:
        vertices: (n, 3) positions on the surface.
        triangles: (t, 3) corners of the closed genus-0 mesh, outward.
        sphere: (n, 3) unit vectors, every triangle positively oriented.
        area_weight: Of keeping areas beside keeping angles, positive: it is also what keeps triangles from vanishing.
        steps: Each costs a few passes over the triangles.

    Returns:
        (n, 3) unit vectors, every triangle positively oriented.
    """
    surface = _TriangleMetrics.of(vertices, triangles)
    determinants = orientations(sphere, triangles)
    for _ in range(steps):
        move = _newton_move(surface, sphere, determinants, area_weight)
        sphere, determinants = _guarded(sphere, move, triangles, determinants)
    return sphere


def _newton_move(
    surface: _TriangleMetrics, sphere: Float64Array, determinants: Float64Array, area_weight: float
) -> Float64Array:
    """Return each vertex' damped Newton step (n, 3) in its tangent plane."""
    count, triangles = len(sphere), surface.triangles
    columns = np.ascontiguousarray(sphere.T)
    first, second = tangents(columns)
    corner = [columns[:, triangles[:, k]] for k in range(3)]
    opposite = [corner[2] - corner[1], corner[0] - corner[2], corner[1] - corner[0]]
    area = determinants / 2
    ratio = sum(surface.shape[k] * (opposite[k] * opposite[k]).sum(axis=0) for k in range(3)) / area
    # Beyond the threshold weights that fall with the ratio turn it into its logarithm (iteratively reweighted).
    weight = 1 / np.maximum(1, ratio / (_STRETCHED * surface.mass))
    ratio = ratio * weight
    shape = surface.shape * (2 * weight / area)
    barrier = area_weight * surface.mass
    system = np.zeros((5, count))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        rise = cross(corner[i], opposite[k]) / determinants  # gradient of log area
        pull = shape[i] * opposite[i] - shape[j] * opposite[j]  # gradient of the Dirichlet energy / area
        x, y = (tangent[:, triangles[:, k]] for tangent in (first, second))
        rx, ry, px, py = (rise * x).sum(axis=0), (rise * y).sum(axis=0), (pull * x).sum(axis=0), (pull * y).sum(axis=0)
        once, twice, stiff = ratio + barrier, 2 * ratio + barrier, shape[i] + shape[j]
        terms = (
            px - once * rx,
            py - once * ry,
            stiff - 2 * px * rx + twice * rx * rx,
            stiff - 2 * py * ry + twice * ry * ry,
            twice * rx * ry - px * ry - py * rx,
        )
        for row, term in zip(system, terms, strict=True):
            row += np.bincount(triangles[:, k], weights=term, minlength=count)
    gx, gy, hxx, hyy, hxy = system
    determinant = np.maximum(hxx * hyy - hxy * hxy, _SINGULAR * hxx * hyy)
    sx, sy = (hxy * gy - hyy * gx) / determinant, (hxy * gx - hxx * gy) / determinant
    length = _DAMPING / np.maximum(1, np.hypot(sx, sy) * (_DAMPING / _LONGEST_MOVE))
    return np.asarray((first * (sx * length) + second * (sy * length)).T)


def _guarded(
    sphere: Float64Array, move: Float64Array, triangles: IntArray, before: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Move the vertices as far as no triangle loses too much area; return them and the triangles' determinants.

    Steps only ever shrink, and in the end to nothing where need be, so the loop ends: at worst nothing moves.
    """
    step = np.ones((len(sphere), 1))
    attempt = 0
    while True:
        moved = sphere + step * move
        moved /= np.sqrt((moved * moved).sum(axis=1, keepdims=True))
        # What stays is left as it is, to the last bit; else its triangles might fail on rounding alone.
        moved = np.where(step > 0, moved, sphere)
        after = orientations(moved, triangles)
        harmed = triangles[~(after >= _KEPT_AREA * before)]
        if harmed.size == 0 or not step[harmed].any():
            return moved, after
        step[harmed] *= 0.5 if attempt < _HALVINGS else 0.0
        attempt += 1
