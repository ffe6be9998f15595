"""Groups of scans that belong together, their first poses, and Open3D's optimisation of all poses at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.registration.scan_fit import ScanSamples, fitted, measured_contact
from fsh3d_o3d.registration.scan_loops import PairPose, loop_gap

_ROUNDS = 2  # of fitting all that touches and optimising; the second starts from poses that are right to a spacing
_FEW_PROBES = 128  # samples that tell whether two placed scans touch at all
_NEAR_SPACINGS = 3.0  # within which these have to find the other scan
_LEAST_OVERLAP = 0.08  # of either scan; less hardly holds a pose and is easily chance
_LEAST_AGREEMENT = 0.6  # of what comes close in contact; less has met the wrong surface
_SAME_POSE = 0.1  # units (RMS radii): a fit that leaves its place by more has slid away
_PRUNED_SPACINGS = 4.0  # by which a pair may disagree with all others before Open3D gives it up
_PRUNED_BELOW = 0.25  # of the weight that a pair begins with; Open3D's own default


@dataclass(frozen=True, eq=False)
class Group:
    """Scans with known poses in one frame."""

    poses: dict[int, Float64Array]
    """(4, 4) by index of the scan."""
    links: tuple[PairPose, ...] = ()
    """Pairs that hold them together, one fewer than scans."""

    def from_first(self) -> Group:
        """The same in the frame of the scan of lowest index, in order."""
        base = np.linalg.inv(self.poses[min(self.poses)])
        return Group({scan: base @ self.poses[scan] for scan in sorted(self.poses)}, self.links)


def grouped(count: int, pairs: Sequence[PairPose], weights: Float64Array) -> list[list[int]]:
    """Return the groups of ``count`` scans that pairs of positive weight connect: largest first, then by index."""
    parent = list(range(count))
    for number in np.flatnonzero(weights > 0).tolist():
        one, other = (_root(parent, scan) for scan in (pairs[number].source, pairs[number].target))
        parent[max(one, other)] = min(one, other)
    groups: dict[int, list[int]] = {}
    for scan in range(count):
        groups.setdefault(_root(parent, scan), []).append(scan)
    return sorted(groups.values(), key=lambda group: (-len(group), group[0]))


def strongest_tree(group: list[int], pairs: Sequence[PairPose], weights: Float64Array) -> Group:
    """Return a group with a pose for each scan, along the strongest pairs that connect them."""
    order = [int(number) for number in np.argsort(-weights, kind="stable") if weights[number] > 0]
    poses = {group[0]: np.eye(4)}
    links = []
    while len(poses) < len(group):  # Prim: the strongest pair that leads on
        pair = next(pairs[n] for n in order if (pairs[n].source in poses) != (pairs[n].target in poses))
        if pair.target in poses:
            poses[pair.source] = poses[pair.target] @ pair.pose
        else:
            poses[pair.target] = poses[pair.source] @ np.linalg.inv(pair.pose)
        links.append(pair)
    return Group(poses, tuple(links)).from_first()


def optimised(
    samples: Sequence[ScanSamples], group: Group, step: Callable[[], object]
) -> tuple[dict[int, Float64Array], list[PairPose], list[PairPose], tuple[float, float]]:
    """Return better poses of one group, with the pairs used, the pairs given up, and the loop error before and after.

    All scans that touch where they lie are fitted to each other, also those of which nothing was known, which closes
    loops; then all poses are optimised at once.

    Args:
        samples: Of all scans.
        group: What belongs together; the first scan stays.
        step: Called between the fits of pairs.
    """
    poses = group.poses
    used: list[PairPose] = []
    given_up: list[PairPose] = []
    errors: list[float] = []
    for _ in range(_ROUNDS):
        edges = _touching(samples, poses, step)
        known = {(edge.source, edge.target) for edge in edges}
        edges += [link for link in group.links if (link.source, link.target) not in known]
        if not errors:
            errors.append(_loop_error(poses, edges))
        poses, kept = _pose_graph(samples, poses, edges)
        used = [edge for edge, good in zip(edges, kept, strict=True) if good]
        given_up = [edge for edge, good in zip(edges, kept, strict=True) if not good]
    return poses, used, given_up, (errors[0] if errors else 0.0, _loop_error(poses, used))


def _root(parent: list[int], scan: int) -> int:
    while parent[scan] != scan:
        scan = parent[scan]
    return scan


def _touching(
    samples: Sequence[ScanSamples], poses: dict[int, Float64Array], step: Callable[[], object]
) -> list[PairPose]:
    edges = []
    scans = sorted(poses)
    for position, target in enumerate(scans):
        for source in scans[position + 1 :]:
            step()
            guess = np.linalg.inv(poses[target]) @ poses[source]
            if not _near(samples[source], samples[target], guess):
                continue
            pose = fitted(samples[source], samples[target], guess, near=True)
            contact = measured_contact(samples[source], samples[target], pose)
            agrees = max(contact.overlap) >= _LEAST_OVERLAP and contact.agreement >= _LEAST_AGREEMENT
            if agrees and loop_gap(np.linalg.inv(guess) @ pose) <= _SAME_POSE:
                edges.append(PairPose(source, target, pose, 0.0, contact))
    return edges


def _near(source: ScanSamples, target: ScanSamples, pose: Float64Array) -> bool:
    some = source.points[source.probes(_FEW_PROBES)] @ pose[:3, :3].T + pose[:3, 3]
    reach = _NEAR_SPACINGS * max(source.spacing, target.spacing)
    return bool(np.mean(np.isfinite(target.tree.query(some, distance_upper_bound=reach)[0])) >= _LEAST_OVERLAP)


def _loop_error(poses: dict[int, Float64Array], edges: list[PairPose]) -> float:
    """Root mean square, over pairs, of what poses and the pair's own fit differ by, in units."""
    gaps = [
        loop_gap(np.linalg.inv(edge.pose) @ np.linalg.inv(poses[edge.target]) @ poses[edge.source]) for edge in edges
    ]
    return float(np.sqrt(np.mean(np.square(gaps)))) if gaps else 0.0


def _pose_graph(
    samples: Sequence[ScanSamples], poses: dict[int, Float64Array], edges: list[PairPose]
) -> tuple[dict[int, Float64Array], NDArray[np.bool_]]:
    """Poses after Open3D's optimisation, and which pairs it has kept."""
    scans = sorted(poses)
    node = {scan: number for number, scan in enumerate(scans)}
    if len(edges) < 1 or len(scans) < 2:
        return poses, np.ones(len(edges), dtype=np.bool_)
    registration = open3d().pipelines.registration
    graph = registration.PoseGraph()
    for scan in scans:
        graph.nodes.append(registration.PoseGraphNode(poses[scan]))
    certain = _backbone(scans, edges)
    # Open3D compares squared residuals with squared distances times the usual weight; only ratios matter.
    usual = float(np.mean([edge.contact.information[5, 5] for edge in edges])) or 1.0
    for number, edge in enumerate(edges):
        information = edge.contact.information / usual
        graph.edges.append(
            registration.PoseGraphEdge(
                node[edge.source], node[edge.target], edge.pose, information, uncertain=number not in certain
            )
        )
    reach = _PRUNED_SPACINGS * float(np.median([samples[scan].spacing for scan in scans]))
    option = registration.GlobalOptimizationOption(
        max_correspondence_distance=reach, edge_prune_threshold=_PRUNED_BELOW, reference_node=0
    )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        option,
    )
    kept = {(edge.source_node_id, edge.target_node_id) for edge in graph.edges}
    base = np.linalg.inv(np.asarray(graph.nodes[0].pose))
    better = {scan: _rigid(base @ np.asarray(graph.nodes[node[scan]].pose)) for scan in scans}
    better[scans[0]] = np.eye(4)
    if not all(np.isfinite(pose).all() for pose in better.values()):
        return poses, np.ones(len(edges), dtype=np.bool_)
    return better, np.array([(node[edge.source], node[edge.target]) in kept for edge in edges])


def _backbone(scans: list[int], edges: list[PairPose]) -> set[int]:
    """The strongest pairs that connect all scans: these Open3D takes as they are, so that nothing falls apart."""
    parent = {scan: scan for scan in scans}

    def root(scan: int) -> int:
        while parent[scan] != scan:
            scan = parent[scan]
        return scan

    chosen = set()
    for number in np.argsort([-min(edge.contact.overlap) for edge in edges], kind="stable"):
        one, other = root(edges[number].source), root(edges[number].target)
        if one != other:
            parent[one] = other
            chosen.add(int(number))
    return chosen


def _rigid(pose: Float64Array) -> Float64Array:
    """The rigid motion nearest to a pose whose rotation has gathered rounding."""
    left, _, right = np.linalg.svd(pose[:3, :3])
    result = pose.copy()
    result[:3, :3] = left @ right
    return result
