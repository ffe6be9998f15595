"""Alignment of two clouds in the same units, seen in part: ours and the peers, each with its closest points behind."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fsh3d_o3d as fsh
from benchmarks._open3d_peers import fpfh, methods, ransac_on_features, thinned_cloud
from benchmarks._partial_pairs import PartialPair, Points

_VOXEL = 0.03  # of the model's diagonal; what suits RANSAC best on parts, 0.02 is slower and finds less
_KISS_VOXEL = 0.02  # of the diagonal; KISS-Matcher's one setting
_ICP_STEPS = (2.0, 1.0)  # voxels within which points are matched, one round of closest points after the other

Found = tuple[NDArray[np.float64], float | None]
"""(4, 4) from source to target, and the confidence where there is one."""
Method = Callable[[Points, Any], Found]
"""Of the source and of what ``TARGETS`` makes of the target."""


def ours(source: Points, target: Any) -> Found:
    """Align by ``registration_spherical``; units are known, as they are to the peers."""
    result = fsh.registration_spherical(source, target, fsh.SphericalRegistrationOption(with_scaling=False))
    return result.transformation, result.confidence


def prepared_target(pair: PartialPair) -> fsh.SphericalRegistrationTarget:
    """Prepare the target with what one source needs of it; a later one pays for no more."""
    target = fsh.SphericalRegistrationTarget(pair.target)
    ours(pair.source, target)
    return target


def ransac(source: Points, target: Any) -> Found:
    """Align by Open3D's FPFH, RANSAC on its matches and closest points, as in its tutorial."""
    clouds = [thinned_cloud(points, _VOXEL) for points in (source, target)]
    found = ransac_on_features(clouds, [fpfh(cloud, _VOXEL) for cloud in clouds], _VOXEL)
    return _closest_points(source, target, found.transformation), None


def kiss_matcher(source: Points, target: Any) -> Found:
    """Align by KISS-Matcher and closest points."""
    library = importlib.import_module("kiss_matcher")
    matcher = library.KISSMatcher(library.KISSMatcherConfig(_KISS_VOXEL))
    found = matcher.estimate(source.astype(np.float32), target.astype(np.float32))
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = np.asarray(found.rotation), np.asarray(found.translation).ravel()
    return _closest_points(source, target, start), None


def _closest_points(source: Points, target: Points, start: NDArray[np.float64]) -> NDArray[np.float64]:
    clouds = [thinned_cloud(points, _VOXEL / 2) for points in (source, target)]
    for voxels in _ICP_STEPS:
        estimation = methods.TransformationEstimationPointToPlane()
        start = methods.registration_icp(*clouds, voxels * _VOXEL, start, estimation).transformation
    return np.array(start)


def _plain_target(pair: PartialPair) -> Points:
    return pair.target


REFERENCE = "FPFH + RANSAC + ICP"
"""Whose time the others are measured in."""
METHODS: dict[str, Method] = {
    "ours": ours,
    "ours, prepared target": ours,
    REFERENCE: ransac,
}
"""By name; KISS-Matcher among them where it is installed."""
if importlib.util.find_spec("kiss_matcher") is not None:
    METHODS["KISS-Matcher + ICP"] = kiss_matcher
TARGETS: dict[str, Callable[[PartialPair], Any]] = dict.fromkeys(METHODS, _plain_target) | {
    "ours, prepared target": prepared_target
}
"""What a method is given as the target; made before the clock starts."""
