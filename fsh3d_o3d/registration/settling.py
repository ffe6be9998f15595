"""From hundreds of rough poses to a dozen that lie on the target: looked up, brought closer, and looked at again.

    ground = Ground.of(points, normals, spacing)           # of the target; pickles
    poses, scores, came_from = ground.best(poses, probes)   # best first; came_from are indices of the poses given

No tree is searched. Probes are a hundred points or more of the source, in any frame that the poses are of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.registration.fit import Poses
from fsh3d_o3d.registration.lattice import SurfaceLattice, distinct

_COARSE = 2.0  # spacings, edge of the cells in which poses are first brought closer
_FIRST_LOOK = (100, 0.7)  # probes, and spacings from the surface at which they count, when all poses are looked up
_SETTLED = 60  # poses that are brought closer; 100 take a fifth longer and find no more
_APART = 1.2  # spacings that these are apart at least, root mean square; closer ones end in the same place
_STEPS = ((4, 2.3), (2, 1.6))  # steps, and spacings within which pairs count, on coarse cells and on fine ones
_SECOND_LOOK = 0.5  # spacings from the surface at which probes count in the end
_OTHER = 1.0  # spacings that poses in the end are apart at least
_PLACES = 12  # probes that tell how far poses are apart
_RARE = 0.02  # share of the poses; a probe that fits in fewer says no more than this


@dataclass(frozen=True, eq=False)
class Ground:
    """A target as poses settle on it."""

    coarse: SurfaceLattice
    """In cells of two spacings: points are found from farther off."""
    fine: SurfaceLattice
    """In cells of one spacing."""
    spacing: float
    """How far the points are apart."""

    @classmethod
    def of(cls, points: Float64Array, normals: Float64Array, spacing: float) -> Ground:
        """Take points (n, 3), which lie ``spacing`` apart, and normals (n, 3) up to their sign."""
        return cls(
            SurfaceLattice.of(points, normals, _COARSE * spacing), SurfaceLattice.of(points, normals, spacing), spacing
        )

    def best(self, poses: Poses, probes: Float64Array, most: int = 12) -> tuple[Poses, Float64Array, IntArray]:
        """Return the poses that agree best, brought closer, with scores (k,) and indices (k,) of what they were.

        The score is the mean of two shares relative to the best: of the probes that lie on the surface, and of the
        same where each counts by how rarely it does. What fits almost everywhere, as a flat side does, says little; but
        where little is shared, what is rare may be chance.

        Args:
            poses: (k), without scales, in the order in which equal ones are preferred.
            probes: (m, 3) of the source, as good as random.
            most: Poses that are returned.
        """
        if not len(poses):
            return poses, np.zeros(0), np.zeros(0, dtype=np.int64)
        first, within = _FIRST_LOOK
        places = probes[:_PLACES]
        order = np.argsort(-self.coarse.shares(poses, probes[:first], within * self.spacing), kind="stable")
        order = order[distinct(poses.take(order), places, _APART * self.spacing, _SETTLED)]
        settled = poses.take(order)
        for lattice, (steps, reach) in zip((self.coarse, self.fine), _STEPS, strict=True):
            settled = lattice.settled(settled, probes[:first], steps=steps, reach=reach * self.spacing)
        scores = self._scores(settled, probes)
        best = np.argsort(-scores, kind="stable")
        best = best[distinct(settled.take(best), places, _OTHER * self.spacing, most)]
        return settled.take(best), scores[best], order[best]

    def _scores(self, poses: Poses, probes: Float64Array) -> Float64Array:
        on = self.fine.heights(poses, probes) <= _SECOND_LOOK * self.spacing
        share = on.mean(axis=1)
        rarity = -np.log(np.maximum(on.mean(axis=0), _RARE))
        rare = on @ rarity
        tiny = np.finfo(np.float64).tiny
        return np.asarray(share / max(share.max(), tiny) + rare / max(rare.max(), tiny)) / 2
