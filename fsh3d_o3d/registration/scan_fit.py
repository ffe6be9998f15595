"""How two scans touch: the samples of a scan, contact of one with another, and a closer fit of what is in contact.

The fit of whole shapes weighs all of both surfaces; scans share a part only, so here nothing counts but what is in
contact: near, in the direction of the normal, and facing the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry import MeshArrays, PointArrays, area_samples, evenly_thinned, triangle_normals
from fsh3d_o3d.sphere import exponential

_SAMPLES = 4096  # of each scan, spread by area; a choice between time and what is resolved
_PROBES = 1024  # of these that search the other scan in the fit
_NEIGHBOURS = 10  # samples whose plane gives a normal; fewer follow noise, more cut corners
_NORMAL_AGREEMENT = 0.7  # cosine, 45°: surfaces in contact face the same way, but for noise and edges
_FLIPPED_AT_MOST = 0.1  # share of neighbouring normals that may differ in sign where normals tell inside from outside
_CONTACT_HEIGHT = 0.6  # spacings along the normal within which surfaces are in contact
_CONTACT_NOISE = 3.0  # the same in standard deviations of both scans' noise, where that is more
_APPROACH = 8.0  # contact heights within which surfaces that face each other should be in contact
_APPROACH_ASIDE = 1.0  # spacings along the surface for that, so that borders do not count
_CONTACT_REACH = 2.0  # spacings along the surface to the nearest sample of it
_IN_FRONT = 3.0  # spacings before what a camera saw from which a point would have hidden it
_SEEN_WITHIN = 2.0  # spacings, as the camera sees them: farther from all it saw, nothing is known
_SCHEDULE = (8.0, 8.0, 5.0, 5.0, 3.0, 3.0, 2.0, 2.0, 2.0, 2.0)  # spacings: reach of pairs in each step of the fit
_POINT_WEIGHT = 0.05  # of distances to points beside those to planes, so that flat parts do not slide freely
_DAMPING = 1e-6  # of the trace of the normal equations: directions that no pair holds stay where they are
_FEWEST_PAIRS = 12  # in contact; fewer do not hold six unknowns against noise
_LEAST_VARIANCE = 0.05  # spacings squared; what samples resolve of a distance, for the weight of a pair of scans


@dataclass(frozen=True, eq=False)
class ScanSamples:
    """Samples of one scan, about its centre, in units that all scans of a set have in common."""

    points: Float64Array
    """(n, 3) spread by area."""
    normals: Float64Array
    """(n, 3) of length one, zero where unknown."""
    sided: bool
    """Whether normals tell inside from outside."""
    spacing: float
    """How far samples usually are apart."""
    noise: float
    """How far samples usually lie off the plane of those around them: by noise, and by curvature."""
    tree: cKDTree
    """Of the points."""
    viewpoint: Float64Array | None
    """(3,) where the camera stood, or None."""
    directions: cKDTree | None
    """Of the directions from the viewpoint to the points."""
    depths: Float64Array | None
    """(n,) distances from the viewpoint."""

    @classmethod
    def of(cls, geometry: MeshArrays | PointArrays, viewpoint: Float64Array | None) -> ScanSamples:
        """Return the samples of a scan whose camera stood at ``viewpoint``, if that is known."""
        cloud = _sampled(geometry)
        points = cloud.points
        tree = cKDTree(points)
        count = min(_NEIGHBOURS, len(points) - 1)
        distance, index = (np.asarray(part).reshape(len(points), -1) for part in tree.query(points, k=count + 1))
        around = points[index] - points[index].mean(axis=1, keepdims=True)
        spread, axes = np.linalg.eigh(np.matmul(around.transpose(0, 2, 1), around) / (count + 1))
        normals = axes[:, :, 0]
        noise = float(np.median(np.sqrt(np.maximum(spread[:, 0], 0))))
        sided = False
        if viewpoint is not None:
            normals = np.where(_dot(normals, viewpoint - points)[:, None] < 0, -normals, normals)
            sided = True
        elif cloud.normals is not None:
            along = _dot(normals, cloud.normals)
            normals = np.where(along[:, None] < 0, -normals, normals)
            nearest = index[:, min(1, count)]
            sided = bool(np.mean(_dot(normals, normals[nearest]) < 0) <= _FLIPPED_AT_MOST)
        directions = depths = None
        if viewpoint is not None:
            depths = np.linalg.norm(points - viewpoint, axis=1)
            directions = cKDTree((points - viewpoint) / np.where(depths > 0, depths, 1)[:, None])
        spacing = float(np.median(distance[:, min(1, count)]))
        return cls(points, normals, sided, spacing, noise, tree, viewpoint, directions, depths)

    def probes(self, most: int) -> slice:
        """Samples that search, at most about so many, spread like all of them."""
        return slice(None, None, max(1, -(-len(self.points) // most)))


@dataclass(frozen=True, eq=False)
class Contact:
    """How one scan touches another in a given pose."""

    overlap: tuple[float, float]
    """Share of the source in contact with the target, and of the target with the source."""
    agreement: float
    """Share in contact of what comes close to the other scan: near 1 for right poses; 0 where nothing comes close."""
    hidden: float | None
    """Largest share of one scan in front of what the other's camera saw; None where no viewpoint is known."""
    rmse: float
    """Root mean square distance of what is in contact, along the normals."""
    information: Float64Array
    """(6, 6) of the pose in the source's frame, turns before shifts: how firmly what is in contact holds it."""

    @property
    def mean_overlap(self) -> float:
        """Geometric mean of both shares: a part wholly within a whole is more than chance, whatever their sizes."""
        return float(np.sqrt(self.overlap[0] * self.overlap[1]))

    @property
    def firmness(self) -> float:
        """How much less firmly the loosest direction is held than the firmest; near 0 where scans slide."""
        values = np.linalg.eigvalsh(self.information)
        return float(max(values[0], 0) / values[-1]) if values[-1] > 0 else 0.0


@dataclass(frozen=True, eq=False)
class _Pairs:
    place: Float64Array  # (m, 3) moved samples of the source
    gap: Float64Array  # (m, 3) from the target to them
    normal: Float64Array  # (m, 3) of the scan that was searched
    facing: Float64Array  # (m,) cosine between the normals, of either sign where sides are not known
    searching: NDArray[np.bool_]  # (m,) whether the source searched


def measured_contact(source: ScanSamples, target: ScanSamples, pose: Float64Array) -> Contact:
    """Return how the source, moved by ``pose`` (4, 4), touches the target."""
    pairs = _paired(source, target, pose, _PROBES)
    spacing = max(source.spacing, target.spacing)
    height = _contact_height(source, target)
    off = _dot(pairs.gap, pairs.normal)
    aside = np.sqrt(np.maximum(_dot(pairs.gap, pairs.gap) - off**2, 0))
    facing = pairs.facing >= _NORMAL_AGREEMENT
    touching = (np.abs(off) <= height) & (aside <= _CONTACT_REACH * spacing) & facing
    close = (np.abs(off) <= _APPROACH * height) & (aside <= _APPROACH_ASIDE * spacing)
    there = [touching[pairs.searching], touching[~pairs.searching]]
    variance = float(np.mean(off[touching] ** 2)) if touching.any() else 0.0
    rows, _ = _rows(pairs, touching, np.asarray(np.linalg.inv(pose)))
    # As many independent measurements as there are samples in contact, each as good as the distances are small.
    weight = len(source.points) / max(len(there[0]), 1) / 2 / max(variance, _LEAST_VARIANCE * spacing**2)
    return Contact(
        overlap=(float(there[0].mean()), float(there[1].mean())),
        agreement=float(np.mean(touching[close])) if np.count_nonzero(close) >= _FEWEST_PAIRS else 0.0,
        hidden=hidden_share(source, target, pose),
        rmse=float(np.sqrt(variance)),
        information=weight * rows.T @ rows,
    )


def fitted(source: ScanSamples, target: ScanSamples, pose: Float64Array, *, near: bool = False) -> Float64Array:
    """Return ``pose`` (4, 4) after Gauss–Newton on the distances of what is in contact, from both sides.

    Args:
        source: What moves.
        target: What stays.
        pose: Where to begin.
        near: Whether it is a good pose already: pairs reach no farther than in the last steps.
    """
    pose = pose.copy()
    spacing = max(source.spacing, target.spacing)
    for reach in _SCHEDULE[len(_SCHEDULE) // 2 :] if near else _SCHEDULE:
        pairs = _paired(source, target, pose, _PROBES)
        weight = _weights(pairs, spacing * reach)
        used = weight > 0
        if np.count_nonzero(used) < _FEWEST_PAIRS:
            break
        rows, residual = _rows(pairs, used, None)
        scale = np.sqrt(weight[used])
        point = _POINT_WEIGHT * weight[used]
        place, gap = pairs.place[used], pairs.gap[used]
        matrix = (rows * scale[:, None]).T @ (rows * scale[:, None])
        right = (rows * scale[:, None]).T @ (residual * scale)
        # Distances to points: d(place) = turn × place + shift.
        matrix += _point_matrix(place, point)
        right += np.concatenate(((point[:, None] * np.cross(place, gap)).sum(axis=0), point @ gap))
        step = -np.linalg.solve(matrix + _DAMPING * np.trace(matrix) * np.eye(6), right)
        move = np.eye(4)
        move[:3, :3] = exponential(step[None, :3])[0]
        move[:3, 3] = step[3:]
        pose = move @ pose
    return pose


def hidden_share(source: ScanSamples, target: ScanSamples, pose: Float64Array) -> float | None:
    """Return the largest share of one scan in front of what the other's camera saw; None without viewpoints."""
    spacing = max(source.spacing, target.spacing)
    shares = (
        _hidden_share(source, target, pose, spacing),
        _hidden_share(target, source, np.asarray(np.linalg.inv(pose)), spacing),
    )
    return max((share for share in shares if share is not None), default=None)


def _sampled(geometry: MeshArrays | PointArrays) -> PointArrays:
    if isinstance(geometry, PointArrays):
        return evenly_thinned(geometry, _SAMPLES)
    points, owner = area_samples(geometry, _SAMPLES)
    return PointArrays(points, triangle_normals(geometry.vertices[geometry.triangles[owner]]))


def _paired(source: ScanSamples, target: ScanSamples, pose: Float64Array, probes: int) -> _Pairs:
    turn, shift = pose[:3, :3], pose[:3, 3]
    first, second = source.probes(probes), target.probes(probes)
    there = source.points[first] @ turn.T + shift
    found = target.tree.query(there)[1]
    asking = target.points[second]
    back = source.tree.query((asking - shift) @ turn)[1]
    met = source.points[back] @ turn.T + shift
    own = np.concatenate((source.normals[first], source.normals[back])) @ turn.T
    other = np.concatenate((target.normals[found], target.normals[second]))
    facing = _dot(own, other)
    return _Pairs(
        place=np.concatenate((there, met)),
        gap=np.concatenate((there - target.points[found], met - asking)),
        normal=np.concatenate((target.normals[found], own[len(there) :])),
        facing=facing if source.sided and target.sided else np.abs(facing),
        searching=np.arange(len(facing)) < len(there),
    )


def _contact_height(source: ScanSamples, target: ScanSamples) -> float:
    """Along the normal, within which surfaces are in contact."""
    spacing = max(source.spacing, target.spacing)
    return max(_CONTACT_HEIGHT * spacing, _CONTACT_NOISE * float(np.hypot(source.noise, target.noise)))


def _weights(pairs: _Pairs, reach: float) -> Float64Array:
    """Tukey's weights of the distances, none for what faces another way."""
    squared = _dot(pairs.gap, pairs.gap) / reach**2
    return np.asarray(np.maximum(1 - squared, 0) ** 2 * (pairs.facing >= _NORMAL_AGREEMENT))


def _rows(pairs: _Pairs, used: NDArray[np.bool_], back: Float64Array | None) -> tuple[Float64Array, Float64Array]:
    """Derivatives (m, 6) of the distances to planes by turns and shifts, and these distances.

    In the frame of the target, or in that which ``back`` (4, 4) leads to from there.
    """
    place, normal = pairs.place[used], pairs.normal[used]
    residual = _dot(pairs.gap[used], normal)
    if back is not None:
        place, normal = place @ back[:3, :3].T + back[:3, 3], normal @ back[:3, :3].T
    return np.concatenate((np.cross(place, normal), normal), axis=1), residual


def _point_matrix(place: Float64Array, weight: Float64Array) -> Float64Array:
    """(6, 6) normal equations of distances to points."""
    matrix = np.zeros((6, 6))
    first, second = weight @ place, (place * weight[:, None]).T @ place
    matrix[:3, :3] = np.trace(second) * np.eye(3) - second
    skew = np.array([[0, -first[2], first[1]], [first[2], 0, -first[0]], [-first[1], first[0], 0]])
    matrix[:3, 3:], matrix[3:, :3] = skew, skew.T
    matrix[3:, 3:] = weight.sum() * np.eye(3)
    return matrix


def _hidden_share(seen: ScanSamples, camera: ScanSamples, pose: Float64Array, spacing: float) -> float | None:
    """Share of one scan, moved by ``pose`` and within the other camera's picture, in front of what that one saw."""
    if camera.viewpoint is None or camera.directions is None or camera.depths is None:
        return None
    offset = seen.points[seen.probes(_PROBES)] @ pose[:3, :3].T + pose[:3, 3] - camera.viewpoint
    depth = np.linalg.norm(offset, axis=1)
    usual = float(np.median(camera.depths)) or 1.0
    angle, index = camera.directions.query(
        offset / np.where(depth > 0, depth, 1)[:, None], distance_upper_bound=_SEEN_WITHIN * spacing / usual
    )
    inside = np.isfinite(angle)
    if np.count_nonzero(inside) < _FEWEST_PAIRS:
        return 0.0
    before = camera.depths[np.where(inside, index, 0)] - depth > _IN_FRONT * spacing
    return float(np.mean(before[inside]))


def _dot(first: Float64Array, second: Float64Array) -> Float64Array:
    return np.asarray(np.einsum("...i,...i->...", first, second))
