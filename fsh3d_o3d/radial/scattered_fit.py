"""Radial functions fitted straight to scattered directions: coarse to fine, robust, smooth over holes."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.radial.angular_cells import AngularCells
from fsh3d_o3d.radial.robust_fit import TUKEY, bending, likely_penalty, robust_scale, solve, tukey
from fsh3d_o3d.sphere import NufftEngine, SphericalGrid, grid_from_directions

SCALE_FLOOR = 1e-10
"""Least residual scale in units of the median radius: below it, residuals are rounding."""

_CELL_POINTS = 12  # for a median: robust against 20 % outliers, and fine enough to follow the surface
NEIGHBORHOOD_POINTS = 48  # of a neighbourhood that agrees or not: its median scatters by a fifth of the points' scatter
_WELL_SUPPORTED = 0.7  # share of points near the fit below which a neighbourhood's own scatter is looked at
_SUPPORTED = 0.35  # share below which it does not count, unless its points agree with each other
_SUPPORTED_WHERE_SPARSE = 0.6  # the same where points are sparse
_LARGEST_SCATTER = 0.1  # largest scatter, in median radii, of what is still a surface
_SOLVE_CELLS = 24  # times b²; where points are more, cells stand for them in the Hessian
_FIRST_SMOOTHNESS = 1e-8  # λ before it can be chosen: bridges holes, and takes 1 % from degree 32
_GRADIENT_TOLERANCE = 3e-3  # gradient at which to stop, in standard errors
_ROUNDS_OF_JUDGING = 6  # rounds after which the support of cells is kept, so that a cell cannot alternate for ever
_MOST_ROUNDS = 12  # of reweighting, a bound: clouds with outliers and a hole took four or five
_CHANGE_TOLERANCE = 0.02  # standard errors of the function; a change below it ends the rounds, far below the noise


@dataclass(frozen=True, eq=False)
class ScatteredFit:
    """A radial function fitted to scattered samples, in their unit."""

    coefficients: Float64Array
    """(b²,)."""
    weights: Float64Array
    """(n,) final weights of the samples, 0 … 1."""
    scale: float
    """Robust standard deviation of the residuals."""
    smoothness: float
    """λ of the bending energy, as given or chosen."""
    iterations: int
    """Rounds of reweighting at the full bandwidth."""
    converged: bool
    """Whether the last round changed the function by less than 2 % of its standard error."""


def fit_scattered(
    directions: Float64Array,
    radii: Float64Array,
    bandwidth: int,
    *,
    smoothness: float | None = None,
    threads: int | None = None,
) -> ScatteredFit:
    """Fit a function of degree < b to samples with noise, outliers, holes and uneven density.

    Args:
        directions: (n, 3) unit vectors.
        radii: (n,) positive samples of about 1.
        bandwidth: b.
        smoothness: λ of the bending energy in units of the squared samples' mean, or None for the most likely.
        threads: Number of threads, or None for all that the process may use. Does not change the result.
    """
    b = bandwidth
    start = fit_medians(directions, radii, b, voxel_counts(directions * radii[:, None]), threads=threads)
    coefficients = padded(start, b)
    grid = grid_from_directions(directions)
    engine = NufftEngine(grid, b)
    neighborhoods = AngularCells.of(directions, len(radii) / NEIGHBORHOOD_POINTS)
    cells = _solve_cells(directions, b)
    strength = _FIRST_SMOOTHNESS if smoothness is None else smoothness
    penalty, converged, rounds = strength * bending(b), False, 0
    support: CellSupport | None = None
    for rounds in range(1, _MOST_ROUNDS + 1):
        residuals = radii - engine.synthesise(coefficients[None], threads)[0]
        scale = robust_scale(residuals, SCALE_FLOOR)
        if support is None or rounds <= _ROUNDS_OF_JUDGING:
            support = supported_cells(residuals, scale, neighborhoods)
        weights = consensus_weights(residuals, scale, neighborhoods, support)
        precision, noise = _precision(residuals, weights, scale, neighborhoods, b)
        variance = 4 * np.pi / precision.sum()  # of a coefficient, where samples are even
        precision = precision * variance
        if smoothness is None and rounds > 2:
            # What the penalty took away is given back first, or the choice would feed on itself. Noise alone is to be
            # smoothed away, not detail: else a rough shape would pass for noise.
            strength, penalty = likely_penalty(coefficients * (1 + penalty), b, 4 * np.pi * noise / weights.sum())
        gradient = engine.analyse((precision * residuals)[None], threads)[0]
        found = solve(
            coefficients,
            gradient,
            _summed(grid, precision, cells, b),
            penalty,
            tolerance=_GRADIENT_TOLERANCE * np.sqrt(variance) * b,
            threads=threads,
        )
        change = float(np.linalg.norm(found.coefficients - coefficients)) / np.sqrt(4 * np.pi)
        coefficients = found.coefficients
        error = np.sqrt(variance * b * b / (4 * np.pi))  # standard error of the function
        if rounds > 2 and change <= max(_CHANGE_TOLERANCE * error, SCALE_FLOOR):
            converged = True
            break
    return ScatteredFit(coefficients, weights, scale, strength, rounds, converged)


def fit_medians(
    directions: Float64Array, radii: Float64Array, bandwidth: int, density: Float64Array, *, threads: int | None = None
) -> Float64Array:
    """Fit the medians of angular cells, from low degrees to high; returns ((b')²,) with b' <= b as the cells allow.

    Medians withstand outliers among other points; that a low degree comes first withstands cells full of them. In each
    cell those points vote whose ``density`` (n,) is high by the standards of the cell: outliers may be many
    in the direction of a near face, but they are thin in space.
    """
    total = min(len(radii) / _CELL_POINTS, 16 * bandwidth**2)
    part = slice(None, None, 1 + int(len(radii) / (2 * _CELL_POINTS * total)))  # as many as medians need
    directions, radii, density = directions[part], radii[part], density[part]
    cells = AngularCells.of(directions, total)
    voting = density >= 0.25 * cells.maxima(density)[cells.index]
    directions, radii = directions[voting], radii[voting]
    # Every cell has a vote, its densest point's.
    index = cells.index[voting]
    cells = AngularCells(index, np.bincount(index), cells.total)
    values = cells.medians(radii)
    grid = grid_from_directions(cells.mean_directions(directions))
    # A cell with few points at the rim of a hole has no robust median.
    trust = np.minimum(1, cells.count / 4)
    highest = max(1, min(bandwidth, isqrt(len(values) // 2)))
    stages = [d for d in (1, 4, 8, 16, 32, 64, 128, 256) if d < highest]
    coefficients = np.array([np.sqrt(4 * np.pi) * float(np.median(values))])
    for b in [*stages[1:], highest]:
        coefficients = padded(coefficients, b)
        engine = NufftEngine(grid, b)
        for _ in range(3):
            residuals = values - engine.synthesise(coefficients[None], threads)[0]
            scale = robust_scale(residuals, 1e-6)
            weights = trust * tukey(residuals, scale * 8 / TUKEY)
            weights *= 4 * np.pi / weights.sum()
            variance = scale**2 * float(weights @ weights) / (4 * np.pi)
            coefficients = solve(
                coefficients,
                engine.analyse((weights * residuals)[None], threads)[0],
                NufftEngine(grid, b, weights),
                _FIRST_SMOOTHNESS * bending(b),
                tolerance=0.05 * np.sqrt(variance) * b,
                threads=threads,
            ).coefficients
    return coefficients


@dataclass(frozen=True, eq=False)
class CellSupport:
    """Which cells of samples support the fit, or at least each other."""

    rejected: NDArray[np.bool_]
    """(k,) whether the samples of the cell support neither the fit nor each other."""
    consistent: NDArray[np.bool_]
    """(k,) whether they support the fit poorly, but agree with each other."""


def supported_cells(residuals: Float64Array, scale: float, cells: AngularCells) -> CellSupport:
    """Find the neighbourhoods where the samples support the fit, or each other.

    Where it is not, but they agree with each other, on an edge that the bandwidth is too low to follow, they are right.
    Where they do neither none of them counts: a hole with some outliers in it is a hole.
    """
    # Crowds far from the fit do not outvote the few that support it.
    usual = float(np.median(cells.count[cells.index]))
    share = cells.sums(np.abs(residuals) <= 3 * scale) / np.minimum(cells.count, usual)
    unsure = share < _WELL_SUPPORTED
    consistent = np.zeros_like(unsure)
    if unsure.any():
        some, own = _part(cells, unsure)
        _, spread = _location(residuals[some], own)
        consistent[unsure] = (spread <= max(3 * scale, _LARGEST_SCATTER)) & (own.count >= 0.5 * usual)
    # A few points where there are many elsewhere may be outliers in a hole, among which some always lie near the fit.
    needed = np.where(cells.count < 0.5 * usual, _SUPPORTED_WHERE_SPARSE, _SUPPORTED)
    return CellSupport(rejected=(share < needed) & ~consistent, consistent=consistent)


def consensus_weights(residuals: Float64Array, scale: float, cells: AngularCells, support: CellSupport) -> Float64Array:
    """Return (n,) Tukey's weights of samples, about the fit or about their cell's median where that is supported."""
    weights = tukey(residuals, scale)
    weights[support.rejected[cells.index]] = 0
    if support.consistent.any():
        some, own = _part(cells, support.consistent)
        middle, spread = _location(residuals[some], own)
        local = tukey((residuals[some] - middle[own.index]) / np.maximum(scale, spread)[own.index], 1.0)
        weights[some] = np.maximum(weights[some], local)
    return weights


def _location(values: Float64Array, cells: AngularCells) -> tuple[Float64Array, Float64Array]:
    """Median and robust standard deviation of the values in each cell, (k,) each."""
    middle = cells.medians(values)
    return middle, 1.4826 * cells.medians(np.abs(values - middle[cells.index]))


def _part(cells: AngularCells, chosen: NDArray[np.bool_]) -> tuple[IntArray, AngularCells]:
    """Directions that lie in chosen cells, and those cells alone."""
    some = np.flatnonzero(chosen[cells.index])
    place = np.cumsum(chosen) - 1
    return some, AngularCells(place[cells.index[some]], cells.count[chosen], cells.total)


def voxel_counts(points: Float64Array) -> Float64Array:
    """Number of points (n,) in the voxel of each of (n, 3) points; 0 for the few far outside.

    Voxels are cubes that hold about 16 points of a surface of radius 1, as far as 128³ of them go.
    """
    reach = 1.5 * float(np.quantile(np.abs(points).max(axis=1), 0.9))
    side = np.sqrt(4 * np.pi * 16 / len(points))
    m = int(np.clip(2 * reach / side, 4, 128))
    place = np.floor((points / reach + 1) * (m / 2))
    inside = ((place >= 0) & (place < m)).all(axis=1)
    key = np.where(inside, place @ np.array([m * m, m, 1.0]), m**3).astype(np.int64)
    count = np.bincount(key, minlength=m**3 + 1)
    count[-1] = 0
    return count[key].astype(np.float64)


def padded(coefficients: Float64Array, bandwidth: int) -> Float64Array:
    """Return coefficients with zeros for the degrees they lack, (b²,)."""
    result = np.zeros(bandwidth**2)
    result[: len(coefficients)] = coefficients
    return result


def _solve_cells(directions: Float64Array, bandwidth: int) -> AngularCells | None:
    total = _SOLVE_CELLS * bandwidth**2
    return AngularCells.of(directions, total) if len(directions) > total else None


def _summed(grid: SphericalGrid, weights: Float64Array, cells: AngularCells | None, bandwidth: int) -> NufftEngine:
    """The engine of samples, or of cells that stand for them where there are many more than needed."""
    if cells is None:
        return NufftEngine(grid, bandwidth, weights)
    mass = cells.sums(weights)
    means = np.stack([cells.sums(axis * weights) for axis in grid.directions.T], axis=1)
    used = mass > 1e-9 * mass.max()
    means = means[used] / np.linalg.norm(means[used], axis=1, keepdims=True)
    return NufftEngine(grid_from_directions(means), bandwidth, mass[used])


def _precision(
    residuals: Float64Array, weights: Float64Array, scale: float, cells: AngularCells, bandwidth: int
) -> tuple[Float64Array, float]:
    """Weights (n,) over the variance of a sample, with the detail that the bandwidth cannot follow; and that without.

    The mean of a neighbourhood of mass W scatters about the fit by σ²/W + τ²; τ² is estimated from how much that is
    beyond σ²/W. Where noise prevails all points count the same, where detail prevails all areas do, and density does
    not matter (DerSimonian and Laird 1986).
    """
    free = 1 - bandwidth**2 / len(cells.count)
    if free < 0.75:  # too few neighbourhoods to tell detail from what the fit absorbs
        return weights / scale**2, scale**2
    mass = cells.sums(weights)
    used = mass > 1
    mean = cells.sums(weights * residuals)[used] / mass[used]
    within = float(weights @ np.square(residuals) - mass[used] @ np.square(mean))
    noise = max(within / max(1.0, float(mass.sum()) - len(mean)), (0.1 * scale) ** 2)
    share = mass[used] / mass[used].sum()
    detail = max(0.0, float(share @ np.square(mean)) / free - noise * float((share / mass[used]).sum()))
    return weights / (noise + detail * mass[cells.index]), noise
