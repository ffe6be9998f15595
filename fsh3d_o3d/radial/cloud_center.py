"""A centre for a point cloud: where its radial function should start from."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import PointArrays, thinned
from fsh3d_o3d.radial.angular_cells import AngularCells
from fsh3d_o3d.radial.robust_fit import tukey
from fsh3d_o3d.radial.scattered_fit import fit_medians, voxel_counts
from fsh3d_o3d.sphere import evaluate, fibonacci_grid

_BANDWIDTH = 8  # of the body that is fitted: enough for its proportions, low enough to bridge holes; a choice
_MOST_POINTS = 200_000  # that are looked at: the fit takes 25,000 of them, the others tell where points are dense
_MOST_ROUNDS = 30  # moves of the centre: of 30,000 points it rests after five, of 3,000 it may wander to the end
_VOXELS = 64  # in eight median radii: an eighth of one each, a choice
_CELLS = 192  # of 15 degrees, on which radii are compared: a choice between detail and points in each


def cloud_center(cloud: PointArrays) -> Float64Array:
    """Estimate the centre of the body whose surface a cloud samples: the centroid of the volume inside.

    A radial function of low degree is fitted robustly to medians of angular cells, and the centre moves to the centroid
    of the fitted body, until it rests. Density does not matter, since each cell counts once; holes are filled smoothly
    and outliers lose against the medians. Where the cloud covers only part of the sphere the fit guesses the rest.

    Args:
        cloud: Points, with or without normals. Normals give one of the places to start from, the point nearest to all
            lines along them, and may be wrong.

    Returns:
        (3,) the centre.

    Raises:
        GeometryError: Fewer than 4 points, or all points coincide.
    """
    chosen = _chosen(cloud.points)
    points, offset, scale = _unit_frame(cloud.points[chosen])
    starts = [np.zeros(3), *_extents(points), _sphere_center(points)]
    if cloud.normals is not None:
        starts.append(_nearest_to_lines(points, cloud.normals[chosen]))
    center = min(starts, key=lambda start: _unevenness(points - start))
    density = voxel_counts(points)
    nodes = fibonacci_grid(6 * (_BANDWIDTH + 2) ** 2)
    for _ in range(_MOST_ROUNDS):
        relative = points - center
        radii = np.linalg.norm(relative, axis=1)
        unit = float(np.median(radii)) or float(radii.max())
        used = radii > 1e-6 * unit
        directions = relative[used] / radii[used, None]
        values = np.minimum(radii[used] / unit, 100.0)
        fitted = evaluate(fit_medians(directions, values, _BANDWIDTH, density[used], threads=1), nodes, threads=1)
        fitted = np.clip(fitted, 0.05, float(np.quantile(values, 0.99)))
        # Centroid of the star-shaped body: ∫ r⁴/4 ω dω over ∫ r³/3 dω, equal weights on the Fibonacci grid.
        move = unit * 0.75 * (fitted**4 @ nodes.directions) / (fitted**3).sum()
        center = center + move
        if np.linalg.norm(move) <= 1e-4 * unit:
            break
    return np.asarray(offset + scale * center)


def _unit_frame(points: Float64Array) -> tuple[Float64Array, Float64Array, float]:
    """Points moved to their median and scaled by their median distance from it; the median and the distance."""
    if len(points) < 4:
        raise GeometryError(f"a centre needs at least 4 points, got {len(points)}")
    # Quarters do not overflow, and medians do not mind far outliers.
    offset = np.median(points / 4, axis=0)
    relative = points / 4 - offset
    size = np.abs(relative).max(axis=1)
    scale = float(np.median(size)) or float(size.max())
    # Rounding of a far offset is no extent.
    if scale <= 1e-15 * float(np.abs(offset).max()):
        raise GeometryError(f"all {len(points)} points coincide: there is no surface to be inside of")
    return np.clip(relative, -1e3 * scale, 1e3 * scale) / scale, 4 * offset, 4 * scale


def _chosen(points: Float64Array) -> IntArray:
    """Which points to use: all, or of many a part, the same whatever their order and pose."""
    everything = np.arange(len(points))
    if len(points) <= _MOST_POINTS:
        return everything
    chosen = thinned(points, _MOST_POINTS)
    return chosen if len(chosen) >= _MOST_POINTS // 4 else everything  # which are copies of few


def _extents(points: Float64Array) -> list[Float64Array]:
    """Middles between low and high quantiles of each coordinate: less drawn to where points are dense than medians."""
    return [np.quantile(points, [q, 1 - q], axis=0).mean(axis=0) for q in (0.01, 0.05, 0.15)]


def _sphere_center(points: Float64Array) -> Float64Array:
    """Centre of the algebraic sphere through voxels full enough not to be outliers (|x|² = 2 c·x + d)."""
    voxel = np.floor(np.clip(points, -4, 4) * _VOXELS / 8).astype(np.int64)
    key = ((voxel[:, 0] * 4 * _VOXELS) + voxel[:, 1]) * 4 * _VOXELS + voxel[:, 2]
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    full = count >= 0.15 * np.median(count[index])
    means = np.stack([np.bincount(index, axis) for axis in points.T], axis=1)[full] / count[full, None]
    system = np.column_stack([2 * means, np.ones(len(means))])
    weights = np.ones(len(means))
    center = np.zeros(3)
    for _ in range(10):
        # Least squares with a trace of damping, for points in a plane have no such sphere.
        normal = system.T @ (weights[:, None] * system) + 1e-6 * len(means) * np.eye(4)
        center = np.linalg.solve(normal, system.T @ (weights * np.square(means).sum(axis=1)))[:3]
        radii = np.linalg.norm(means - center, axis=1)
        off = radii - np.median(radii)
        weights = tukey(off, max(1e-6, 1.4826 * float(np.median(np.abs(off)))))
    return np.clip(center, -10, 10)


def _nearest_to_lines(points: Float64Array, normals: Float64Array) -> Float64Array:
    """Point nearest to the lines through the points along their normals, lines far off counting less."""
    length = np.linalg.norm(normals, axis=1)
    usable = np.isfinite(length) & (length > 0)
    if usable.sum() < 4:
        return np.zeros(3)
    lines, places = normals[usable] / length[usable, None], points[usable]
    weights, center = np.ones(len(lines)), np.zeros(3)
    for _ in range(6):
        # Sum of w (I − n nᵀ)(c − p) = 0.
        along = np.einsum("ij,ij->i", lines, places)
        system = weights.sum() * np.eye(3) - (weights[:, None] * lines).T @ lines
        right = weights @ places - (weights * along) @ lines
        center = np.linalg.solve(system + 1e-9 * len(lines) * np.eye(3), right)
        relative = center - places
        off = np.linalg.norm(relative - np.einsum("ij,ij->i", relative, lines)[:, None] * lines, axis=1)
        weights = 1 / (1 + np.square(off / max(1e-6, float(np.median(off)))))
    return np.clip(center, -10, 10)


def _unevenness(relative: Float64Array) -> float:
    """How far the surface is from a sphere about the origin: scatter of log radii over cells, and cells left empty."""
    radii = np.linalg.norm(relative, axis=1)
    used = radii > 1e-12  # closer, in a cloud of size 1, a point has no direction to speak of
    if not used.any():
        return np.inf
    cells = AngularCells.of(relative[used] / radii[used, None], _CELLS)
    medians = cells.medians(np.log(radii[used]))
    scatter = float(np.median(np.abs(medians - np.median(medians))))
    return scatter + 1 - len(medians) / cells.total
