"""Similarity alignment by closest points from both sides, several poses at once.

Open3D's ICP adds up its sums in threads, so that its last digits change from run to run, moves one pose at a time, and
knows no scale where distances are to tangent planes.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import Surface
from fsh3d_o3d.sphere import exponential

REACH = 0.3
"""RMS radii; what is farther from the other surface counts as this far, whatever it is."""
_POINT_WEIGHT = 0.1  # of distances to points beside those to tangent planes, so that flat parts do not slide freely
_STEP_TOLERANCE = 1e-5  # radians and RMS radii; a step below it, far below what samples resolve, ends the iteration
_DAMPING = 1e-6  # of the trace of the normal equations: directions that no pair holds stay where they are
_PAIR_LIMIT = 3.0  # median distances; pairs farther apart do not count
_LEAST_PAIR_LIMIT = 0.05  # RMS radii; the spacing of the samples is no reason to drop a pair
_SPACING_NODES = 256  # nodes whose distances tell how far apart all are; a choice
_GOLDEN_RATIO = 0.6180339887498949  # (√5 − 1)/2, whose multiples mod 1 leave the most even gaps


@dataclass(frozen=True, eq=False)
class Side:
    """One of two surfaces in its own frame, to be searched and to search from."""

    nodes: Float64Array
    """(n, 3) samples that are found."""
    normals: Float64Array
    """(n, 3) unit normals at the nodes, zero where unknown."""
    spacings: Float64Array
    """(n,) how far samples are apart around each node."""
    probes: Float64Array
    """(m, 3) samples that search, spread by area; so is every beginning of them."""
    tree: cKDTree
    """Of the nodes."""

    @classmethod
    def of(cls, surface: Surface, probes: int) -> Side:
        """Return the side of a surface."""
        length = np.linalg.norm(surface.normals, axis=1)
        normals = surface.normals / np.where(length > 0, length, 1)[:, None]
        share = np.cumsum(surface.weights)
        # The golden ratio's multiples: any beginning of the sequence is spread over the area.
        places = np.mod(0.5 + np.arange(probes) * _GOLDEN_RATIO, 1.0) * share[-1]
        chosen = np.minimum(np.searchsorted(share, places), len(share) - 1)
        tree = cKDTree(surface.points, balanced_tree=False, compact_nodes=False)
        some = surface.points[:: max(1, len(surface.points) // _SPACING_NODES)]
        usual = float(np.median(np.asarray(tree.query(some, k=2)[0])[:, 1]))
        sparse = np.maximum(surface.weights / np.median(surface.weights), 1)
        return cls(surface.points, normals, usual * np.sqrt(sparse), surface.points[chosen], tree)

    @functools.cached_property
    def spacing(self) -> float:
        """How far samples usually are apart."""
        return float(np.median(self.spacings))


@dataclass(frozen=True, eq=False)
class Poses:
    """Maps x ↦ scale · rotation x + shift from the source's frame to the target's."""

    rotations: Float64Array
    """(k, 3, 3), orthogonal; of determinant −1 for reflections."""
    scales: Float64Array
    """(k,)."""
    shifts: Float64Array
    """(k, 3)."""

    @classmethod
    def centred(cls, rotations: Float64Array, scale: float) -> Poses:
        """Poses that take centroid to centroid."""
        return cls(rotations, np.full(len(rotations), scale), np.zeros((len(rotations), 3)))

    @classmethod
    def joined(cls, *parts: Poses) -> Poses:
        """All poses of several, one after the other."""
        return cls(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("rotations", "scales", "shifts"))
        )

    def __len__(self) -> int:
        return len(self.scales)

    def take(self, index: IntArray | list[int]) -> Poses:
        """Some of the poses, in the order of ``index``."""
        return Poses(self.rotations[index], self.scales[index], self.shifts[index])

    def apply(self, points: Float64Array) -> Float64Array:
        """Points (n, 3) or (k, n, 3) by every pose: (k, n, 3)."""
        turned = points @ np.swapaxes(self.rotations, 1, 2)
        return np.asarray(self.scales[:, None, None] * turned + self.shifts[:, None])

    def undo(self, points: Float64Array) -> Float64Array:
        """Points (n, 3) of the target's frame in the source's, for every pose: (k, n, 3)."""
        return np.asarray((points - self.shifts[:, None]) @ self.rotations / self.scales[:, None, None])


@dataclass(frozen=True, eq=False)
class Pairs:
    """Closest points, first from the source's probes to the target, then from the target's probes to the source."""

    place: Float64Array
    """(k, 2m, 3) points of the moved source."""
    gap: Float64Array
    """(k, 2m, 3) from the target to them."""
    normal: Float64Array
    """(k, 2m, 3) of the surface that was searched; zero where unknown."""
    spacing: Float64Array
    """(k, 2m) of the samples of the surface that was searched, there."""

    @classmethod
    def of(cls, source: Side, target: Side, poses: Poses, probes: int) -> Pairs:
        """Search with the first ``probes`` of both sides."""
        there = poses.apply(source.probes[:probes])
        found = target.tree.query(there)[1]
        asking = target.probes[:probes]
        back = source.tree.query(poses.undo(asking))[1]
        met = poses.apply(source.nodes[back])
        return cls(
            place=np.concatenate((there, met), axis=1),
            gap=np.concatenate((there - target.nodes[found], met - asking), axis=1),
            normal=np.concatenate(
                (target.normals[found], source.normals[back] @ np.swapaxes(poses.rotations, 1, 2)), axis=1
            ),
            spacing=np.concatenate((target.spacings[found], source.spacings[back] * poses.scales[:, None]), axis=1),
        )

    @property
    def distance(self) -> Float64Array:
        """(k, 2m) to the surface of which the samples are known.

        The distance to the tangent plane; along it, only what is more than twice the spacing counts.
        """
        height = _dot(self.gap, self.normal) ** 2
        along = np.maximum(_dot(self.gap, self.gap) - height - (2 * self.spacing) ** 2, 0)
        return np.asarray(np.sqrt(height + along))


def refine(
    source: Side, target: Side, poses: Poses, *, probes: int, steps: int, scaling: bool, reach: float = REACH
) -> Poses:
    """Bring surfaces closer: Gauss–Newton on distances to the other's tangent planes, from both sides.

    Pairs farther apart than ``reach``, or than three times the typical distance, weigh nothing (Tukey's weights), so
    that what one surface lacks of the other does not pull.

    Args:
        source: What moves.
        target: What stays.
        poses: Where to begin.
        probes: How many samples of each side search.
        steps: At most so many.
        scaling: Whether scales change, too.
        reach: Longest distance of a pair in RMS radii.
    """
    moving = np.arange(len(poses))
    rotations, scales, shifts = poses.rotations.copy(), poses.scales.copy(), poses.shifts.copy()
    for _ in range(steps):
        now = Poses(rotations[moving], scales[moving], shifts[moving])
        matrix, right = _normal_equations(Pairs.of(source, target, now, probes), reach)
        step = _solved(matrix, right, scaling)
        turned, factor = exponential(step[:, :3]), np.exp(step[:, 6])
        rotations[moving] = turned @ now.rotations
        scales[moving] = factor * now.scales
        shifts[moving] = factor[:, None] * np.einsum("kij,kj->ki", turned, now.shifts) + step[:, 3:6]
        moving = moving[np.abs(step).max(axis=1) > _STEP_TOLERANCE]
        if not len(moving):
            break
    return Poses(rotations, scales, shifts)


def weakest_axis(source: Side, target: Side, pose: Poses, *, probes: int) -> Float64Array:
    """Return the axis (3,) about which turning the source in its first pose brings the surfaces apart least."""
    matrix, _ = _normal_equations(Pairs.of(source, target, pose, probes), REACH)
    return np.asarray(np.linalg.eigh(matrix[0, :3, :3])[1][:, 0])


def _normal_equations(pairs: Pairs, reach: float) -> tuple[Float64Array, Float64Array]:
    """Matrices (k, 7, 7) and right sides (k, 7) for turns, shifts and growths, in this order about the origin."""
    distance = np.sqrt(_dot(pairs.gap, pairs.gap))
    limit = np.clip(_PAIR_LIMIT * np.median(distance, axis=1), _LEAST_PAIR_LIMIT, reach)[:, None]
    weight = np.maximum(1 - (distance / limit) ** 2, 0) ** 2
    place, gap, normal = pairs.place, pairs.gap, pairs.normal
    # |n·gap|² to the tangent plane and, weighing less, |gap|² to the point: a row each and three.
    plane = np.concatenate((np.cross(place, normal), normal, _dot(place, normal)[..., None]), axis=2)
    point = np.zeros((*place.shape, 7))
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):  # place moves by turn × place + shift + growth · place
        point[..., j, axis] = place[..., i]
        point[..., i, axis] = -place[..., j]
        point[..., axis, 3 + axis] = 1
    point[..., 6] = place
    rows = np.concatenate((plane[:, :, None], point), axis=2)
    residual = np.concatenate((_dot(gap, normal)[..., None], gap), axis=2)
    weights = weight[..., None] * np.array([1.0, _POINT_WEIGHT, _POINT_WEIGHT, _POINT_WEIGHT])
    rows, residual, weights = (array.reshape(len(place), 4 * place.shape[1], -1) for array in (rows, residual, weights))
    weighted = np.swapaxes(rows * weights, 1, 2)
    return weighted @ rows, (weighted @ residual)[..., 0]


def _solved(matrix: Float64Array, right: Float64Array, scaling: bool) -> Float64Array:
    """The step (k, 7) downhill; directions in which nothing holds are left alone."""
    free = 7 if scaling else 6
    matrix, right = matrix[:, :free, :free], right[:, :free]
    strength = _DAMPING * np.trace(matrix, axis1=1, axis2=2) + np.finfo(np.float64).tiny
    step = np.zeros((len(right), 7))
    step[:, :free] = -np.linalg.solve(matrix + strength[:, None, None] * np.eye(free), right[..., None])[..., 0]
    return step


def _dot(first: Float64Array, second: Float64Array) -> Float64Array:
    return np.asarray(np.einsum("...i,...i->...", first, second))
