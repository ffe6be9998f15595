"""How well two surfaces agree in a pose where only a part of each has a counterpart.

The mean distance of all samples prefers poses that overlap too much. What counts here is what lies on the other
surface within a tight tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.registration.fit import Poses, Side, nearest_nodes

_TOLERANCE = 0.25  # spacings off the other's tangent plane, up to which samples agree: the roughness of thinned scans
_BESIDE = 1.35  # spacings to the nearest sample up to which samples can agree
_PARALLEL = 0.7  # least cosine between normals of surfaces that agree


@dataclass(frozen=True, eq=False)
class Agreement:
    """What speaks for poses."""

    agreeing: Float64Array
    """(k, 2) shares of the samples of source and target that lie on the other, less the farther off they are."""
    touching: Float64Array
    """(k, 2) shares of the samples that lie on the other within the tolerance, all counting alike."""
    apart: Float64Array
    """(k,) root mean square distance of the source's samples that lie on the target to its tangent planes."""
    sizes: tuple[int, int]
    """Samples of source and target, as many as area; shares times these are comparable."""

    def take(self, index: IntArray) -> Agreement:
        """That of some of the poses, in the order of ``index``."""
        return Agreement(self.agreeing[index], self.touching[index], self.apart[index], self.sizes)

    @classmethod
    def joined(cls, first: Agreement, second: Agreement) -> Agreement:
        """That of all poses of both."""
        return cls(
            np.concatenate((first.agreeing, second.agreeing)),
            np.concatenate((first.touching, second.touching)),
            np.concatenate((first.apart, second.apart)),
            first.sizes,
        )

    @property
    def score(self) -> Float64Array:
        """(k,) area that speaks for a pose over the area of the smaller surface."""
        area = self.agreeing * np.array(self.sizes)
        return np.asarray(area.sum(axis=1) / min(self.sizes))


def agreement(
    source: Side, target: Side, poses: Poses, *, probes: int, spacing: float, slack: float = 1.0
) -> Agreement:
    """Measure poses by ``probes`` samples of either surface, whose samples are ``spacing`` apart."""
    there = _one_sided(source, target, poses, probes, spacing, slack)
    back = _one_sided(target, source, poses.inverse(), probes, spacing, slack)
    agreeing, touching, apart = (np.stack(pair, axis=1) for pair in zip(there, back, strict=True))
    return Agreement(agreeing, touching, apart[:, 0], (len(source.nodes), len(target.nodes)))


def _one_sided(
    source: Side, target: Side, poses: Poses, probes: int, spacing: float, slack: float
) -> tuple[Float64Array, ...]:
    chosen = source.order[:probes]
    moved = poses.apply(source.nodes[chosen])
    beside = _BESIDE * slack**0.5 * spacing
    found, far = nearest_nodes(target.tree, moved, beside)
    normal = target.normals[found]
    off = np.abs(np.einsum("kmi,kmi->km", moved - target.nodes[found], normal)) / (_TOLERANCE * slack * spacing)
    turned = source.normals[chosen] @ np.swapaxes(poses.rotations, 1, 2)
    parallel = np.abs(np.einsum("kmi,kmi->km", turned, normal)) >= _PARALLEL
    on = ~far & parallel & (off <= 1)
    agreeing, touching = np.where(on, 1 - off**2, 0).mean(axis=1), on.mean(axis=1)
    apart = (
        _TOLERANCE * slack * spacing * np.sqrt(np.maximum(touching - agreeing, 0) / np.maximum(touching, 1 / probes))
    )
    return agreeing, touching, apart


def near_distance(spacing: float) -> float:
    """Distance up to which samples agree."""
    return _BESIDE * spacing
