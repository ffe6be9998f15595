"""The paper's analytic weights: the minimum-norm solution of Eq. (8) and (11).

The weighted grid s = Σ w_j δ(ω_j) must have no spectrum in the degrees 1 … 2b − 1; then quadrature recovers functions
of degree < b exactly. In orthonormal real harmonics that is A w = √4π e₀ with A = Y(l, m; ω_j), l < 2b. Equal weights
lie in the range of Aᵀ, so the minimum-norm solution is equal weights plus a correction Aᵀy.

Conjugate gradients find it in about ten steps where A Aᵀ is well conditioned, n >= 5.7b² on a Fibonacci grid. Below,
towards the n = 4b² that counting equations suggests, some combination of harmonics all but vanishes on the grid: exact
solutions exist, but from b = 20 on their weights reach hundreds of times the mean and alternate in sign, which
multiplies any noise in the samples. Such solutions are refused in favour of bounded ones, and the result says what
they miss.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy import linalg

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import MemoryEstimateError, QuadratureWarning
from fsh3d_o3d.sphere import weight_cache
from fsh3d_o3d.sphere.dense_engine import half_turn_parity
from fsh3d_o3d.sphere.grids import SphericalGrid, locked_directions, require_grid
from fsh3d_o3d.sphere.harmonics import analyse_exactly, spherical_harmonics
from fsh3d_o3d.sphere.nufft_engine import NufftEngine, analyse_directly
from fsh3d_o3d.sphere.threads import resolve_threads, single_threaded_blas
from fsh3d_o3d.sphere.weight_solution import WeightSolution

__all__ = ["analytic_weights"]

CONDITION_TOLERANCE = 1e-10
"""Residual up to which Eq. (8) counts as met."""
# Up to here transforms may be matrix products, exact to rounding, and weights have to be as good as that.
_REFINED_BANDWIDTH = 64
_REFINED_TOLERANCE = 2e-15  # of the conditions of Eq. (8): some ten roundings of float64
# The compiled sum is ten times faster than the recursion that also makes the matrices (0.7 s at 64), and 1e-14 off it.
# A choice between the two.
_COMPILED_BANDWIDTH = 32
_DIRECT_RESIDUAL = 24  # bandwidth up to which the residual is summed point by point: 3 ms; 27 ms at 48
_FAST_TOLERANCE = 1e-13  # of the conditions: what the fast transforms leave
_FEW_ITERATIONS = 30  # well-conditioned systems take 13 at most
_MANY_ITERATIONS = 300  # ten times as many: the error falls with each, and what is left is told
# Root mean square of the weights over their mean: by how much quadrature multiplies white noise; a choice.
_MAXIMUM_AMPLIFICATION = 2.0
_LARGEST_DIRECT = 2200  # equations; below, a factorisation beats hundreds of iterations


def analytic_weights(
    grid: SphericalGrid, bandwidth: int, *, threads: int | None = None, cache: bool = True
) -> WeightSolution:
    """Solve for the weights that give a grid no spectrum in degrees 1 … 2b − 1 (Eq. 8), with minimum norm.

    Use n >= 6b² points on a Fibonacci grid: there the weights are positive, within 0.92 … 1.10 of equal, and exact to
    rounding. Down to n = 4b² the function returns the exact solution while its weights stay bounded (root mean square
    within twice the equal weight), else bounded weights that meet the conditions approximately, with a warning.

    Args:
        grid: Any grid; those with the half-turn symmetry are solved on half their points.
        bandwidth: b.
        threads: Number of threads, or None for all that the process may use. Does not change the result.
        cache: Whether to keep solutions in memory and in the user's cache directory (``clear_weight_cache``).

    Raises:
        ValueError: Fewer than 4b² points: too few for the 4b² conditions.

    Warns:
        QuadratureWarning: The conditions are not met to 1e-10; gives the figures and the remedy.

    Example:
        >>> grid = fsh.fibonacci_grid(6 * 16**2)
        >>> solution = fsh.analytic_weights(grid, bandwidth=16)
        >>> solution.converged, solution.negative, solution.residual < 1e-13
        (True, 0, True)
        >>> values = grid.directions[:, 0] ** 2
        >>> np.allclose(solution.weights @ values, 4 * np.pi / 3)  # the integral of x² over the sphere
        True
    """
    solution = solve_weights(grid, bandwidth, threads=threads, cache=cache)
    warn_if_inexact(solution, grid, stacklevel=3)
    return solution


def solve_weights(
    grid: SphericalGrid, bandwidth: int, *, threads: int | None = None, cache: bool = True
) -> WeightSolution:
    """As ``analytic_weights``, without the warning."""
    b = check.bandwidth(bandwidth)
    n = len(require_grid(grid))
    if n < 4 * b * b:
        raise ValueError(
            f"bandwidth {b} needs at least 4b² = {4 * b * b} points for the conditions of Eq. (8), and 6b² = "
            f"{6 * b * b} to be well conditioned; the {grid.name} grid has {n}"
        )
    threads = resolve_threads(threads)
    key = weight_cache.weight_key(grid, b)
    solution = weight_cache.find(key, n) if cache else None
    if solution is None:
        system = _System(grid, b, threads)
        with single_threaded_blas():  # dot products are too short to share, and the factorisation has to be repeatable
            weights, iterations = _solve(system)
        weights.setflags(write=False)
        residual = system.residual(weights)
        solution = WeightSolution(
            weights=weights,
            bandwidth=b,
            residual=residual,
            iterations=iterations,
            minimum=float(weights.min()),
            maximum=float(weights.max()),
            negative=int(np.count_nonzero(weights < 0)),
            converged=residual <= CONDITION_TOLERANCE,
        )
        if cache:
            weight_cache.keep(key, solution)
    return solution


def warn_if_inexact(solution: WeightSolution, grid: SphericalGrid, *, stacklevel: int) -> None:
    """Warn where the conditions are not met, with the figures and the remedy."""
    if solution.converged:
        return
    n, b = len(grid), solution.bandwidth
    warnings.warn(
        f"the {grid.name} grid of {n} = {n / (b * b):.2f}b² points misses the conditions of Eq. (8) for bandwidth "
        f"{b} by {solution.residual:.1e} (weights {solution.minimum * n / (4 * np.pi):.2f} … "
        f"{solution.maximum * n / (4 * np.pi):.2f} of equal, {solution.negative} negative); a Fibonacci grid of "
        f'6b² = {6 * b * b} points meets them, and analysis="least_squares" recovers band-limited functions on '
        "this one",
        QuadratureWarning,
        stacklevel=stacklevel,
    )


class _System:
    """A and Aᵀ for one grid, on half the points and half the harmonics where the half-turn symmetry allows."""

    def __init__(self, grid: SphericalGrid, bandwidth: int, threads: int) -> None:
        self.grid, self.bandwidth, self.threads = grid, bandwidth, threads
        n, size = len(grid), 4 * bandwidth**2
        self.symmetric = grid.half_turn_symmetric and n > 1
        half = (n + 1) // 2 if self.symmetric else n
        self.points = SphericalGrid(
            locked_directions(grid)[:half], grid.colatitude[:half], grid.longitude[:half], f"half of {grid.name}"
        )
        self.multiplicity = np.full(half, 2.0 if self.symmetric else 1.0)
        if self.symmetric and n % 2:
            self.multiplicity[-1] = 1.0
        self.kept = half_turn_parity(2 * bandwidth) == 0 if self.symmetric else np.ones(size, dtype=bool)
        self.engine = NufftEngine(self.points, 2 * bandwidth)
        self.target = np.zeros(size)
        self.target[0] = np.sqrt(4 * np.pi)

    def moments(self, weights: Float64Array) -> Float64Array:
        """A w for weights on the kept points."""
        moments = self.engine.analyse((weights * self.multiplicity)[None], self.threads)[0]
        return np.where(self.kept, moments, 0.0)

    def combination(self, coefficients: Float64Array) -> Float64Array:
        """Aᵀ y on the kept points."""
        return np.asarray(self.engine.synthesise(coefficients[None], self.threads)[0])

    def complete(self, weights: Float64Array) -> Float64Array:
        """Weights of all points from those of the kept ones."""
        return np.concatenate([weights, weights[: len(self.grid) - len(weights)][::-1]])

    def residual(self, weights: Float64Array) -> float:
        """Largest |A w − √4π e₀| / √4π for weights of all points."""
        kept = weights[: len(self.points)]
        # The fast transform sees rounding on few points less clearly than the direct sum, which is cheap there.
        error = self.exact_error(kept) if self.bandwidth <= _DIRECT_RESIDUAL else self.moments(kept) - self.target
        return float(np.abs(error).max() / np.sqrt(4 * np.pi))

    def exact_error(self, weights: Float64Array) -> Float64Array:
        """√4π e₀ − A w for weights on the kept points, summed point by point."""
        values, bandwidth = weights * self.multiplicity, 2 * self.bandwidth
        if self.bandwidth <= _COMPILED_BANDWIDTH:
            moments = analyse_directly(values, bandwidth, self.points)
        else:
            moments = analyse_exactly(locked_directions(self.points), values, bandwidth)
        return np.where(self.kept, self.target - moments, 0.0)

    def amplification(self, weights: Float64Array) -> float:
        """Root mean square over mean, for weights on the kept points."""
        mean_square = float(self.multiplicity @ weights**2) / len(self.grid)
        mean = float(self.multiplicity @ weights) / len(self.grid)
        return np.sqrt(mean_square) / abs(mean) if mean else np.inf


def _solve(system: _System) -> tuple[Float64Array, int]:
    weights, iterations, solved = _correct_equal_weights(system, _FEW_ITERATIONS)
    if not solved and np.count_nonzero(system.kept) <= _LARGEST_DIRECT:
        exact = _factorise(system)
        if exact is not None:
            return system.complete(exact), 0
    if not solved:
        weights, iterations, solved = _correct_equal_weights(system, _MANY_ITERATIONS)
    if solved and system.bandwidth <= _REFINED_BANDWIDTH:
        # One step removes what the fast transforms' own error left; A Aᵀ is n/4π times nearly the identity.
        weights = weights + system.combination(system.exact_error(weights)) * (4 * np.pi / len(system.grid))
    weights = system.complete(weights)
    return weights * (4 * np.pi / weights.sum()), iterations


def _correct_equal_weights(system: _System, maximum: int) -> tuple[Float64Array, int, bool]:
    """Conjugate gradients on the least-squares problem min |A w − √4π e₀|, from equal weights (CGLS).

    The corrections lie in the range of Aᵀ, so the limit is the minimum-norm solution. Unlike gradients on A Aᵀ the
    misfit falls with every step, so that an iterate stopped early is a regularised solution: positive and close to
    equal.
    """
    limit = (_REFINED_TOLERANCE if system.bandwidth <= _REFINED_BANDWIDTH else _FAST_TOLERANCE) * np.sqrt(4 * np.pi)
    weights = np.full(len(system.points), 4 * np.pi / len(system.grid))
    error = system.target - system.moments(weights)
    step, previous = np.zeros_like(weights), np.inf
    for iteration in range(maximum + 1):
        solved = bool(np.abs(error).max() <= limit)
        if solved or iteration == maximum:
            break
        gradient = system.combination(error)
        power = float(system.multiplicity @ gradient**2)
        step = gradient + power / previous * step
        previous = power
        image = system.moments(step)
        length = power / float(image @ image)
        corrected = weights + length * step
        if system.amplification(corrected) > _MAXIMUM_AMPLIFICATION:
            break
        weights = corrected
        error -= length * image
    return weights, iteration, solved


def _factorise(system: _System) -> Float64Array | None:
    """The exact minimum-norm solution by Cholesky with refinement, or None where it is singular or too large."""
    try:
        basis = spherical_harmonics(system.points.directions, 2 * system.bandwidth)[:, system.kept]
    except MemoryEstimateError:
        return None
    gram = basis.T @ (system.multiplicity[:, None] * basis)
    try:
        factor = linalg.cho_factor(gram, lower=True, overwrite_a=True, check_finite=False)
    except linalg.LinAlgError:
        return None
    weights = np.full(len(system.points), 4 * np.pi / len(system.grid))
    target = system.target[system.kept]

    def error() -> Float64Array:
        return np.asarray(target - basis.T @ (system.multiplicity * weights))

    for _ in range(20):
        if np.abs(error()).max() <= _REFINED_TOLERANCE:
            break
        weights = weights + basis @ linalg.cho_solve(factor, error(), check_finite=False)
    solved = np.abs(error()).max() <= CONDITION_TOLERANCE
    return weights if solved and system.amplification(weights) <= _MAXIMUM_AMPLIFICATION else None
