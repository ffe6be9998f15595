"""From two surfaces in their own frames to the pose that aligns them, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry import Surface
from fsh3d_o3d.registration.fit import Pairs, Poses, Side, refine, weakest_axis
from fsh3d_o3d.registration.surface import is_round, shell_coefficients
from fsh3d_o3d.sphere import estimate_rotation, exponential

_PROBES = 1024  # samples of each side that may search
_FIRST_FIT = (128, 3)  # probes and steps for every candidate
_COMPARED = 256  # probes of each side that decide among candidates
_FINAL_FITS = ((192, 6), (1024, 8))  # probes and steps for the one chosen: cheap ones first
_CORRELATION_MARGIN = 0.2  # below the best correlation; candidates with less are not fitted, which takes long
_REFLECTION_RATIO = 0.85  # a reflection must leave this much less distance than every rotation to be believed
_SAME_ROTATION = np.radians(15.0)  # rotations closer than this are the same answer
_TOUCHING = 0.1  # RMS radii: surfaces this close to each other are in touch
_TOUCHING_SPACINGS = 2.0  # the same in spacings of the samples, where these are farther apart
_OUTLIER_RATIO = 4.0  # median distances; all that is farther counts as equally far
_OUTLIER_LIMITS = (0.05, 0.3)  # RMS radii that this distance stays within; a choice
_RESOLVED_DISTANCE = 0.005  # RMS radii; residuals below are those of samples and facets
_EQUAL_RATIO = 1.25  # poses whose residuals differ by less fit equally well
_CLEAR_RATIO = 1.75  # a pose whose best rival leaves so many times its residual has full confidence
_OVERLAP_RANGE = (0.6, 0.95)  # shares of the surfaces in touch with no confidence and with full

Ambiguity = Literal["none", "discrete", "continuous", "sliding"]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses in the frames of the surfaces, the chosen one first, and what is known about them."""

    poses: Poses
    """k, best first."""
    correlations: Float64Array
    """(k,) of the coefficients."""
    distances: Float64Array
    """(k, 2, m) from samples of the moved source to the surface of the target and back, in RMS radii of the target."""
    near: float
    """RMS radii of the target within which surfaces are in touch."""
    rivalry: float
    """Residual of the best rival over that of the answer: 1 where another rotation fits as well."""
    ambiguity: Ambiguity
    """Whether other rotations fit as well."""
    axis: Float64Array | None
    """(3,) about which turning changes little, if that is so."""
    first: Surface
    """The source, in its own frame."""
    second: Surface
    """The target, in its own frame."""

    @property
    def overlap(self) -> float:
        """Share of either surface, the smaller, that is in touch with the other."""
        return float((self.distances[0] <= self.near).mean(axis=1).min())

    @property
    def confidence(self) -> float:
        """In [0, 1]: what overlaps, times how clearly the answer is the best."""
        return _ramp(self.overlap, *_OVERLAP_RANGE) * _ramp(self.rivalry, 1.0, _CLEAR_RATIO)


def align(
    first: Surface,
    second: Surface,
    *,
    scaling: bool,
    reflections: bool,
    polish: bool,
    candidates: int,
    bandwidth: int,
) -> Alignment:
    """Find the pose that maps the first surface onto the second; arguments as in the public option."""
    rotations, correlations = _rotations(first, second, reflections, candidates, bandwidth)
    source, target = Side.of(first, _PROBES), Side.of(second, _PROBES)
    start = Poses.centred(rotations, 1.0 if scaling else first.rms_radius / second.rms_radius)
    tried, distances = _refined(source, target, start, correlations, scaling)
    apart = _residuals(distances)
    order = np.argsort(np.where(np.linalg.det(rotations) < 0, apart / _REFLECTION_RATIO, apart), kind="stable")
    tried, distances = tried.take(order), distances[order]
    best = tried.take([0])
    if polish:
        for probes, steps in _FINAL_FITS:
            best = refine(source, target, best, probes=probes, steps=steps, scaling=scaling)
    axis, beside = _turned_about_weakest(source, target, best)
    apart = _residuals(np.concatenate((_distances(source, target, Poses.joined(best, beside)), distances[1:])))
    rivalry = apart[1:] / max(apart[0], _RESOLVED_DISTANCE)
    rivalry[2:][~_distinct(tried, best)[1:]] = np.inf
    poses = Poses.joined(best, tried.take(np.arange(1, len(tried)))) if polish else start.take(order)
    distances[0] = _distances(source, target, best)[0]
    ambiguity = _ambiguity(rivalry[:2].min(), rivalry[2:].min(initial=np.inf))
    return Alignment(
        poses=poses,
        correlations=correlations[order],
        distances=distances,
        near=max(_TOUCHING, _TOUCHING_SPACINGS * target.spacing),
        rivalry=float(rivalry.min()),
        ambiguity=ambiguity,
        axis=axis if ambiguity == "continuous" else None,
        first=first,
        second=second,
    )


def _refined(
    source: Side, target: Side, start: Poses, correlations: Float64Array, scaling: bool
) -> tuple[Poses, Float64Array]:
    """Candidates after a few steps, because centroids and sizes are never quite the same, and their distances.

    Those whose correlation is far below the best stay as they are.
    """
    count = int(np.count_nonzero(correlations >= correlations[0] - _CORRELATION_MARGIN))
    probes, steps = _FIRST_FIT
    plausible = refine(source, target, start.take(np.arange(count)), probes=probes, steps=steps, scaling=scaling)
    tried = Poses.joined(plausible, start.take(np.arange(count, len(start))))
    return tried, _distances(source, target, tried)


def _rotations(
    first: Surface, second: Surface, reflections: bool, candidates: int, bandwidth: int
) -> tuple[Float64Array, Float64Array]:
    """Candidates (k, 3, 3) and their correlations (k,), best first; the identity where a surface is round."""
    one, other = (shell_coefficients(surface, bandwidth) for surface in (first, second))
    if is_round(one) or is_round(other):
        return np.eye(3)[None], np.zeros(1)
    found = estimate_rotation(one, other, reflections=reflections, maxima=candidates)
    return np.array(found.rotations), np.array(found.correlations)


def _distances(source: Side, target: Side, poses: Poses) -> Float64Array:
    """Distances (k, 2, m) from samples of one surface to the other and back."""
    return Pairs.of(source, target, poses, _COMPARED).distance.reshape(len(poses), 2, -1)


def _residuals(distances: Float64Array) -> Float64Array:
    """Root mean square distance (k,) of the surfaces in each pose.

    What is several times as far as usual in the best pose is an outlier, or has no counterpart: all such count alike.
    """
    usual = float(np.median(distances, axis=(1, 2)).min())
    distances = np.minimum(distances, np.clip(_OUTLIER_RATIO * usual, *_OUTLIER_LIMITS))
    return np.asarray(np.sqrt(np.mean(distances**2, axis=(1, 2))))


def _distinct(tried: Poses, best: Poses) -> NDArray[np.bool_]:
    """Which poses (k,) are other answers than the best: turned by more, and mirrored like it."""
    cosine = (np.einsum("kij,ij->k", tried.rotations, best.rotations[0]) - 1) / 2
    alike = np.linalg.det(tried.rotations) * np.linalg.det(best.rotations[0]) > 0
    return np.asarray((cosine < np.cos(_SAME_ROTATION)) & alike)


def _turned_about_weakest(source: Side, target: Side, best: Poses) -> tuple[Float64Array, Poses]:
    """The axis that the best pose is held least about, and the pose turned either way about it.

    Where that changes nothing, the shape has an axis of revolution.
    """
    axis = weakest_axis(source, target, best, probes=_COMPARED)
    turns = exponential(np.outer((_SAME_ROTATION, -_SAME_ROTATION), axis))
    return axis, Poses(turns @ best.rotations, best.scales.repeat(2), best.shifts.repeat(2, axis=0))


def _ambiguity(beside: float, elsewhere: float) -> Ambiguity:
    if beside < _EQUAL_RATIO:
        return "continuous"
    return "discrete" if elsewhere < _EQUAL_RATIO else "none"


def _ramp(value: float, low: float, high: float) -> float:
    """0 up to ``low``, 1 from ``high`` on, straight between."""
    return float(np.clip((value - low) / (high - low), 0, 1))
