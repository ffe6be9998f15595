"""A surface as a hashed lattice of its points and normals: hundreds of poses are brought closer in milliseconds.

Instead of a search for the nearest point, the cell that a place lies in tells a point near by. Distances are taken to
its tangent plane, so that it need not be the nearest.

    lattice = SurfaceLattice.of(points, normals, cell)     # cell: about twice the spacing of the points
    poses = lattice.settled(poses, probes, steps=4, reach=1.25 * cell)
    shares = lattice.shares(poses, probes, within=0.25 * cell)
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.registration.fit import Poses
from fsh3d_o3d.sphere import exponential

_FACTORS = np.array([73856093, 19349663, 83492791])  # Teschner et al. 2003; lattices of any extent into one table
_TABLE = 2**20  # entries; a few in a hundred are taken by chance, by points that are too far to count
_FARTHEST = 2.0**30  # cells; farther places count as this far, so that the products with the factors fit int64
_AROUND = sorted(itertools.product((-1, 0, 1), repeat=3), key=lambda step: -sum(map(abs, step)))
"""A cell and those that touch it, itself last, so that its own points are what is found in it."""
_DAMPING = 0.02  # of what a step costs if all probes moved freely: directions that no pair holds stay where they are


@dataclass(frozen=True, eq=False)
class SurfaceLattice:
    """Points of a surface by the cells that they lie in or beside."""

    points: NDArray[np.float32]
    """(n, 3) relative to ``origin``."""
    normals: NDArray[np.float32]
    """(n, 3) unit normals up to their sign."""
    table: NDArray[np.int32]
    """Which point belongs to a cell of that hash; −1 for none."""
    origin: Float64Array
    """(3,)."""
    cell: float
    """Edge of a cell."""

    @classmethod
    def of(cls, points: Float64Array, normals: Float64Array, cell: float) -> SurfaceLattice:
        """Take points (n, 3) and normals (n, 3)."""
        origin = points.mean(axis=0)
        relative = (points - origin).astype(np.float32)
        own = _hashes(relative, cell)
        table = np.full(_TABLE, -1, dtype=np.int32)
        index = np.arange(len(points), dtype=np.int32)
        for step in _AROUND:
            table[(own + np.dot(step, _FACTORS)) % _TABLE] = index
        return cls(relative, normals.astype(np.float32), table, origin, cell)

    def shares(self, poses: Poses, probes: Float64Array, within: float) -> Float64Array:
        """The share (k,) of probes (m, 3) of the source that each pose takes so close to the surface."""
        return np.asarray((self.heights(poses, probes) <= within).mean(axis=1))

    def heights(self, poses: Poses, probes: Float64Array) -> NDArray[np.float32]:
        """Distances (k, m) of probes (m, 3) from the surface in each pose; infinite beyond about a cell."""
        there = self._moved(poses, probes)
        found = self._found(there)
        gap = there - self.points[found]
        height = np.abs(np.einsum("kmi,kmi->km", gap, self.normals[found]))
        far = (found < 0) | (np.einsum("kmi,kmi->km", gap, gap) > (2 * self.cell) ** 2)
        return np.where(far, np.float32(np.inf), height)

    def settled(self, poses: Poses, probes: Float64Array, *, steps: int, reach: float) -> Poses:
        """Poses closer to the surface: Gauss–Newton on the probes' distances to tangent planes (Tukey's weights).

        Args:
            poses: (k), without scales.
            probes: (m, 3) points of the source; a hundred do.
            steps: Of the iteration.
            reach: Distance of pairs that weigh nothing; up to about 1.5 cells.
        """
        for _ in range(steps):
            there = self._moved(poses, probes)
            found = self._found(there)
            normal = self.normals[found]
            gap = there - self.points[found]
            apart = np.einsum("kmi,kmi->km", gap, gap) / np.float32(reach**2)
            weight = np.where(found < 0, np.float32(0), np.maximum(1 - apart, 0) ** 2)
            middle = there.mean(axis=1, keepdims=True)
            arm = there - middle
            rows = np.concatenate((np.cross(arm, normal), normal), axis=2)
            weighted = np.swapaxes(rows * weight[..., None], 1, 2)
            height = np.einsum("kmi,kmi->km", gap, normal)
            step = _step(weighted @ rows, (weighted @ height[..., None])[..., 0], weight, arm)
            turn = exponential(step[:, :3])
            center = middle[:, 0] + self.origin
            shift = np.einsum("kij,kj->ki", turn, poses.shifts - center) + center + step[:, 3:]
            poses = Poses(turn @ poses.rotations, poses.scales, shift)
        return poses

    def _moved(self, poses: Poses, probes: Float64Array) -> NDArray[np.float32]:
        return (poses.apply(probes) - self.origin).astype(np.float32)

    def _found(self, places: NDArray[np.float32]) -> NDArray[np.int32]:
        return self.table[_hashes(places, self.cell) % _TABLE]


def distinct(poses: Poses, places: Float64Array, apart: float, most: int) -> NDArray[np.int64]:
    """Indices of the first poses, ``most`` at most, that move ``places`` (m, 3) by more than ``apart`` from another's.

    The distance is the root mean square one; of poses closer to each other the first is kept.
    """
    moved = poses.apply(places).reshape(len(poses), -1)
    left = np.arange(len(poses))
    kept: list[int] = []
    while len(left) and len(kept) < most:
        kept.append(int(left[0]))
        distance = np.linalg.norm(moved[left] - moved[left[0]], axis=1) / np.sqrt(len(places))
        left = left[distance > apart]
    return np.array(kept, dtype=np.int64)


def _step(
    matrix: NDArray[np.float32], right: NDArray[np.float32], weight: NDArray[np.float32], arm: NDArray[np.float32]
) -> Float64Array:
    """The step (k, 6) downhill, turn and shift about the middle of the probes."""
    lever = np.einsum("kmi,kmi->k", arm, arm) / arm.shape[1]
    free = np.repeat(np.stack([lever, np.ones_like(lever)], axis=1), 3, axis=1).astype(np.float64)
    strength = _DAMPING * free * weight.sum(axis=1, dtype=np.float64)[:, None] + np.finfo(np.float32).tiny
    damped = matrix + strength[:, :, None] * np.eye(6)
    return np.asarray(-np.linalg.solve(damped, right[..., None].astype(np.float64))[..., 0])


def _hashes(places: NDArray[np.float32], cell: float) -> NDArray[np.int64]:
    """Hashes (…) of the cells of places (…, 3), not yet wrapped to the table: they add up."""
    lattice = np.clip(np.floor(places / np.float32(cell)), -_FARTHEST, _FARTHEST).astype(np.int64)
    return np.asarray(lattice @ _FACTORS)
