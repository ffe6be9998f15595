"""Area balancing: from a valid map of a surface to the sphere to one that gives every part its share.

A conformal map leaves a limb with a speck of the sphere, and band-limited functions then cannot tell its shape.
``balance`` minimises the energy of ``balance_energy`` by Newton's method with the Hessian of every triangle made
positive semidefinite, so that each direction descends; a step goes at most most of the way to the first flip, which is
the smallest root of the triangles' determinants, cubic polynomials in the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere_map.balance_energy import BalanceEnergy, balance_energy
from fsh3d_o3d.sphere_map.balance_system import BlockSystem
from fsh3d_o3d.sphere_map.mobius import normalized
from fsh3d_o3d.sphere_map.validity import cross, orientations, tangents

AREA_WEIGHT = 2.0
"""The α that reconstructs best, without unit."""

_TINY, _SMALL = 400, 3000  # vertices of a level, where a factorised step takes 5 and 40 ms; see balance_level
_SHORT_OF_FLIP = 0.85  # of the way to the first flip, a choice: at the flip itself the energy is infinite
_SUFFICIENT = 1e-4  # of the decrease that the slope promises (Armijo's usual constant)
_HALVINGS = 40  # of a step, which is then far below rounding of what it began as


@dataclass(frozen=True, eq=False)
class Balanced:
    """A map and how it was reached."""

    sphere: Float64Array
    """(n, 3) unit vectors; valid as the map it started from."""
    energy: float
    """At the end: a mean over the surface's area, 1 for a map that preserves angles and areas."""
    start_energy: float
    """At the start."""
    iterations: int
    """Newton steps taken."""
    converged: bool
    """The next step promised less than ``tolerance`` of the energy."""


def balance(
    vertices: Float64Array,
    triangles: IntArray,
    sphere: Float64Array,
    *,
    area_weight: float = AREA_WEIGHT,
    density: Float64Array | None = None,
    max_iterations: int = 50,
    tolerance: float = 1e-3,
    conjugate_steps: int | None = None,
) -> Balanced:
    """Move the vertices of a map over the sphere until angles and areas are kept as well as both can be.

    Args:
        vertices: (n, 3) positions on the surface; slivers and triangles without area are allowed.
        triangles: (t, 3) corners, closed, manifold, one component, genus 0, oriented outwards, no vertex unused.
        sphere: (n, 3) unit vectors, a valid map.
        area_weight: α of the energy; 0 asks for a conformal map.
        density: (t,) positive; share of the sphere wanted for a triangle per share of the surface. Default: even.
        max_iterations: Newton steps at most.
        tolerance: Stop when half the Newton decrement, the decrease the next step promises, is below this part of the
            energy.
        conjugate_steps: Default: each Newton step is solved by a sparse factorisation with 2n unknowns. With a number,
            by at most so many conjugate gradient steps: ten times faster on large meshes, but areas do not travel far;
            for a map that only has local faults, such as one from a coarser level.

    Returns:
        The balanced map, of at most the energy of the given one; it never has a flipped triangle.

    Raises:
        ValueError: A triangle of ``sphere`` is flipped or flat.
    """
    if not (orientations(sphere, triangles) > 0).all():
        raise ValueError("sphere must be a valid map to start from: every spherical triangle positively oriented")
    measure = balance_energy(vertices, triangles, area_weight=area_weight, density=density)
    system = BlockSystem(measure.triangles, len(vertices), conjugate_steps=conjugate_steps)
    points = np.array(sphere, dtype=np.float64)
    energy = start_energy = measure.value(points.T)
    iterations, converged = 0, False
    while iterations < max_iterations and not converged:
        step, slope = _newton_step(measure, system, points)
        converged = -slope / 2 <= tolerance * energy
        if converged:
            break
        moved = _line_search(measure, points, step, energy, slope, triangles)
        if moved is None:
            break
        points, energy = moved
        iterations += 1
    return Balanced(points, energy, start_energy, iterations, converged)


def balance_level(
    vertices: Float64Array, triangles: IntArray, sphere: Float64Array, *, area_weight: float = AREA_WEIGHT
) -> Float64Array:
    """Balance one level of a coarse-to-fine embedding, whose coarser levels have been balanced; made for ``embed``.

    Coarse levels are brought close to their minimum, while that costs nothing; the larger a level is, the more of the
    work has been done before.

    Args:
        vertices: (n, 3) positions of the level on the surface.
        triangles: (t, 3) its corners.
        sphere: (n, 3) unit vectors, a valid map.
        area_weight: α of the energy.

    Returns:
        (n, 3) the better map.
    """
    size = len(vertices)
    steps = 12 if size < _TINY else 3 if size < _SMALL else 2
    conjugate_steps = None if size < _SMALL else 20
    return balance(
        vertices,
        triangles,
        sphere,
        area_weight=area_weight,
        max_iterations=steps,
        conjugate_steps=conjugate_steps,
    ).sphere


def _newton_step(measure: BalanceEnergy, system: BlockSystem, points: Float64Array) -> tuple[Float64Array, float]:
    """Return a descending tangent step (n, 3) and the slope of the energy along it, 0 if there is none."""
    columns = np.ascontiguousarray(points.T)
    axes = np.stack(tangents(columns))
    gradient = np.einsum("dxn,xn->nd", axes, measure.gradient(columns))
    solution = system.directions(measure.factors(columns, axes), gradient)
    if solution is None:
        return np.zeros_like(points), 0.0
    return np.einsum("dxn,nd->nx", axes, solution), float((gradient * solution).sum())


def _line_search(
    measure: BalanceEnergy,
    points: Float64Array,
    step: Float64Array,
    energy: float,
    slope: float,
    triangles: IntArray,
) -> tuple[Float64Array, float] | None:
    """Return the first of ever shorter steps that lowers the energy enough, and its energy; None where none does."""
    length = min(1.0, _SHORT_OF_FLIP * first_flip(points, step, triangles))
    for _ in range(_HALVINGS):
        moved = normalized(points + length * step)
        # The energy sees corners in its own order; near rounding only the caller's counts as the sign.
        if bool((orientations(moved, triangles) > 0).all()):
            reached = measure.value(moved.T)
            if reached <= energy + _SUFFICIENT * length * slope:
                return moved, reached
        length /= 2
    return None


def first_flip(points: Float64Array, step: Float64Array, triangles: IntArray) -> float:
    """Return the smallest λ in (0, 1] for which a triangle of ``points + λ step`` is flat; infinite if none is.

    det[a, b, c] is a cubic in λ, positive at 0. Where its Bernstein coefficients on [0, 1] are all positive it has no
    root there; elsewhere the roots are the inverse eigenvalues of a companion matrix.
    """
    a, b, c = (np.ascontiguousarray(points.T)[:, triangles[:, k]] for k in range(3))
    p, q, r = (np.ascontiguousarray(step.T)[:, triangles[:, k]] for k in range(3))
    b, c, q, r = b - a, c - a, q - p, r - p
    constant, mixed, square = cross(b, c), cross(b, r) + cross(q, c), cross(q, r)
    c0 = (a * constant).sum(axis=0)
    c1 = (p * constant + a * mixed).sum(axis=0)
    c2 = (p * mixed + a * square).sum(axis=0)
    c3 = (p * square).sum(axis=0)
    bernstein = np.minimum(np.minimum(c0 + c1 / 3, c0 + 2 * c1 / 3 + c2 / 3), c0 + c1 + c2 + c3)
    candidates = np.flatnonzero(bernstein <= 0)
    if candidates.size == 0:
        return np.inf
    companion = np.zeros((candidates.size, 3, 3))
    companion[:, 0] = -np.stack((c1, c2, c3), axis=1)[candidates] / c0[candidates, None]
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    inverse = np.linalg.eigvals(companion)
    # A double root may come out as a conjugate pair; taking it for real shortens the step, which is the safe side.
    real = np.abs(inverse.imag) <= 1e-6 * np.abs(inverse)
    largest = float(np.where(real, inverse.real, 0.0).max())
    return 1 / largest if largest >= 1 else np.inf
