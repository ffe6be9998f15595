"""The analytic weights against Eq. (8) summed with scipy's harmonics, and against dense minimum-norm solutions."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import QuadratureWarning
from tests.sphere.oracles import misses, real_harmonics, scattered


def solve(grid: fsh.SphericalGrid, b: int, threads: int = 1) -> fsh.WeightSolution:
    return fsh.analytic_weights(grid, b, threads=threads, cache=False)


def minimum_norm(grid: fsh.SphericalGrid, b: int) -> np.ndarray:
    """Dense minimum-norm solution of Eq. (11) by singular values."""
    target = np.zeros(4 * b * b)
    target[0] = np.sqrt(4 * np.pi)
    return np.linalg.lstsq(real_harmonics(grid.directions, 2 * b).T, target, rcond=1e-13)[0]


def check_report(solution: fsh.WeightSolution, grid: fsh.SphericalGrid, b: int) -> None:
    """Everything the solution says of itself, computed again."""
    w = solution.weights
    assert w.shape == (len(grid),) and w.dtype == np.float64 and not w.flags.writeable
    assert solution.bandwidth == b
    assert (solution.minimum, solution.maximum) == (w.min(), w.max())
    assert solution.negative == np.count_nonzero(w < 0)
    assert solution.converged == (solution.residual <= 1e-10)
    # Two ways of summing thousands of terms agree to 1e-14, whatever the residual is.
    assert misses(grid.directions, w, b) == pytest.approx(solution.residual, rel=1e-6, abs=1e-14)
    assert w.sum() == pytest.approx(4 * np.pi, rel=1e-13)


@pytest.mark.parametrize("b", [*range(1, 17), 32])
def test_default_size_meets_equation_8(b: int) -> None:
    n = 6 * b * b
    grid = fsh.fibonacci_grid(n)
    solution = solve(grid, b)
    check_report(solution, grid, b)
    # Rounding of the sums.
    assert misses(grid.directions, solution.weights, b) < 1e-14
    assert solution.converged and solution.negative == 0 and solution.iterations <= 15
    ratio = solution.weights * n / (4 * np.pi)
    lowest = 0.88 if b == 3 else 0.89 if b == 4 else 0.9  # 54 and 96 points have a coarser pole
    assert ratio.min() > lowest and ratio.max() < 1.12


@pytest.mark.parametrize("b", [64, 100])
def test_fast_residual_is_true(b: int) -> None:
    """Larger systems: the residual at sampled degrees, and that of the fast sum."""
    grid = fsh.fibonacci_grid(6 * b * b)
    solution = solve(grid, b)
    assert solution.residual < 1e-12 and solution.negative == 0 and solution.iterations <= 15
    low = misses(grid.directions, solution.weights, 10)  # degrees below 20
    assert low < 1e-12
    assert (solution.weights * len(grid) / (4 * np.pi)).max() < 1.12


@pytest.mark.parametrize("b", [1, 2, 3, 5, 7])
def test_minimum_norm_on_fibonacci(b: int) -> None:
    for n in (6 * b * b, 6 * b * b + 1, 8 * b * b + 5):
        grid = fsh.fibonacci_grid(n)
        # lstsq and conjugate gradients each err by the condition number (below 10 here) times rounding.
        assert np.abs(solve(grid, b).weights - minimum_norm(grid, b)).max() * n / (4 * np.pi) < 1e-12


@pytest.mark.parametrize("b", [2, 4, 6])
def test_minimum_norm_without_symmetry(b: int, rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    """A turned and jittered Fibonacci grid: nothing of the half turn is left."""
    n = 7 * b * b
    directions = fsh.fibonacci_grid(n).directions @ random_rotation.T + 0.05 / b * rng.standard_normal((n, 3))
    grid = fsh.grid_from_directions(directions / np.linalg.norm(directions, axis=1)[:, None])
    solution = solve(grid, b)
    assert not grid.half_turn_symmetric
    check_report(solution, grid, b)
    assert solution.converged
    assert np.abs(solution.weights - minimum_norm(grid, b)).max() * n / (4 * np.pi) < 1e-9


@pytest.mark.parametrize("b", [*[2] * 12, 4, 8])
def test_scattered_directions_are_bounded_or_exact(b: int, rng: np.random.Generator) -> None:
    """Twelve draws of 32 points: the bound is nearly reached where the sum of the weights is corrected most."""
    n = 8 * b * b
    grid = fsh.grid_from_directions(scattered(rng, n))
    exact = minimum_norm(grid, b)
    amplification = np.sqrt((exact**2).sum() * n) / (4 * np.pi)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        solution = solve(grid, b)
    check_report(solution, grid, b)
    assert np.sqrt((solution.weights**2).mean()) * n / (4 * np.pi) <= 2 + 1e-12
    assert len(caught) == (not solution.converged)
    if amplification < 1.9:
        assert solution.converged
        assert np.abs(solution.weights - exact).max() * n / (4 * np.pi) < 1e-6
    if amplification > 2.1:
        assert not solution.converged


@pytest.mark.parametrize("seed", [4, 12])
def test_bound_holds_after_the_sum_is_corrected(seed: int) -> None:
    grid = fsh.grid_from_directions(scattered(np.random.default_rng(seed), 32))
    with pytest.warns(QuadratureWarning):
        solution = solve(grid, 2)
    assert np.sqrt((solution.weights**2).mean()) * 32 / (4 * np.pi) <= 2


@pytest.mark.parametrize("b", [20, 24, 32])
def test_too_few_points_give_bounded_weights_and_figures(b: int) -> None:
    """At n = 4b² exact weights would alternate by hundreds of times the mean."""
    n = 4 * b * b
    grid = fsh.fibonacci_grid(n)
    with pytest.warns(QuadratureWarning) as caught:
        solution = solve(grid, b)
    assert not solution.converged
    assert solution.weights.sum() == pytest.approx(4 * np.pi, rel=1e-13)
    ratio = solution.weights * n / (4 * np.pi)
    assert np.sqrt((ratio**2).mean()) <= 2 and np.abs(ratio).max() <= 10
    check_report(solution, grid, b)
    assert solution.residual < 1e-3  # still far better than equal weights
    message = str(caught[0].message)
    for part in (f"fibonacci grid of {n} = 4.00b²", f"bandwidth {b}", f"{solution.residual:.1e}", f"6b² = {6 * b * b}"):
        assert part in message
    assert f"{ratio.min():.2f} … {ratio.max():.2f} of equal, {solution.negative} negative" in message
    assert 'analysis="least_squares"' in message


@pytest.mark.parametrize("n", [4 * 34**2, 4300])
def test_between_4b2_and_6b2(n: int) -> None:
    """The authors' code uses n = 4(b + 2)²; there exact weights exist and stay tame."""
    grid = fsh.fibonacci_grid(n)
    solution = solve(grid, 32)
    assert solution.converged
    assert misses(grid.directions, solution.weights, 32) < 1e-12
    ratio = solution.weights * n / (4 * np.pi)
    assert ratio.min() > 0.8 and ratio.max() < 1.2


@pytest.mark.parametrize(
    "grid", [fsh.equiangular_grid(9), fsh.cube_grid(9), fsh.icosahedral_grid(1), fsh.healpix_grid(7)]
)
def test_other_grids(grid: fsh.SphericalGrid) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        solution = solve(grid, 6)
    check_report(solution, grid, 6)
    assert len(caught) == (not solution.converged)
    assert np.sqrt((solution.weights**2).mean()) * len(grid) / (4 * np.pi) <= 2


def test_rotated_grid_has_the_same_conditions(random_rotation: np.ndarray) -> None:
    """Eq. (8) does not know directions: weights of the rotated grid are those of the grid."""
    grid = fsh.fibonacci_grid(600)
    turned = fsh.grid_from_directions(grid.directions @ random_rotation.T)
    # Positions are rounded to 1e-16 and the system's condition is below 10.
    assert np.abs(solve(grid, 10).weights - solve(turned, 10).weights).max() * 600 / (4 * np.pi) < 1e-11


@pytest.mark.parametrize(("n", "b"), [(64, 4), (6144, 32), (4300, 32), (6 * 70**2, 70)])
def test_threads_do_not_change_a_byte(n: int, b: int) -> None:
    grid = fsh.fibonacci_grid(n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QuadratureWarning)
        one, two = (solve(grid, b, threads) for threads in (1, 2))
    assert one.weights.tobytes() == two.weights.tobytes()
    assert (one.residual, one.iterations) == (two.residual, two.iterations)


def test_threads_do_not_change_a_scattered_solution(rng: np.random.Generator) -> None:
    grid = fsh.grid_from_directions(scattered(rng, 3000))
    assert solve(grid, 5, 1).weights.tobytes() == solve(grid, 5, 2).weights.tobytes()


def test_fewer_points_than_conditions() -> None:
    with pytest.raises(
        ValueError, match=r"bandwidth 8 needs at least 4b² = 256 points.*6b² = 384.*fibonacci grid has 255"
    ):
        fsh.analytic_weights(fsh.fibonacci_grid(255), 8)


def test_arguments_are_checked() -> None:
    grid = fsh.fibonacci_grid(100)
    with pytest.raises(TypeError, match=r"grid must be a SphericalGrid, got ndarray"):
        fsh.analytic_weights(grid.directions, 3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"bandwidth must be between 1 and 4096, got 0"):
        fsh.analytic_weights(grid, 0)
    with pytest.raises(ValueError, match=r"threads must be between 1 and 1024, got 0"):
        fsh.analytic_weights(grid, 3, threads=0)


def test_warning_points_at_the_caller() -> None:
    grid = fsh.fibonacci_grid(4 * 20**2)
    with pytest.warns(QuadratureWarning) as direct:
        fsh.analytic_weights(grid, 20)
    with pytest.warns(QuadratureWarning) as through:
        fsh.SphericalHarmonicTransform(20, grid)
    assert direct[0].filename == through[0].filename == __file__


def test_clustered_points_are_no_memory_error() -> None:
    """Many points, few equations, all in one hemisphere: hard to solve, but a matter of megabytes."""
    directions = fsh.fibonacci_grid(60_000).directions[:30_000]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fsh3d_o3d._validation._available_memory", lambda: 60.0 * 2**20)
        with pytest.warns(QuadratureWarning):
            solution = solve(fsh.grid_from_directions(directions), 8)
    assert np.isfinite(solution.weights).all()
