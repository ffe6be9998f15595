"""Alignment of surfaces that share an unknown part: poses from local matches, ever closer looks at ever fewer."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.registration.agreement import Agreement, agreement, near_distance
from fsh3d_o3d.registration.fit import Poses, Side, refine_parts
from fsh3d_o3d.registration.lattice import distinct
from fsh3d_o3d.registration.local_poses import local_poses
from fsh3d_o3d.registration.prepared import Prepared, common_spacing
from fsh3d_o3d.registration.search import Ambiguity
from fsh3d_o3d.registration.slipping import Slip

_PROBES = 200  # samples of the source by which guesses settle
_COMPARED = 150  # samples of each side that tell which poses are fitted
_SLACK = 2.0  # times the tolerance within which these agree, because nothing is fitted yet
_SAME = 2.0  # spacings, root mean square: nearer poses end in the same place
_ELSEWHERE = 4.0  # spacings, root mean square, from the answer: nearer poses are the same answer
_STEP = 4.0  # spacings that the weakest motion moves the overlap, root mean square
_EQUAL = 0.9  # of the answer's score: poses with more fit as well
# Log-odds of being right, fitted to 213 pairs: shares of the surfaces in touch, and the rival's share of the score.
_LIKELY, _MORE, _LESS, _RIVAL = 1.3, 6.3, 6.6, 6.2
_AS_GOOD = 0.05  # of the score; rivals that lack less than this take confidence away
_CAUTION = np.log(14.0)  # log-odds at which confidence is one half
_DECIDING = 500  # samples of each side that decide at last
_FEWEST = 20  # samples of either side; what fewer agree on is chance


@dataclass(frozen=True)
class _Effort:
    """How hard is looked for the answer."""

    radius: float
    """Spacings, of the neighbourhoods that are matched: large ones tell more, small ones are seen whole more often."""
    keypoints: tuple[int, int]
    """Of source and target."""
    matches: int
    """Poses of matches that settle on the target."""
    settled: int
    """Of these, poses that are looked at closely."""
    kept: int
    """Of these, poses that are fitted to the end."""


# Most pairs are easy. Where the answer is not clear, more key points are matched, by what is nearer and by what is
# farther around them.
_EFFORTS = (
    _Effort(8.7, (120, 350), 200, 12, 3),
    _Effort(5.0, (300, 600), 700, 24, 6),
    _Effort(12.0, (300, 600), 700, 24, 6),
)
_CLEAR = 0.35  # confidence at which no more is looked for; of 22 answers from 0.2 to 0.5, 20 were right
_FIT = (200, (3.3, 2.7, 2.7, 2.0, 1.6))  # the same for all that are fitted
_LAST_FIT = (400, (2.0, 1.6, 1.3, 1.3))  # probes and reaches in spacings, for the answer alone


@dataclass(frozen=True, eq=False)
class PartsAlignment:
    """Poses that went all the way, best first, and what speaks for them."""

    poses: Poses
    agreement: Agreement
    correlations: Float64Array
    """(k,) of the local coefficients that led to each; 0 for poses that came from elsewhere."""
    rivalry: float
    """Score of the best other pose over that of the answer, at most 1."""
    ambiguity: Ambiguity
    """Whether other poses fit as well."""
    axis: Float64Array | None
    """(3,) about which turning, or along which moving, changes little, if that is so."""
    near: float
    """Distance up to which samples agree."""

    @property
    def confidence(self) -> float:
        """In [0, 1]: how likely the answer is right."""
        return _confidence(self.agreement, self.rivalry)


def align_parts(
    source: Prepared, target: Prepared, scale: float = 1.0, others: Poses | None = None
) -> PartsAlignment | None:
    """Find poses of two geometries about their centres, the size of the target for one.

    None where there is too little to compare: a few points, or one side a speck beside the other.

    Args:
        source: What is moved.
        target: What stays.
        scale: Times which the source is as large as it was given.
        others: Poses (k,) from elsewhere that are looked at, too.
    """
    unit = target.size
    spacing = common_spacing(source, target, scale) / unit
    pair = _Pair(source.side(unit / scale, spacing), target.side(unit, spacing), spacing)
    if min(len(pair.source.nodes), len(pair.target.nodes)) < _FEWEST:
        return None
    ground = target.ground(unit, spacing)
    best = _Scored.unmatched(others) if others is not None else None
    answer = None
    for effort in _EFFORTS:
        radius = effort.radius * spacing
        guesses, scores = local_poses(
            source.harmonics(unit / scale, radius, effort.keypoints[0]),
            target.harmonics(unit, radius, effort.keypoints[1]),
            most=effort.matches,
        )
        poses, _, index = ground.best(guesses, pair.source.probes[:_PROBES], effort.settled)
        found = _Scored(poses, scores[index]).joined(best)
        if not len(found.poses):
            continue
        best = pair.narrowed(found, effort.kept)
        answer = pair.judged(best)
        if answer.confidence >= _CLEAR:
            break
    return answer


@dataclass(frozen=True, eq=False)
class _Scored:
    """Poses with the correlations of the coefficients that they come from."""

    poses: Poses
    correlations: Float64Array

    @classmethod
    def unmatched(cls, poses: Poses) -> _Scored:
        return cls(poses, np.zeros(len(poses)))

    def joined(self, other: _Scored | None) -> _Scored:
        if other is None:
            return self
        correlations = np.concatenate((self.correlations, other.correlations))
        return _Scored(Poses.joined(self.poses, other.poses), correlations)

    def take(self, index: IntArray) -> _Scored:
        return _Scored(self.poses.take(index), self.correlations[index])


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two surfaces thinned alike."""

    source: Side
    target: Side
    spacing: float

    @functools.cached_property
    def corners(self) -> Float64Array:
        """Eight points (8, 3) that tell poses apart: a standard deviation out along the source's principal axes."""
        center = self.source.nodes.mean(axis=0)
        values, axes = np.linalg.eigh(np.cov(self.source.nodes.T))
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(center + (signs * np.sqrt(np.maximum(values, 0))) @ axes.T)

    def distinct(self, poses: Poses, scores: Float64Array, count: int) -> IntArray:
        """Indices of the best poses, each of which takes the source elsewhere than all better ones."""
        order = np.argsort(-scores, kind="stable")
        return order[distinct(poses.take(order), self.corners, _SAME * self.spacing, count)]

    def agreement(self, poses: Poses, samples: int, slack: float = 1.0) -> Agreement:
        return agreement(self.source, self.target, poses, probes=samples, spacing=self.spacing, slack=slack)

    def refined(self, poses: Poses, probes: int, reaches: tuple[float, ...]) -> Poses:
        steps = [reach * self.spacing for reach in reaches]
        return refine_parts(self.source, self.target, poses, probes=probes, reaches=steps)

    def narrowed(self, found: _Scored, kept: int) -> _Scored:
        """The better poses, fitted."""
        scores = self.agreement(found.poses, _COMPARED, _SLACK).score
        better = found.take(self.distinct(found.poses, scores, kept))
        return _Scored(self.refined(better.poses, *_FIT), better.correlations)

    def judged(self, found: _Scored) -> PartsAlignment:
        """The best pose, and how clearly it is the best."""
        agreed = self.agreement(found.poses, _DECIDING)
        order = np.argsort(-agreed.score, kind="stable")
        found, agreed = found.take(order), agreed.take(order)
        best = self.refined(found.poses.take([0]), *_LAST_FIT)
        poses = Poses.joined(best, found.poses)
        apart = distinct(poses, self.corners, _ELSEWHERE * self.spacing, len(poses))
        slip = Slip.weakest(self.source, self.target, best, probes=_DECIDING, reach=near_distance(self.spacing))
        beside = [slip.applied(best, step * self.spacing) for step in (_STEP, -_STEP)]
        checked = self.agreement(Poses.joined(best, *beside), _DECIDING)
        first = max(float(checked.score[0]), np.finfo(np.float64).tiny)
        near = float(checked.score[1:].max() / first)
        elsewhere = float(agreed.score[apart[1] - 1] / first) if len(apart) > 1 else 0.0
        ambiguity: Ambiguity = "none"
        if near > _EQUAL:
            ambiguity = "sliding" if slip.slides(self.source.extent) else "continuous"
        elif elsewhere > _EQUAL:
            ambiguity = "discrete"
        return PartsAlignment(
            poses=Poses.joined(best, found.poses.take(np.arange(1, len(found.poses)))),
            agreement=Agreement.joined(checked.take(np.arange(1)), agreed.take(np.arange(1, len(found.poses)))),
            correlations=found.correlations,
            rivalry=min(max(near, elsewhere, 0.0), 1.0),
            ambiguity=ambiguity,
            axis=slip.axis(self.source.extent) if near > _EQUAL else None,
            near=near_distance(self.spacing),
        )


def _confidence(found: Agreement, rivalry: float) -> float:
    """A logistic function of what overlaps and of the best rival, fitted to partial pairs and pairs that share nothing.

    Being wrong counts more than being unsure: what is right in 14 of 15 cases gets 0.5. Where a rival fits just as
    well, one of several answers was taken, and the confidence is 0.
    """
    touching = found.touching[0]
    likely = _LIKELY + _MORE * touching.max() + _LESS * touching.min() - _RIVAL * rivalry
    clear = np.clip((1 - rivalry) / _AS_GOOD, 0, 1)
    return float(clear / (1 + np.exp(_CAUTION - likely)))
