"""Symmetries of functions on the sphere, from their correlation with themselves."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.sphere.coefficients import truncate
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.rotation.correlation import correlator, exponential
from fsh3d_o3d.sphere.rotation.rotation import parity, rotate_coefficients
from fsh3d_o3d.sphere.rotation.rotation_search import local_maxima
from fsh3d_o3d.sphere.threads import single_threaded_blas

__all__ = ["SymmetryAxis", "SymmetryPlane", "SymmetryReport", "find_symmetries"]

_FINE_BANDWIDTH = 32  # degrees below it take part unless asked otherwise, as in the search for rotations
_MAXIMA = 60  # as many as the icosahedron has rotations
_NEAR_IDENTITY = np.radians(8.0)  # radians, a choice: a maximum of the correlation with itself this near is none
_SAME_AXIS = np.radians(4.0)  # radians, a choice: axes nearer than this are one
_PROBE_ANGLE = np.radians(2.0)  # radians, from an axis to those it is compared with: half of what makes two one
_NEIGHBOURS = 8  # that an axis or a plane is compared with, evenly around it; a choice
_PEAK_TOLERANCE = 0.02  # of what a score misses of 1, a choice: a neighbour better by less is so by sampling
_ROUNDING = 1e-9  # of scores that are all 1, as across an axis of revolution
_MOST_AXES = 160  # candidates, a choice: the cube has 13 axes, the icosahedron 31
_REVOLUTION_STEPS = 720  # rotations that stand for all about an axis, half a degree apart; a choice
_SPHERICAL = 0.005  # of the norm, a choice: where less depends on direction, the shape is a sphere


@value
class SymmetryAxis:
    """An axis of rotation."""

    direction: Float64Array
    """(3,) unit vector; its sign has no meaning. Read-only."""
    order: int
    """n: rotations by multiples of 360°/n change little. 0 for an axis of revolution."""
    score: float
    """The smallest correlation of the function with itself over these rotations, at most 1."""


@value
class SymmetryPlane:
    """A mirror plane through the centre."""

    normal: Float64Array
    """(3,) unit vector; its sign has no meaning. Read-only."""
    score: float
    """The correlation of the function with its mirror image, at most 1."""


@value
class SymmetryReport:
    """Rotations and reflections that change functions on the sphere little."""

    axes: tuple[SymmetryAxis, ...]
    """Axes whose score reaches the threshold: of revolution first, then by order and score. Where there is an axis of
    revolution, at most one of the two-fold axes across it."""
    planes: tuple[SymmetryPlane, ...]
    """Mirror planes whose score reaches the threshold, best first; one of those through an axis of
    revolution."""
    spherical: bool
    """Whether less than 0.5 % of the norm depends on direction: every axis is one of symmetry, and none is listed."""
    rotation_score: float
    """The highest correlation with itself at a local maximum away from no rotation; −1 where there is none. Near 1
    wherever a pose is ambiguous."""
    reflection_score: float
    """The highest correlation with its mirror image, over all rotations; near 1 unless the function is chiral."""
    point_score: float
    """The correlation with f(−ω); near 1 with a centre of symmetry."""
    threshold: float
    """What scores were held to."""

    @property
    def is_symmetric(self) -> bool:
        """Whether a rotation, other than none, changes little: the shape's pose is not unique."""
        return self.spherical or bool(self.axes) or self.rotation_score >= self.threshold

    @property
    def of_revolution(self) -> bool:
        """Whether there is an axis of revolution."""
        return self.spherical or any(axis.order == 0 for axis in self.axes)


def find_symmetries(coefficients: object, *, threshold: float = 0.98, bandwidth: int | None = None) -> SymmetryReport:
    """Find axes of rotation, axes of revolution and mirror planes through the centre.

    A score is the correlation Σ⟨f, R f⟩ / ‖f‖² over degrees >= 1 of functions with themselves, rotated or mirrored: 1
    for a symmetry, and less by half of the squared relative L2 difference. Candidates are the axes of the
    correlation's maxima over all rotations, with and without reflection, and what they make of each other.

    Args:
        coefficients: (…, b²) of functions that are rotated together, such as shells.
        threshold: Correlation from which on a rotation counts as a symmetry. 0.98 is a relative difference of 20 % in
            what depends on direction. Exact symmetries of sampled shapes have 0.999 and more.
        bandwidth: Only degrees < this; None: at most 32. Orders of b and more cannot be told from revolution.

    Raises:
        ValueError: Wrong shape, not finite, or zero everywhere.

    Example:
        >>> transform = fsh.SphericalHarmonicTransform(16)
        >>> cube = 1 / np.abs(transform.grid.directions).max(axis=1)  # the distance from its centre to its surface
        >>> report = fsh.find_symmetries(transform.forward(cube))
        >>> [axis.order for axis in report.axes], len(report.planes)
        ([4, 4, 4, 3, 3, 3, 3, 2, 2, 2, 2, 2, 2], 9)
        >>> report.is_symmetric, report.of_revolution
        (True, False)
    """
    values, b = check.coefficients(coefficients)
    limit = check.number(threshold, "threshold", minimum=0.0, maximum=1.0)
    b = min(b, _FINE_BANDWIDTH) if bandwidth is None else min(b, check.bandwidth(bandwidth))
    rows = np.asarray(truncate(values, b), dtype=np.float64).reshape(-1, b * b)
    scale = np.abs(rows).max(initial=0.0)
    if scale == 0:
        raise ValueError("coefficients are zero: there is no function to find symmetries of")
    rows = rows / scale
    total = float(np.linalg.norm(rows))
    rows[:, 0] = 0.0
    varying = float(np.linalg.norm(rows))
    if varying <= _SPHERICAL * total:
        return SymmetryReport((), (), True, 1.0, 1.0, 1.0, limit)
    rows = rows / varying
    with single_threaded_blas():
        turns, scores, _ = local_maxima(rows, rows, b, _MAXIMA)
        mirrored, mirror_scores, _ = local_maxima(rows * parity(b), rows, b, _MAXIMA)
        away = _angles(turns) > _NEAR_IDENTITY
        search = correlator(b, 1)
        tensor = search.ascend(search.products(rows[None], rows), np.eye(3)[None], 0)[2][0]
    # About an axis of revolution the correlation stays what it is at no rotation.
    curvature_axes = np.linalg.eigh(tensor)[1].T[::-1]
    main = next((axis for axis in curvature_axes if _axis_symmetry(rows, b, axis, limit)[0] == 0), None)
    if main is None:
        near = turns[away & (scores >= limit)], mirrored[mirror_scores >= limit]
        axes, planes = _closure(rows, b, np.concatenate((_axes(near[0]), _axes(near[1]), curvature_axes)), limit)
    else:
        axes, planes = _closure(rows, b, np.stack((main, _perpendicular(main))), limit)
    point = float(np.sum(parity(b) * rows**2))
    return SymmetryReport(
        tuple(sorted(axes, key=lambda axis: (axis.order != 0, -axis.order, -axis.score))),
        tuple(sorted(planes, key=lambda plane: -plane.score)),
        False,
        float(np.clip(scores[away].max(initial=-1.0), -1, 1)),
        float(np.clip(mirror_scores.max(initial=-1.0), -1, 1)),
        float(np.clip(point, -1, 1)),
        limit,
    )


def _closure(
    rows: Float64Array, b: int, seeds: Float64Array, limit: float
) -> tuple[list[SymmetryAxis], list[SymmetryPlane]]:
    """Axes and planes among candidates and among what the symmetries found make of each other."""
    seen, queue = np.empty((0, 3)), list(seeds)
    axes: list[SymmetryAxis] = []
    planes: list[SymmetryPlane] = []
    turns: list[Float64Array] = []
    tried = 0
    while queue and tried < _MOST_AXES:
        direction = queue.pop(0)
        if len(seen) and np.abs(seen @ direction).max() > np.cos(_SAME_AXIS):
            continue
        tried += 1
        order, score, mirror = _axis_symmetry(rows, b, direction, limit)
        if order > 1 and not _is_peak(rows, b, direction, score, order):
            order = 1
        if mirror >= limit and not _is_peak(rows, b, direction, mirror, None):
            mirror = -1.0
        if order == 1 and mirror < limit:
            continue
        seen = np.concatenate((seen, direction[None]))
        own = direction.copy()
        own.setflags(write=False)
        # A symmetry takes axes of symmetry to others. What a mirror does to axes, a half turn about its normal does.
        new = [np.pi] if mirror >= limit else []
        if order != 1:
            axes.append(SymmetryAxis(own, order, score))
            new += [2 * np.pi / order] if order > 1 else []
        if mirror >= limit:
            planes.append(SymmetryPlane(own, mirror))
        turns += [exponential(angle * own[None])[0] for angle in new]
        known = [axis.direction for axis in axes] + [plane.normal for plane in planes]
        queue += [turn @ own for turn in turns] + [
            turn @ axis for turn in turns[len(turns) - len(new) :] for axis in known
        ]
    return axes, planes


def _axis_symmetry(rows: Float64Array, b: int, direction: Float64Array, limit: float) -> tuple[int, float, float]:
    """The order of an axis (1 if there is no symmetry) with its score, and the score of the plane across."""
    by_order, mirror = _energy_by_order(rows, b, direction)
    every = _worst_correlation(by_order, _REVOLUTION_STEPS)
    if every >= limit:
        return 0, min(every, 1.0), min(mirror, 1.0)
    for n in range(b - 1, 1, -1):
        score = _worst_correlation(by_order, n)
        # Other rotations about a nearly round axis pass too; those of its order do much better than the worst.
        if score >= limit and 1 - score <= (1 - every) / 2:
            return n, min(score, 1.0), min(mirror, 1.0)
    return 1, -1.0, min(mirror, 1.0)


def _energy_by_order(rows: Float64Array, b: int, direction: Float64Array) -> tuple[Float64Array, float]:
    """The energy (b,) of each |order| once an axis is turned to z, and the score of the plane across it."""
    degree, order = degrees_and_orders(b)
    energy = np.sum(rotate_coefficients(rows, _to_z(direction), threads=1) ** 2, axis=0)
    mirror = float(np.sum(energy * (1 - 2 * ((degree + order) % 2))))
    return np.bincount(np.abs(order), energy, b).astype(np.float64), mirror


def _worst_correlation(by_order: Float64Array, n: int) -> float:
    """The smallest correlation over rotations about z by multiples of 360°/n."""
    # A rotation by an angle multiplies what order m correlates with itself by cos(m · angle).
    return float((np.cos(2 * np.pi / n * np.outer(np.arange(1, n), np.arange(len(by_order)))) @ by_order).min())


def _is_peak(rows: Float64Array, b: int, direction: Float64Array, score: float, order: int | None) -> bool:
    """Whether no axis of this order close by, or no plane if None, is better.

    Of a body that is nearly round about an axis every axis and plane is nearly one of symmetry; only the best ones are.
    """
    first = _perpendicular(direction)
    angles = np.linspace(0, 2 * np.pi, _NEIGHBOURS, endpoint=False)[:, None]
    tangents = np.cos(angles) * first + np.sin(angles) * np.cross(direction, first)
    around = np.cos(_PROBE_ANGLE) * direction + np.sin(_PROBE_ANGLE) * tangents
    found = [_energy_by_order(rows, b, other) for other in around]  # eight
    best = max(mirror if order is None else _worst_correlation(by_order, order) for by_order, mirror in found)
    return best <= score + _PEAK_TOLERANCE * (1 - score) + _ROUNDING


def _perpendicular(direction: Float64Array) -> Float64Array:
    """A unit vector (3,) at right angles to one."""
    other = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    return np.asarray(other / np.linalg.norm(other))


def _to_z(direction: Float64Array) -> Float64Array:
    """A rotation (3, 3) that takes a unit vector to +z."""
    x, y, z = direction
    axis = np.array([y, -x, 0.0])
    length = np.hypot(x, y)
    axis = axis / length if length > 0 else np.array([1.0, 0.0, 0.0])
    return np.asarray(exponential(np.arctan2(length, z) * axis[None])[0])


def _angles(rotations: Float64Array) -> Float64Array:
    """Angles (k,) of rotations (k, 3, 3), in radians."""
    antisymmetric = rotations - np.swapaxes(rotations, 1, 2)
    sine = np.linalg.norm(antisymmetric, axis=(1, 2)) / np.sqrt(2)
    return np.asarray(np.arctan2(sine, np.trace(rotations, axis1=1, axis2=2) - 1))


def _axes(rotations: Float64Array) -> Float64Array:
    """Axes (k, 3) of rotations (k, 3, 3), accurate for any angle but 0."""
    # R + Rᵀ has the axis as the eigenvector of its largest eigenvalue, 2.
    return np.asarray(np.linalg.eigh(rotations + np.swapaxes(rotations, 1, 2))[1][:, :, 2])
