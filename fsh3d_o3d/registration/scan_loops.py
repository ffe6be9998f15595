"""Which poses of pairs of scans to believe: by how they touch, and by whether loops of three close.

Wrong alignments rarely agree with each other. Where scan A goes onto B, B onto C and C onto A, a loop that closes
speaks for all three; one that does not close speaks against each as far as the two others are believed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.registration.scan_fit import Contact
from fsh3d_o3d.registration.scan_result import DropReason

_HALF_AGREES = 0.7  # of what comes close is in contact; few wrong poses of views exceed 0.6, few right ones miss 0.8
_AGREEMENT_STEP = 0.04  # of that, which changes the odds by a factor of e; from the same poses
_MOST_AGREES = 8.0  # log odds that agreement counts at most, for or against
_HALF_OVERLAP = 0.15  # geometric mean of both shares in contact; agreement of less is easily chance
_OVERLAP_STEP = 0.03  # of that, which changes the odds by a factor of e
_LEAST_OVERLAPS, _MOST_OVERLAPS = -6.0, 1.0  # log odds; more overlap is not better, where scans share a part only
_HIDDEN_FREE = 0.05  # share in front of what was seen that right poses reach, by noise and by edges
_HIDDEN_STEP = 0.02  # more of it that changes the odds by a factor of e; wrong poses have 0.08 to 0.4
_HALF_CONFIDENT = 0.4  # confidence of the registration that alone is believed by half; from 0.5 on, nearly all is right
_CONFIDENCE_STEP = 0.1  # of confidence that changes the odds by a factor of e
_DOUBTED = 0.02  # confidence below which hardly any pose is right
_DOUBTED_ODDS = 1.5  # log odds that this takes away, and that runners-up lack; contact may still outweigh it
_LOOSE = 2e-3  # firmness below which poses slide or turn freely; views of balls, vases and rods had 3e-4 to 1e-3
_LOOSE_ODDS = 4.0  # log odds that each halving of the firmness below that takes away
_LEAST_LOOSE = 3.0  # halvings that count at most
_LEAST_ODDS, _MOST_ODDS = -6.0, 10.0  # natural logarithms; the upper one is high for the sake of rivals
_MOST_BELIEVED = 0.998  # nothing is certain by one pair
_LOOP_CHANCE = 0.05  # of a loop with a wrong pose to close all the same; shapes have repeating parts
# Bounds of how all loops of a pose change its log odds. They speak for it by little: views of a round body laid on top
# of each other close all loops, and are wrong.
_LOOP_EVIDENCE = (-12.0, 1.5)
_LOOP_GAP = 0.15  # units (RMS radii) that a loop may miss by: some 5 % of the diagonal, or 8 degrees
_MOST_SURE = 0.99  # of the other two of a loop; a loop that stays open leaves a hundredth of the odds, and not nothing
_ROUNDS = 8  # of passing belief around; a choice


@dataclass(frozen=True, eq=False)
class PairPose:
    """One pose of one scan on another, and what speaks for it."""

    source: int
    """Index of the scan that moves."""
    target: int
    """Index of the scan that stays."""
    pose: Float64Array
    """(4, 4) from the source's frame to the target's."""
    confidence: float
    """Of the registration that found it."""
    contact: Contact
    """How the scans touch there."""

    def upward(self) -> PairPose:
        """The same from the scan of larger index to that of smaller."""
        if self.source > self.target:
            return self
        low, high = self.contact.overlap
        contact = replace(self.contact, overlap=(high, low))
        return PairPose(self.target, self.source, np.asarray(np.linalg.inv(self.pose)), self.confidence, contact)

    @property
    def log_odds(self) -> float:
        """What speaks for this pose by itself."""
        contact = self.contact
        agreement = np.clip((contact.agreement - _HALF_AGREES) / _AGREEMENT_STEP, -_MOST_AGREES, _MOST_AGREES)
        overlap = np.clip((contact.mean_overlap - _HALF_OVERLAP) / _OVERLAP_STEP, _LEAST_OVERLAPS, _MOST_OVERLAPS)
        odds = float(agreement + overlap)
        if self.confidence < _DOUBTED:  # it looked at all poses, and found that another is as good or that little fits
            odds -= _DOUBTED_ODDS
        odds = max(odds, (self.confidence - _HALF_CONFIDENT) / _CONFIDENCE_STEP)
        if contact.hidden is not None:
            odds = odds - max(contact.hidden - _HIDDEN_FREE, 0) / _HIDDEN_STEP
        looseness = np.log2(_LOOSE / max(contact.firmness, np.finfo(np.float64).tiny))
        odds = odds - _LOOSE_ODDS * float(np.clip(looseness, 0, _LEAST_LOOSE))
        return float(np.clip(odds, _LEAST_ODDS, _MOST_ODDS))

    @property
    def probability(self) -> float:
        """The same in [0, 1]."""
        return min(float(1 / (1 + np.exp(-self.log_odds))), _MOST_BELIEVED)

    @property
    def doubt(self) -> DropReason:
        """What speaks most against this pose; empty where more speaks for it."""
        if self.log_odds >= 0:
            return ""
        if self.contact.hidden is not None and self.contact.hidden > _HIDDEN_FREE + _HIDDEN_STEP:
            return "hides what was seen"
        return "slides" if self.contact.firmness < _LOOSE / 2 else "touches too little"


def loop_gap(transformation: Float64Array) -> float:
    """Root mean square way (in units) that points of an RMS radius of one go under what should be the identity."""
    turn = max(0.0, 2 * (3 - float(np.trace(transformation[:3, :3]))) / 3)
    return float(np.sqrt(turn + transformation[:3, 3] @ transformation[:3, 3]))


def same_pose(first: Float64Array, second: Float64Array) -> bool:
    """Whether two poses of one scan are the same answer."""
    return loop_gap(np.asarray(np.linalg.inv(first) @ second)) <= _LOOP_GAP


def believed(poses: list[PairPose]) -> tuple[Float64Array, IntArray]:
    """Return how far each pose is believed, in [0, 1], and how many loops with believed poses close through it.

    Of several poses of one pair at most one can be right.
    """
    own = np.array([pose.log_odds for pose in poses])
    members: dict[tuple[int, int], list[int]] = {}
    for number, pose in enumerate(poses):
        members.setdefault((min(pose.source, pose.target), max(pose.source, pose.target)), []).append(number)
    loops = _loops(poses, members)
    belief = _normalised(own, members)
    closing = np.zeros(len(poses), dtype=np.int64)
    for _ in range(_ROUNDS):
        evidence = np.zeros(len(poses))
        closing[:] = 0
        for (first, second, third), closes in loops:
            for a, b, c, closed in (
                (first, second, third, closes),
                (second, first, third, closes.transpose(1, 0, 2)),
                (third, first, second, closes.transpose(2, 0, 1)),
            ):
                both = np.outer(belief[b], belief[c])
                agreeing = (closed * both).sum(axis=(1, 2))
                evidence[a] += np.log(1 - min(both.sum(), _MOST_SURE) + agreeing / _LOOP_CHANCE)
                closing[a] += agreeing > 0.25  # both others are believed by half
        belief = (belief + _normalised(own + np.clip(evidence, *_LOOP_EVIDENCE), members)) / 2
    return belief, closing


def _normalised(odds: Float64Array, members: dict[tuple[int, int], list[int]]) -> Float64Array:
    """Probabilities; those of one pair, and of none of its poses, sum to one."""
    ratio = np.exp(odds)
    result = np.empty(len(odds))
    for numbers in members.values():
        result[numbers] = np.minimum(ratio[numbers] / (1 + ratio[numbers].sum()), _MOST_BELIEVED)
    return result


def _loops(
    poses: list[PairPose], members: dict[tuple[int, int], list[int]]
) -> list[tuple[tuple[list[int], list[int], list[int]], Float64Array]]:
    """All loops of three pairs, and which (a, b, c) of their poses close."""
    neighbours: dict[int, set[int]] = {}
    for one, other in members:
        neighbours.setdefault(one, set()).add(other)
    found = []
    for one in sorted(neighbours):
        for second, third in itertools.combinations(sorted(neighbours[one]), 2):
            if (second, third) not in members:
                continue
            sides = members[one, second], members[second, third], members[one, third]
            there, on, direct = (np.stack([_upward(poses[number]) for number in side]) for side in sides)
            round_trip = np.linalg.inv(direct)[None, None] @ (on[None, :, None] @ there[:, None, None])
            gaps = np.array([loop_gap(matrix) for matrix in round_trip.reshape(-1, 4, 4)])
            found.append((sides, (gaps <= _LOOP_GAP).reshape(round_trip.shape[:3]).astype(np.float64)))
    return found


def _upward(pose: PairPose) -> Float64Array:
    """From the scan with the smaller index to that with the larger."""
    return pose.pose if pose.source < pose.target else np.asarray(np.linalg.inv(pose.pose))
