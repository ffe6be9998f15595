"""Poses of one scan on another from places that look alike, for scans that share too little to be aligned as wholes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.descriptors import LocalHarmonics, local_harmonics
from fsh3d_o3d.registration.local_poses import local_poses
from fsh3d_o3d.registration.occupancy import Occupancy
from fsh3d_o3d.registration.scan_fit import ScanSamples
from fsh3d_o3d.registration.scan_loops import same_pose

_RADIUS = 0.4  # units (RMS radii) of the surroundings that are compared; of 0.25, 0.4 and 0.6 the best on views
_CELL = 1.5  # spacings: what lies this near counts as on the other scan
_PROBES = 512  # samples that tell how much of a scan a pose takes onto the other; a choice
_OFFERED = 3  # different poses that are looked at closely; a choice


@dataclass(frozen=True, eq=False)
class Places:
    """What lies around the places of a scan, and where the scan is."""

    harmonics: LocalHarmonics
    """Of the surroundings."""
    occupied: Occupancy
    """Cells that the scan lies in."""

    @classmethod
    def of(cls, samples: ScanSamples) -> Places:
        """Describe a scan."""
        harmonics = local_harmonics(samples.points, _RADIUS)
        return cls(harmonics, Occupancy.of(samples.points, max(_CELL * samples.spacing, np.finfo(np.float64).tiny)))


def matched_poses(source: Places, target: Places, samples: ScanSamples) -> list[Float64Array]:
    """Return a few different poses (4, 4) that alike places stand for, those first that take most onto the target.

    Args:
        source: What is moved.
        target: What stays.
        samples: Of the source.
    """
    if not len(source.harmonics) or not len(target.harmonics):
        return []
    poses, _ = local_poses(source.harmonics, target.harmonics)
    shares = target.occupied.shares(poses, samples.points[samples.probes(_PROBES)])
    found: list[Float64Array] = []
    for number in np.argsort(-shares, kind="stable"):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = poses.rotations[number], poses.shifts[number]
        if not any(same_pose(other, pose) for other in found):
            found.append(pose)
            if len(found) == _OFFERED:
                break
    return found
