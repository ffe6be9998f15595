"""Which of all poses is the answer, and how far to trust it: those of whole shapes first, then those of parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry import MeshArrays, Surface
from fsh3d_o3d.registration.fit import Poses
from fsh3d_o3d.registration.option import SphericalRegistrationOption
from fsh3d_o3d.registration.parts import PartsAlignment, align_parts
from fsh3d_o3d.registration.prepared import Prepared, alike
from fsh3d_o3d.registration.search import Alignment, Ambiguity, align
from fsh3d_o3d.sphere import icosphere

_SEEN_WHOLE = 0.9  # least share of both surfaces in touch with the other where both are taken for the same whole shape
_PLAIN = 0.8  # share below which whole shapes are also aligned by their plain area
_ACROSS = 0.01  # relative; ratios of sizes that differ by less are the same
_OTHER_SCALE = 0.03  # a scale that differs by more from 1 is tried beside it


@dataclass(frozen=True, eq=False)
class Answer:
    """Transformations, the chosen one first, and what is known of them."""

    transformations: Float64Array
    """(k, 4, 4) from the source's coordinates to the target's, best first."""
    correlations: Float64Array
    """(k,) of the coefficients that led to each."""
    fitness: Float64Array
    """(k,) share of samples of the source that are near the target."""
    inlier_rmse: Float64Array
    """(k,) root mean square distance of those, in units of the target."""
    overlap: tuple[float, float]
    """Share of the source's area, and of the target's, in touch."""
    confidence: float
    ambiguity: Ambiguity
    axis: Float64Array | None
    """(3,) of the ambiguity, if it has one."""
    near: float
    """Units of the target within which points count as near."""


def answer(source: Prepared, target: Prepared, option: SphericalRegistrationOption) -> Answer:
    """Align as whole shapes where both may be the same, and as parts of one where that does not fit."""
    whole = None
    meshes = isinstance(source.geometry, MeshArrays) and isinstance(target.geometry, MeshArrays)
    same = meshes or alike(source, target, option.with_scaling)
    # Parts cannot tell another size; so where it is not known, clouds that do not look alike are tried as wholes, too.
    if same or option.with_scaling:
        whole = _whole(source, target, option)
        if whole.overlap >= _SEEN_WHOLE:
            return _of_whole(whole)
    if not same:
        whole = None  # neither its poses nor its size are of use then
    scales = [1.0]
    if whole is not None:
        scale = float(whole.poses.scales[0]) * whole.second.rms_radius / whole.first.rms_radius
        if option.with_scaling and abs(np.log(scale)) > _OTHER_SCALE:
            scales.append(scale)
    found = []
    for scale in scales:
        others = None if whole is None else _about_centers(whole, source, target)
        parts = align_parts(source, target, scale, others)
        if parts is not None:
            found.append(_of_parts(parts, source, target, scale))
    if not found:
        return _of_whole(whole or _whole(source, target, option))
    return max(found, key=lambda each: each.confidence)


def _whole(source: Prepared, target: Prepared, option: SphericalRegistrationOption) -> Alignment:
    found = _aligned(source.resolved, target.resolved, option)
    if found.overlap < _PLAIN:
        # Thin parts that only one of the two has weigh less by their area than by what is seen of them.
        found = max(found, _aligned(source.plain, target.plain, option), key=lambda alignment: alignment.overlap)
    if not option.with_scaling:
        return found
    # Where closest points settle on a wrong size, both are still as far across.
    across = _ratio_across(found)
    if abs(np.log(across / found.poses.scales[0])) <= _ACROSS:
        return found
    scale = across * found.second.rms_radius / found.first.rms_radius
    rigid = replace(option, with_scaling=False)
    tried = [found]
    for first, second in ((source.resolved, target.resolved), (source.plain, target.plain)):
        sized = _aligned(replace(first, rms_radius=scale * first.rms_radius), second, rigid)
        tried.append(replace(sized, first=first))
    return min(tried, key=_residual)


def _ratio_across(found: Alignment) -> float:
    """How many times as far across as the turned source the target is, in their frames: median of all directions."""
    turned = found.first.vertices @ found.poses.rotations[0].T
    widths = (np.ptp(points @ icosphere(1)[0].T, axis=0) for points in (turned, found.second.vertices))
    return float(np.median(np.divide(*reversed(list(widths)))))


def _residual(found: Alignment) -> float:
    """Root mean square distance of the surfaces in units of the target; what is not near counts as just that."""
    return float(np.sqrt(np.mean(np.minimum(found.distances[0], found.near) ** 2))) * found.second.rms_radius


def _aligned(first: Surface, second: Surface, option: SphericalRegistrationOption) -> Alignment:
    return align(
        first,
        second,
        scaling=option.with_scaling,
        reflections=option.reflections,
        polish=option.polish,
        candidates=option.candidates,
        bandwidth=option.bandwidth,
    )


def _of_whole(found: Alignment) -> Answer:
    source, target = found.first, found.second
    unit = target.rms_radius
    near = found.distances[:, 0] <= found.near
    squares = np.where(near, found.distances[:, 0], 0.0) ** 2
    touching = (found.distances[0] <= found.near).mean(axis=1)
    return Answer(
        transformations=_transformations(found.poses, source.centroid, target.centroid, source.rms_radius, unit),
        correlations=found.correlations,
        fitness=near.mean(axis=1),
        inlier_rmse=np.sqrt(squares.sum(axis=1) / np.maximum(near.sum(axis=1), 1)) * unit,
        overlap=(float(touching[0]), float(touching[1])),
        confidence=found.confidence,
        ambiguity=found.ambiguity,
        axis=found.axis,
        near=found.near * unit,
    )


def _of_parts(found: PartsAlignment, source: Prepared, target: Prepared, scale: float) -> Answer:
    unit = target.size
    agreement = found.agreement
    return Answer(
        transformations=_transformations(found.poses, source.center, target.center, unit / scale, unit),
        correlations=found.correlations,
        fitness=agreement.touching[:, 0],
        inlier_rmse=agreement.apart * unit,
        overlap=(float(agreement.touching[0, 0]), float(agreement.touching[0, 1])),
        confidence=found.confidence,
        ambiguity=found.ambiguity,
        axis=found.axis,
        near=found.near * unit,
    )


def _about_centers(found: Alignment, source: Prepared, target: Prepared) -> Poses:
    """Poses of whole shapes as ``align_parts`` takes them, without their own scales."""
    rotations = found.poses.rotations
    matrices = _transformations(
        found.poses, found.first.centroid, found.second.centroid, found.first.rms_radius, found.second.rms_radius
    )
    moved = matrices[:, :3, :3] @ source.center + matrices[:, :3, 3]
    return Poses(rotations, np.ones(len(rotations)), (moved - target.center) / target.size)


def _transformations(
    poses: Poses, source_center: Float64Array, target_center: Float64Array, source_unit: float, target_unit: float
) -> Float64Array:
    """Matrices (k, 4, 4) of poses between frames that were moved to centres and scaled by units."""
    result = np.zeros((len(poses), 4, 4))
    result[:, :3, :3] = target_unit / source_unit * poses.scales[:, None, None] * poses.rotations
    result[:, :3, 3] = target_center + target_unit * poses.shifts - result[:, :3, :3] @ source_center
    result[:, 3, 3] = 1
    return result
