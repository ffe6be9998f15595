"""Which scans are aligned with each other, and what the alignments give: poses of pairs, and of groups."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.descriptors import SHDOption, shd_descriptor
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, evenly_thinned
from fsh3d_o3d.registration.option import SphericalRegistrationOption
from fsh3d_o3d.registration.register import registration_spherical
from fsh3d_o3d.registration.scan_fit import ScanSamples, fitted, measured_contact
from fsh3d_o3d.registration.scan_graph import Group
from fsh3d_o3d.registration.scan_loops import PairPose, same_pose
from fsh3d_o3d.registration.target import SphericalRegistrationTarget

_RIGID = SphericalRegistrationOption(with_scaling=False)
_RUNNERS_UP = 2  # poses of a pair beside the best that loops may decide for
_NEXT_IN_ORDER = 2  # scans before and after each that it is aligned with, as scans mostly come in the order of a path
_GROUP_SAMPLES = 16384  # of a group of placed scans; several scans' worth, and as quick to align as one
_IN_GROUP = 0.5  # share of a scan in contact with what is placed already; wrong poses of views reached 0.4
_CONFIDENT = 0.5  # of an alignment with what is placed; less needs more contact
_LEAST_IN_GROUP = 0.2  # share in contact that even a confident alignment has to show
_AGREES = 0.7  # of what comes close in contact
_FIRM = 1e-3  # firmness; balls, vases and rods had less
_RIVAL = 0.8  # of the share in contact; with a rival that has so much, nothing is known
_HIDDEN_AT_MOST = 0.08  # share in front of what some camera saw; right poses reached 0.05


def chosen_pairs(scans: Sequence[MeshArrays | PointArrays], all_up_to: int, neighbours: int) -> list[tuple[int, int]]:
    """Return the pairs (i < j) to align: all of few scans; else those next in order and those alike in shape.

    Alike are those with the smallest distances between their rotation-invariant features (``SHDOption``), so that the
    number of pairs grows with the number of scans and not with its square.
    """
    count = len(scans)
    pairs = list(itertools.combinations(range(count), 2))
    if count <= all_up_to:
        return pairs
    features = np.stack([shd_descriptor(scan, SHDOption()) for scan in scans])
    distance = cdist(features, features)
    np.fill_diagonal(distance, np.inf)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :neighbours]
    alike = {(min(scan, int(other)), max(scan, int(other))) for scan in range(count) for other in nearest[scan]}
    return [pair for pair in pairs if pair in alike or pair[1] - pair[0] <= _NEXT_IN_ORDER]


def pair_poses(
    targets: Sequence[SphericalRegistrationTarget], samples: Sequence[ScanSamples], source: int, target: int
) -> list[PairPose]:
    """Return the poses of one scan on another that alignment offers, fitted to what is in contact."""
    found: list[PairPose] = []
    for pose, confidence in _offered(targets[source].geometry, targets[target]):
        closer = fitted(samples[source], samples[target], pose)
        if not any(same_pose(other.pose, closer) for other in found):
            contact = measured_contact(samples[source], samples[target], closer)
            found.append(PairPose(source, target, closer, confidence, contact))
    return found


def together(group: Group, samples: Sequence[ScanSamples]) -> PointArrays:
    """Return samples of all scans of a group as one cloud, spread by area."""
    points = [samples[scan].points @ pose[:3, :3].T + pose[:3, 3] for scan, pose in group.poses.items()]
    normals = [samples[scan].normals @ pose[:3, :3].T for scan, pose in group.poses.items()]
    return evenly_thinned(PointArrays(np.concatenate(points), np.concatenate(normals)), _GROUP_SAMPLES)


def joined(group: Group, main: Group, samples: Sequence[ScanSamples]) -> Group | None:
    """Return both groups in one frame, found by aligning all of one with all of the other.

    What several scans show together overlaps more with a scan than each of them does. None where the two do not fit,
    or fit in several ways.
    """
    clouds = together(group, samples), together(main, samples)
    first, second = (ScanSamples.of(cloud, None) for cloud in clouds)
    offered = _offered(*clouds)
    tried: list[tuple[Float64Array, float]] = []
    for pose, confidence in offered:
        closer = fitted(first, second, pose)
        if any(same_pose(other, closer) for other, _ in tried):
            continue
        contact = measured_contact(first, second, closer)
        share = contact.overlap[0]
        enough = _LEAST_IN_GROUP if confidence >= _CONFIDENT else _IN_GROUP
        if share >= enough and contact.agreement >= _AGREES and contact.firmness >= _FIRM:
            tried.append((closer, share))
    tried.sort(key=lambda one: -one[1])
    if not tried or (len(tried) > 1 and tried[1][1] > _RIVAL * tried[0][1]):
        return None
    link = _link(group, main, samples, tried[0][0])
    if link is None:
        return None
    moved = {scan: tried[0][0] @ pose for scan, pose in group.poses.items()}
    return Group({**main.poses, **moved}, (*main.links, *group.links, link)).from_first()


def _link(group: Group, main: Group, samples: Sequence[ScanSamples], pose: Float64Array) -> PairPose | None:
    """The two scans of both groups that touch most; None if a scan stands before what a camera of the other saw."""
    best = None
    for source, own in group.poses.items():
        for target, other in main.poses.items():
            between = np.linalg.inv(other) @ pose @ own
            contact = measured_contact(samples[source], samples[target], between)
            if contact.hidden is not None and contact.hidden > _HIDDEN_AT_MOST:
                return None
            if best is None or contact.mean_overlap > best.contact.mean_overlap:
                best = PairPose(source, target, between, 0.0, contact).upward()
    return best


def _offered(
    source: MeshArrays | PointArrays, target: MeshArrays | PointArrays | SphericalRegistrationTarget
) -> list[tuple[Float64Array, float]]:
    """The answer of the registration and its runners-up, each with its confidence."""
    try:
        result = registration_spherical(source, target, _RIGID)
    except GeometryError:  # one of them is a line, or a heap far from the rest
        return []
    others = result.candidates[:_RUNNERS_UP]
    return [(result.transformation, result.confidence), *((other.transformation, 0.0) for other in others)]
