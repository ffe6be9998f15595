"""Many scans of one object or scene, each in a frame of its own, brought into one."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import MeshArrays, evenly_thinned
from fsh3d_o3d.registration.scan_fit import ScanSamples
from fsh3d_o3d.registration.scan_graph import Group, grouped, optimised, strongest_tree
from fsh3d_o3d.registration.scan_input import Frames, Scan, scan_of, viewpoints_of
from fsh3d_o3d.registration.scan_loops import PairPose, believed
from fsh3d_o3d.registration.scan_pairs import chosen_pairs, joined, pair_poses
from fsh3d_o3d.registration.scan_result import DropReason, ScanPair, ScanRegistrationResult
from fsh3d_o3d.registration.target import SphericalRegistrationTarget
from fsh3d_o3d.sphere import single_threaded_blas

__all__ = ["ScanRegistrationOption", "register_scans"]

_ALIGNED_POINTS = 20_000  # of each scan, spread by area: what a registration looks at
_TRUSTED = 0.5  # belief from which a pair holds its scans together
_JOINING_PASSES = 3  # over groups left over; each may fit what the pass before has put in place


@value(kw_only=True)
class ScanRegistrationOption:
    """Options of ``register_scans``; checked when made.

    Example:
        >>> fsh.ScanRegistrationOption(neighbours=8)
        ScanRegistrationOption(neighbours=8)
    """

    all_pairs_up_to: int = 12
    """Up to so many scans, each is aligned with every other; of more, with its neighbours only."""
    neighbours: int = 6
    """How many scans that are alike in shape each is then aligned with, beside the two before and after it."""

    def __post_init__(self) -> None:
        check.integer(self.all_pairs_up_to, "all_pairs_up_to", minimum=2, maximum=1000)
        check.integer(self.neighbours, "neighbours", minimum=1, maximum=1000)


def register_scans(
    clouds: Sequence[Any],
    option: ScanRegistrationOption | None = None,
    *,
    viewpoints: Any = None,
    progress: bool = False,
) -> ScanRegistrationResult:
    """Bring scans that each lie in a frame of their own, and show a part of one thing, into one frame.

    Pairs are aligned by ``registration_spherical`` without a first guess and fitted to what is in contact. What touches
    well and closes loops with others is believed; scans left over are tried against all that is in place. Then all
    scans that touch are fitted to each other, and Open3D's pose graph optimisation spreads what is left of the errors
    over the loops (``docs/scans.md``). All scans are in the same units. Equal input gives equal bytes.

    Args:
        clouds: Point clouds or meshes, as ``from_any`` takes them, in any mix. Points that are NaN, as in organised
            clouds, are left out and counted.
        option: ``ScanRegistrationOption()`` if not given.
        viewpoints: Where the camera stood for each scan, in that scan's frame: (n, 3), or (3,) if it is the same for
            all, as (0, 0, 0) often is. Poses in which one scan stands before what another's camera saw are then
            dropped, and less overlap is needed.
        progress: Show a bar on standard error if that is a terminal.

    Returns:
        Poses, groups and pairs. Scans that could not be placed are no error: ``unplaced`` names them.

    Raises:
        TypeError: Not geometries, or not an option.
        ValueError: No scan at all, or viewpoints of another shape.
        GeometryError: A scan is empty or without extent; the message says which.

    Example:
        >>> points = np.asarray(fsh.read_geometry("samples/bennu_cloud.ply").points)
        >>> quarter_turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        >>> result = fsh.register_scans([points[points[:, 2] > -0.3], points[points[:, 2] < 0.5] @ quarter_turn])
        >>> result.unplaced
        ()
        >>> bool(np.abs(result.poses[1][:3, :3] - quarter_turn).max() < 0.01)
        True
        >>> len(result.merged().points) > len(points)
        True
    """
    if option is None:
        option = ScanRegistrationOption()
    if not isinstance(option, ScanRegistrationOption):
        raise TypeError(f"option must be a ScanRegistrationOption, got {type(option).__name__}")
    if isinstance(clouds, (str, bytes)) or not isinstance(clouds, Sequence):
        raise TypeError(f"clouds must be a list of scans, got {type(clouds).__name__}")
    if not clouds:
        raise ValueError("clouds must hold at least one scan, got none")
    scans = [scan_of(cloud, f"scan {number}") for number, cloud in enumerate(clouds)]
    with single_threaded_blas():
        return _registered(scans, viewpoints_of(viewpoints, len(scans)), option, progress)


def _registered(
    scans: list[Scan], viewpoints: list[Float64Array | None], option: ScanRegistrationOption, progress: bool
) -> ScanRegistrationResult:
    count = len(scans)
    unit = float(np.median([scan.rms_radius for scan in scans]))
    shapes = [scan.in_units(unit) for scan in scans]
    eyes = [None if eye is None else (eye - scan.center) / unit for scan, eye in zip(scans, viewpoints, strict=True)]
    samples = [ScanSamples.of(shape, eye) for shape, eye in zip(shapes, eyes, strict=True)]
    aligned = [shape if isinstance(shape, MeshArrays) else evenly_thinned(shape, _ALIGNED_POINTS) for shape in shapes]
    targets = [SphericalRegistrationTarget(one) for one in aligned]
    chosen = chosen_pairs(aligned, option.all_pairs_up_to, option.neighbours)
    shown = progress and sys.stderr.isatty()
    with tqdm(total=len(chosen), unit="pair", leave=False, disable=not shown, desc="aligning") as bar:
        found: list[PairPose] = []
        for target, source in chosen:
            found += pair_poses(targets, samples, source, target)
            bar.update()
        belief = believed(found)[0]
        bar.set_description_str("joining")
        groups = _joined(_groups(count, found, belief), samples, bar.refresh)
        bar.set_description_str("optimising")
        results = [optimised(samples, group, bar.refresh) for group in groups]
    frames = Frames(scans, unit)
    poses = np.empty((count, 4, 4))
    for better, _, _, _ in results:
        for index, pose in better.items():
            poses[index] = frames.given(index, min(better), pose)
    dropped = np.array([scan.dropped for scan in scans], dtype=np.int64)
    for array in (poses, dropped):
        array.setflags(write=False)
    used = [edge for _, edges, _, _ in results for edge in edges]
    given_up = [edge for _, _, edges, _ in results for edge in edges]
    before, after = results[0][3]
    return ScanRegistrationResult(
        poses=poses,
        groups=tuple(tuple(sorted(group.poses)) for group in groups),
        pairs=_pairs(found, belief, used, given_up, frames),
        loop_error=(before * unit, after * unit),
        dropped_points=dropped,
        scans=tuple(scan.geometry for scan in scans),
        kind=scans[0].kind,
    )


def _groups(count: int, found: list[PairPose], belief: Float64Array) -> list[Group]:
    """What believed pairs hold together; the strongest are those that are believed and touch most."""
    overlap = np.array([pose.contact.mean_overlap for pose in found])
    weights = np.where(belief >= _TRUSTED, belief + overlap, 0.0)
    return [strongest_tree(group, found, weights) for group in grouped(count, found, weights)]


def _joined(groups: list[Group], samples: Sequence[ScanSamples], step: Callable[[], object]) -> list[Group]:
    """Groups after those left over have been tried against all that is in place."""
    for _ in range(_JOINING_PASSES):
        main, rest = groups[0], []
        for group in groups[1:]:
            step()
            both = joined(group, main, samples)
            if both is None:
                rest.append(group)
            else:
                main = both
        if len(rest) == len(groups) - 1:
            break
        groups = [main, *rest]
    return groups


def _pairs(
    found: list[PairPose], belief: Float64Array, used: list[PairPose], given_up: list[PairPose], frames: Frames
) -> tuple[ScanPair, ...]:
    """What became of each pair: the fit that was used, or the most believed of its poses."""
    best: dict[tuple[int, int], int] = {}
    several = Counter((pose.target, pose.source) for pose in found if pose.log_odds > 0)
    for number in np.argsort(-belief, kind="stable"):
        best.setdefault((found[number].target, found[number].source), int(number))
    reported = {
        key: _reported(
            found[number], float(belief[number]), _reason(found[number], belief[number], several[key]), frames
        )
        for key, number in best.items()
    }
    ends: tuple[tuple[list[PairPose], DropReason], ...] = ((given_up, "contradicts others"), (used, ""))
    for edges, reason in ends:
        for edge in edges:
            key = edge.target, edge.source
            known = float(belief[best[key]]) if key in best else 0.0
            reported[key] = _reported(edge, max(known, edge.probability), reason, frames)
    return tuple(reported[key] for key in sorted(reported))


def _reason(pose: PairPose, belief: float, several: int) -> DropReason:
    if belief >= _TRUSTED:  # and neither used nor given up: its scans lie otherwise
        return "contradicts others"
    return pose.doubt or ("fits in several ways" if several > 1 else "loops do not close")


def _reported(pose: PairPose, belief: float, reason: DropReason, frames: Frames) -> ScanPair:
    transformation = frames.given(pose.source, pose.target, pose.pose)
    transformation.setflags(write=False)
    return ScanPair(
        source=pose.source,
        target=pose.target,
        transformation=transformation,
        confidence=belief,
        overlap=pose.contact.overlap,
        inlier_rmse=pose.contact.rmse * frames.unit,
        used=not reason,
        reason=reason,
    )
