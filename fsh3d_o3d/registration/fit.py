"""Similarity alignment by closest points from both sides, several poses at once.

Open3D's ICP adds up its sums in threads, so that its last digits change from run to run, moves one pose at a time, and
knows no scale where distances are to tangent planes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import Surface
from fsh3d_o3d.sphere import exponential

REACH = 0.3
"""RMS radii; what is farther from the other surface counts as this far, whatever it is."""
_POINT_WEIGHT = 0.01  # of distances to points beside those to tangent planes, so that flat parts do not slide freely
_STEP_TOLERANCE = 1e-5  # radians and RMS radii; a step below it, far below what samples resolve, ends the iteration
_DAMPING = 1e-6  # of the trace of the normal equations: directions that no pair holds stay where they are
_PAIR_LIMIT = 3.0  # median distances; pairs farther apart do not count
_LEAST_PAIR_LIMIT = 0.05  # RMS radii; the spacing of the samples is no reason to drop a pair
_SPACING_NODES = 256  # nodes whose distances tell how far apart all are; a choice
_NORMAL_NEIGHBOURS = 16  # points: fewer follow noise, more round off edges
_ASIDE = 1.3  # spacings along the surface to the nearest sample; more where the other surface has ended
_FACING = 0.5  # least cosine between normals of surfaces that may be the same
_LEAF = 32  # points; fewer take longer to build and not less to search
_GOLDEN_RATIO = 0.6180339887498949  # (√5 − 1)/2, whose multiples mod 1 leave the most even gaps


def search_tree(points: Float64Array) -> cKDTree:
    """Return a tree that is built quickly: it is searched a few thousand times at most."""
    return cKDTree(points, leafsize=_LEAF, balanced_tree=False, compact_nodes=False)


@dataclass(frozen=True, eq=False)
class Side:
    """One of two surfaces in its own frame, to be searched and to search from."""

    nodes: Float64Array
    """(n, 3) samples that are found."""
    normals: Float64Array
    """(n, 3) unit normals at the nodes, zero where unknown."""
    spacings: Float64Array
    """(n,) how far samples are apart around each node."""
    order: IntArray
    """(m,) indices of the nodes that search, spread by area; so is every beginning of them."""
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
        tree = search_tree(surface.points)
        some = surface.points[:: max(1, len(surface.points) // _SPACING_NODES)]
        usual = float(np.median(np.asarray(tree.query(some, k=2)[0])[:, 1]))
        sparse = np.maximum(surface.weights / np.median(surface.weights), 1)
        return cls(surface.points, normals, usual * np.sqrt(sparse), chosen, tree)

    @classmethod
    def thinned(cls, points: Float64Array, spacing: float) -> Side:
        """Return the side of a cloud (n, 3) with a point and a normal in each cube of edge ``spacing``."""
        o3d = open3d()
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(spacing)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(_NORMAL_NEIGHBOURS))
        nodes = np.array(cloud.points)
        order = np.argsort(np.mod(np.arange(len(nodes)) * _GOLDEN_RATIO, 1.0))
        return cls(nodes, np.array(cloud.normals), np.full(len(nodes), spacing), order, search_tree(nodes))

    @functools.cached_property
    def probes(self) -> Float64Array:
        """(m, 3) the nodes that search."""
        return self.nodes[self.order]

    @functools.cached_property
    def extent(self) -> float:
        """Root mean square distance of the nodes from their mean."""
        return float(np.sqrt(np.var(self.nodes, axis=0).sum()))

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

    def inverse(self) -> Poses:
        """The maps back from the target's frame to the source's."""
        rotations = np.swapaxes(self.rotations, 1, 2)
        shifts = -np.einsum("kij,kj->ki", rotations, self.shifts) / self.scales[:, None]
        return Poses(rotations, 1 / self.scales, shifts)

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
    def of(
        cls, source: Side, target: Side, poses: Poses, probes: int, *, reach: float = np.inf, back: bool = True
    ) -> Pairs:
        """Search with the first ``probes`` of both sides, or without ``back`` of the source alone.

        What is as far as ``reach`` or farther has no counterpart: its gap is that long, and it has no normal.
        """
        there = poses.apply(source.probes[:probes])
        found, far = nearest_nodes(target.tree, there, reach)
        place, gap = there, there - target.nodes[found]
        normal, spacing = target.normals[found], target.spacings[found]
        if back:
            asking = target.probes[:probes]
            met, out = nearest_nodes(source.tree, poses.undo(asking), reach / poses.scales.max())
            beside = poses.apply(source.nodes[met])
            turned = source.normals[met] @ np.swapaxes(poses.rotations, 1, 2)
            place, gap = np.concatenate((place, beside), axis=1), np.concatenate((gap, beside - asking), axis=1)
            normal = np.concatenate((normal, turned), axis=1)
            spacing = np.concatenate((spacing, source.spacings[met] * poses.scales[:, None]), axis=1)
            far = np.concatenate((far, out), axis=1)
        if far.any():
            gap[far], normal[far] = (reach, 0, 0), 0
        return cls(place, gap, normal, spacing)

    @property
    def distance(self) -> Float64Array:
        """(k, 2m) to the surface of which the samples are known.

        The distance to the tangent plane; along it, only what is more than twice the spacing counts.
        """
        height = _dot(self.gap, self.normal) ** 2
        along = np.maximum(_dot(self.gap, self.gap) - height - (2 * self.spacing) ** 2, 0)
        return np.asarray(np.sqrt(height + along))


def refine(source: Side, target: Side, poses: Poses, *, probes: int, steps: int, scaling: bool) -> Poses:
    """Bring surfaces closer: Gauss–Newton on distances to the other's tangent planes, from both sides.

    Pairs farther apart than ``REACH``, or than three times the typical distance, weigh nothing (Tukey's weights), so
    that what one surface lacks of the other does not pull.

    Args:
        source: What moves.
        target: What stays.
        poses: Where to begin.
        probes: How many samples of each side search.
        steps: At most so many.
        scaling: Whether scales change, too.
    """
    return _descended(poses, [lambda now: _usual_pairs(source, target, now, probes)] * steps, scaling)


def refine_parts(source: Side, target: Side, poses: Poses, *, probes: int, reaches: Sequence[float]) -> Poses:
    """Bring surfaces closer that share an unknown part, without changing sizes: pairs within ``reaches`` count.

    The smaller surface searches the larger one, because most of it should have a counterpart.

    Args:
        source: What moves.
        target: What stays.
        poses: Where to begin.
        probes: How many samples of the smaller side search.
        reaches: Longest distance of a pair in each step.
    """
    if len(source.nodes) > len(target.nodes):
        return refine_parts(target, source, poses.inverse(), probes=probes, reaches=reaches).inverse()

    steps = [functools.partial(parts_pairs, source, target, probes=probes, reach=reach) for reach in reaches]
    return _descended(poses, steps, scaling=False)


_Paired = Callable[[Poses], tuple[Pairs, Float64Array]]


def _descended(poses: Poses, paired: Sequence[_Paired], scaling: bool) -> Poses:
    """Poses after one Gauss–Newton step on each of the pairs; those that have come to rest stay."""
    moving = np.arange(len(poses))
    rotations, scales, shifts = poses.rotations.copy(), poses.scales.copy(), poses.shifts.copy()
    for pairs in paired:
        now = Poses(rotations[moving], scales[moving], shifts[moving])
        matrix, right = _normal_equations(*pairs(now))
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
    matrix, _ = _normal_equations(*_usual_pairs(source, target, pose, probes))
    return np.asarray(np.linalg.eigh(matrix[0, :3, :3])[1][:, 0])


def parts_pairs(source: Side, target: Side, poses: Poses, probes: int, reach: float) -> tuple[Pairs, Float64Array]:
    """Pairs from the source alone that may be the same surface, and how far apart (k,) they count.

    Where the nearest node is not across but beside, the other surface has ended.
    """
    pairs = Pairs.of(source, target, poses, probes, reach=reach, back=False)
    height = _dot(pairs.gap, pairs.normal)
    turned = source.normals[source.order[:probes]] @ np.swapaxes(poses.rotations, 1, 2)
    other = _dot(pairs.gap, pairs.gap) - height**2 > (_ASIDE * pairs.spacing) ** 2
    other |= np.abs(_dot(turned, pairs.normal)) < _FACING
    pairs.gap[other], pairs.normal[other] = (reach, 0, 0), 0
    return pairs, np.full(len(poses), reach)


def _usual_pairs(source: Side, target: Side, poses: Poses, probes: int) -> tuple[Pairs, Float64Array]:
    """Pairs of surfaces that are whole, and how far apart (k,) they count: a few times as far as usual."""
    pairs = Pairs.of(source, target, poses, probes)
    usual = np.median(np.sqrt(_dot(pairs.gap, pairs.gap)), axis=1)
    return pairs, np.clip(_PAIR_LIMIT * usual, _LEAST_PAIR_LIMIT, REACH)


def _normal_equations(pairs: Pairs, limits: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Matrices (k, 7, 7) and right sides (k, 7) for turns, shifts and growths, in this order about the origin.

    Pairs weigh less the farther they are apart (Tukey's weights), nothing from ``limits`` (k,) on.
    """
    place, gap, normal = pairs.place, pairs.gap, pairs.normal
    weight = np.maximum(1 - _dot(gap, gap) / limits[:, None] ** 2, 0) ** 2
    # |n·gap|² to the tangent plane: a row of seven each.
    rows = np.concatenate((np.cross(place, normal), normal, _dot(place, normal)[..., None]), axis=2)
    weighted = np.swapaxes(rows * weight[..., None], 1, 2)
    matrix, right = weighted @ rows, (weighted @ _dot(gap, normal)[..., None])[..., 0]
    # |gap|² to the point, weighing less: place moves by turn × place + shift + growth · place, whose sums are known.
    weight = _POINT_WEIGHT * weight
    held = weight[..., None] * place
    second = np.swapaxes(held, 1, 2) @ place
    growth = np.trace(second, axis1=1, axis2=2)
    first = held.sum(axis=1)
    matrix[:, :3, :3] += growth[:, None, None] * np.eye(3) - second
    matrix[:, :3, 3:6] += _cross_matrix(first)
    matrix[:, 3:6, :3] -= _cross_matrix(first)
    matrix[:, 3:6, 3:6] += weight.sum(axis=1)[:, None, None] * np.eye(3)
    matrix[:, 3:6, 6] += first
    matrix[:, 6, 3:6] += first
    matrix[:, 6, 6] += growth
    pull = np.swapaxes(held, 1, 2) @ gap  # Σ w pᵢ gⱼ: its antisymmetric part turns, its trace grows
    right[:, :3] += np.stack([pull[:, i, j] - pull[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    right[:, 3:6] += (weight[:, None] @ gap)[:, 0]
    right[:, 6] += np.trace(pull, axis1=1, axis2=2)
    return matrix, right


def nearest_nodes(tree: cKDTree, points: Float64Array, reach: float) -> tuple[IntArray, NDArray[np.bool_]]:
    """Nearest nodes of points (…, 3), and which have none within reach; those get the first one."""
    index = np.asarray(tree.query(points, distance_upper_bound=reach)[1])
    far = index == tree.n
    return np.where(far, 0, index), far


def _cross_matrix(vector: Float64Array) -> Float64Array:
    """Matrices (k, 3, 3) that multiply by vectors (k, 3) as the cross product does."""
    return np.cross(vector[:, None], -np.eye(3))


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
