"""The small motion that two surfaces are held least against: what slides or turns where nothing stops it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.registration.fit import Poses, Side, parts_pairs

_LOOSE = 0.02  # of what holds the best held motion; less is the roughness of normals of a flat wall


@dataclass(frozen=True, eq=False)
class Slip:
    """A small motion of the target's frame: a turn about a point and a shift, as one screw."""

    turn: Float64Array
    """(3,) its axis, times radians."""
    shift: Float64Array
    """(3,) of the centre."""
    center: Float64Array
    """(3,) mean of the points that are moved, by 1 root mean square."""

    @classmethod
    def weakest(cls, source: Side, target: Side, pose: Poses, *, probes: int, reach: float) -> Slip:
        """Return the motion that changes distances to tangent planes least.

        Where several change nothing, as on a plane, the one that turns least.
        """
        pairs, _ = parts_pairs(source, target, pose, probes, reach)
        held = np.einsum("mi,mi->m", pairs.normal[0], pairs.normal[0]) > 0
        place, normal = pairs.place[0, held], pairs.normal[0, held]
        center = place.mean(axis=0) if len(place) else np.zeros(3)
        place = place - center
        radius = max(float(np.sqrt(np.mean(np.einsum("mi,mi->m", place, place)))) if len(place) else 0.0, reach)
        rows = np.concatenate((np.cross(place, normal) / radius, normal), axis=1)
        strength, motions = np.linalg.eigh(rows.T @ rows)
        loose = motions[:, strength <= max(_LOOSE * strength[-1], strength[0])]
        motion = loose @ np.linalg.svd(loose[:3])[2][-1]
        return cls(motion[:3] / radius, motion[3:], center)

    def slides(self, size: float) -> bool:
        """Whether it shifts a body of this size more than it turns it."""
        return bool(np.linalg.norm(self.shift) > np.linalg.norm(self.turn) * size)

    def axis(self, size: float) -> Float64Array:
        """The unit vector (3,) along which it shifts such a body, or about which it turns it."""
        axis = self.shift if self.slides(size) else self.turn
        return np.asarray(axis / np.linalg.norm(axis))

    def applied(self, poses: Poses, step: float) -> Poses:
        """Poses after so many times the motion; turns go round, and not off along the tangent."""
        screw = np.zeros((4, 4))
        screw[:3, :3] = np.cross(self.turn, -np.eye(3))
        screw[:3, 3] = self.shift
        moved = expm(step * screw)
        rotation = moved[:3, :3]
        offset = self.center + moved[:3, 3] - rotation @ self.center
        return Poses(rotation @ poses.rotations, poses.scales, poses.shifts @ rotation.T + offset)
