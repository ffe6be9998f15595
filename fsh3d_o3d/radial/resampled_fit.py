"""Radial functions resampled to the Fibonacci grid by robust local estimates, then transformed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.radial.angular_cells import AngularCells
from fsh3d_o3d.radial.robust_fit import bending, likely_penalty, robust_scale, solve, tukey
from fsh3d_o3d.radial.scattered_fit import (
    NEIGHBORHOOD_POINTS,
    SCALE_FLOOR,
    ScatteredFit,
    consensus_weights,
    fit_medians,
    padded,
    supported_cells,
    voxel_counts,
)
from fsh3d_o3d.sphere import (
    NufftEngine,
    SphericalHarmonicTransform,
    fibonacci_grid,
    grid_from_directions,
    resolve_threads,
)

_FEWEST, _MOST = 16, 192  # neighbours of a node, a choice: more average more noise, fewer follow finer detail
_REACH = 3.0  # farthest neighbour, in spacings of the nodes
_MOST_ROUNDS = 8  # of correction, a bound: clouds with outliers and a hole took three or four
_ONE_SIDED = 0.5  # distance of neighbours' middle from the node, in root mean square distances
_CHANGE_TOLERANCE = 0.1  # standard errors of a node's value; a change below it ends the rounds


def fit_resampled(
    directions: Float64Array,
    radii: Float64Array,
    bandwidth: int,
    *,
    smoothness: float | None = None,
    threads: int | None = None,
) -> ScatteredFit:
    """Fit a function of degree < b through its values on the Fibonacci grid of 6b² nodes.

    A node's value is that of the fit before plus a robust mean of its neighbours' residuals, so that the function's
    slope and curvature within the neighbourhood do not enter; nodes without neighbours that agree are filled by a
    smooth fit to the others. Arguments are those of ``fit_scattered``; ``smoothness`` applies to the filling alone.
    """
    b = bandwidth
    transform = SphericalHarmonicTransform(b, threads=threads)
    nodes = transform.grid
    neighbors, found = _neighbors(directions, nodes.directions, resolve_threads(threads))
    # Nodes share neighbours: their errors go together, and are that much larger where it matters.
    overlap = float(np.sqrt(max(1.0, found.sum() / len(directions))))
    engine = NufftEngine(grid_from_directions(directions), b)
    start = fit_medians(directions, radii, b, voxel_counts(directions * radii[:, None]), threads=threads)
    coefficients = padded(start, b)
    strength, converged, rounds = 0.0, False, 0
    while not converged and rounds < _MOST_ROUNDS:
        rounds += 1
        residuals = radii - engine.synthesise(coefficients[None], threads)[0]
        local, error, known = _local_means(residuals[neighbors], found)
        error *= overlap
        if not known.any():
            break
        corrected, strength = _filled(coefficients, local, error, known, smoothness, threads)
        # What is filled settles last and is a guess in any case.
        change = float(np.sqrt(np.mean(np.square(transform.inverse(corrected - coefficients)[known]))))
        coefficients = corrected
        converged = change <= max(_CHANGE_TOLERANCE * error, SCALE_FLOOR)
    residuals = radii - engine.synthesise(coefficients[None], threads)[0]
    scale = robust_scale(residuals, SCALE_FLOOR)
    cells = AngularCells.of(directions, len(radii) / NEIGHBORHOOD_POINTS)
    weights = consensus_weights(residuals, scale, cells, supported_cells(residuals, scale, cells))
    return ScatteredFit(coefficients, weights, scale, strength, rounds, converged)


def _neighbors(directions: Float64Array, nodes: Float64Array, workers: int) -> tuple[IntArray, NDArray[np.bool_]]:
    """Nearest directions of each node, (6b², k), and which of them are within reach."""
    count = min(len(directions), int(np.clip(2 * len(directions) / len(nodes), _FEWEST, _MOST)))
    reach = _REACH * float(np.sqrt(4 * np.pi / len(nodes)))
    # Few samples lie far apart: the neighbourhood grows with them, or every node would be a hole.
    reach = max(reach, 2 * float(np.sqrt(4 * count / len(directions))))
    tree = KDTree(directions, balanced_tree=False, compact_nodes=False)
    _, index = tree.query(nodes, k=np.arange(1, count + 1), distance_upper_bound=reach, workers=workers)
    found = np.asarray(index < len(directions))
    index = np.where(found, index, 0)
    count_found = np.maximum(1, found.sum(axis=1))
    # A node within a hole must not take its value from the rim: its neighbours have to lie around it.
    offsets = (directions[index] - nodes[:, None]) * found[:, :, None]
    off = np.linalg.norm(offsets.sum(axis=1), axis=1) / count_found
    spread = np.sqrt(np.square(offsets).sum(axis=(1, 2)) / count_found)
    found[off > _ONE_SIDED * spread] = False
    return index, found


def _local_means(values: Float64Array, found: NDArray[np.bool_]) -> tuple[Float64Array, float, NDArray[np.bool_]]:
    """Robust mean (nodes,) of (nodes, k) values, its typical standard error, and where there is one."""
    count = found.sum(axis=1)
    known = count >= max(3, 0.25 * found.shape[1])
    if not known.any():
        return np.zeros(len(found)), SCALE_FLOOR, known
    values = np.where(found, values, np.inf)
    ordered = np.sort(values[known], axis=1)
    count = count[known]
    middle = np.take_along_axis(ordered, (count[:, None] - 1) // 2, axis=1)
    inside = found[known]
    centered = np.where(inside, values[known] - middle, np.inf)
    scale = robust_scale(centered[inside], SCALE_FLOOR)
    agreeing = (np.abs(centered) <= 3 * scale).sum(axis=1)
    supporting = (np.abs(values[known]) <= 3 * scale).sum(axis=1)
    # As among scattered points: the fit where well supported, else the median where that is,
    # else the fit where a third supports it.
    followed = (supporting < 0.7 * count) & (agreeing >= 0.4 * count)
    middle = np.where(followed[:, None], middle, 0.0)
    centered = np.where(inside, values[known] - middle, 0.0)
    weights = np.where(inside, tukey(centered, scale), 0.0)
    mass = weights.sum(axis=1)
    means = np.zeros(len(found))
    means[known] = middle[:, 0] + (weights * centered).sum(axis=1) / np.maximum(mass, 1e-9)
    trusted = followed | (supporting >= 0.35 * count)
    known[known] = trusted
    error = scale / float(np.sqrt(np.median(mass[trusted]))) if trusted.any() else scale
    return means, error, known


def _filled(
    coefficients: Float64Array,
    residuals: Float64Array,
    error: float,
    known: NDArray[np.bool_],
    smoothness: float | None,
    threads: int | None,
) -> tuple[Float64Array, float]:
    """Coefficients corrected by the residuals at the nodes; where they are not known, a smooth fit to the others."""
    b = round(np.sqrt(len(coefficients)))
    transform = SphericalHarmonicTransform(b, threads=threads)
    corrected = coefficients + transform.forward(np.where(known, residuals, 0.0))
    if known.all():
        return np.asarray(corrected), 0.0
    weights = np.where(known, 4 * np.pi / known.sum(), 0.0)
    variance = 4 * np.pi / len(known) * error**2
    strength, penalty = likely_penalty(corrected, b, variance)
    if smoothness is not None:
        strength, penalty = smoothness, smoothness * bending(b)
    grid = fibonacci_grid(len(known))
    gradient = NufftEngine(grid, b, weights).analyse(residuals[None], threads)[0]
    smooth = solve(
        coefficients,
        gradient,
        NufftEngine(grid, b, weights),
        penalty,
        tolerance=3e-3 * float(np.sqrt(variance)) * b,
        threads=threads,
    ).coefficients
    change = transform.inverse(smooth - coefficients)
    return np.asarray(coefficients + transform.forward(np.where(known, residuals, change))), strength
