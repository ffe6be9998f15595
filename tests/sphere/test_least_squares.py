"""Least-squares analysis against dense normal equations, with holes, smoothness and noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from tests.sphere.oracles import real_harmonics, relative_l2, scattered


def dense_fit(values: np.ndarray, directions: np.ndarray, b: int, weights: np.ndarray, smoothness: float) -> np.ndarray:
    """Solve the normal equations of the documented functional directly."""
    basis = real_harmonics(directions, b)
    scaled = weights * 4 * np.pi / weights.sum()
    degree = np.repeat(np.arange(b), 2 * np.arange(b) + 1)
    matrix = basis.T @ (scaled[:, None] * basis) + smoothness * np.diag((degree * (degree + 1.0)) ** 2)
    return np.linalg.solve(matrix, basis.T @ (scaled * values))


@pytest.mark.parametrize(("n", "b"), [(4096, 32), (400, 10), (101, 10)])
def test_band_limited_functions_are_recovered(n: int, b: int, rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(n)
    coefficients = rng.standard_normal((2, b * b))
    fit = fsh.fit_coefficients(fsh.evaluate(coefficients, grid), grid, b)
    assert fit.converged
    # 101 points for 100 coefficients are barely enough: the condition number multiplies the samples' rounding.
    assert relative_l2(fit.coefficients, coefficients) < (2e-12 if n >= 4 * b * b else 1e-8)


@given(b=st.integers(1, 7), oversampling=st.integers(4, 9), seed=st.integers(0, 2**31), logarithm=st.floats(-8, 0))
def test_against_dense_normal_equations(b: int, oversampling: int, seed: int, logarithm: float) -> None:
    rng = np.random.default_rng(seed)
    n = oversampling * b * b
    directions, values, weights = scattered(rng, n), rng.standard_normal(n), rng.uniform(0.2, 1, n)
    smoothness = 10.0**logarithm
    fit = fsh.fit_coefficients(values, directions, b, weights=weights, smoothness=smoothness)
    expected = dense_fit(values, directions, b, weights, smoothness)
    assert fit.converged
    # The condition number reaches 1e4 on unlucky draws.
    assert np.abs(fit.coefficients - expected).max() < 1e-8 * max(1.0, np.abs(expected).max())


def test_least_misfit(rng: np.random.Generator) -> None:
    """No other coefficients leave a smaller weighted misfit: what is left of noise is orthogonal to the basis."""
    directions, values = scattered(rng, 500), rng.standard_normal(500)
    weights = rng.uniform(0.5, 2, 500)
    fit = fsh.fit_coefficients(values, directions, 8, weights=weights)
    basis = real_harmonics(directions, 8)
    assert np.abs(basis.T @ (weights * (values - basis @ fit.coefficients))).max() < 1e-10 * 500


def test_smoothness_bridges_a_hole(rng: np.random.Generator) -> None:
    """A cap of 25° without samples: smooth functions continue into it, noise does not blow up there."""
    b = 16
    directions = scattered(rng, 6000)
    outside = directions[directions[:, 2] < np.cos(np.radians(25))]
    inside = fsh.fibonacci_grid(4000).directions
    inside = inside[inside[:, 2] > np.cos(np.radians(25))]

    def smooth(d: np.ndarray) -> np.ndarray:
        return 1 + 0.2 * d[:, 0] + 0.1 * d[:, 1] * d[:, 2]

    values = smooth(outside) + 0.01 * rng.standard_normal(len(outside))
    fit = fsh.fit_coefficients(values, outside, b, smoothness=1e-6)
    exact, free = (dense_fit(values, outside, b, np.ones(len(outside)), smoothness) for smoothness in (1e-6, 0.0))
    assert fit.converged
    assert np.abs(fit.coefficients - exact).max() < 1e-8  # a condition number of 1e4
    bridged, unbridged = (np.abs(fsh.evaluate(c, inside) - smooth(inside)).max() for c in (fit.coefficients, free))
    assert bridged < 0.05 and bridged < unbridged


def test_smoothness_allows_fewer_samples_than_coefficients(rng: np.random.Generator) -> None:
    directions, values = scattered(rng, 30), rng.standard_normal(30)
    fit = fsh.fit_coefficients(values, directions, 10, smoothness=1e-5)
    assert fit.coefficients.shape == (100,) and fit.converged
    expected = dense_fit(values, directions, 10, np.ones(30), 1e-5)
    assert np.abs(fit.coefficients - expected).max() < 1e-6


def test_weights_of_zero_leave_samples_out(rng: np.random.Generator) -> None:
    directions = scattered(rng, 300)
    coefficients = rng.standard_normal(25)
    values = fsh.evaluate(coefficients, directions)
    values[200:] = 1e6
    weights = np.concatenate([np.ones(200), np.zeros(100)])
    fit = fsh.fit_coefficients(values, directions, 5, weights=weights)
    assert relative_l2(fit.coefficients, coefficients) < 1e-11


@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64])
def test_shapes_and_dtypes(batch: tuple[int, ...], dtype: type, rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(200)
    values = (10 * rng.standard_normal((*batch, 200))).astype(dtype)
    fit = fsh.fit_coefficients(values, grid, 5)
    assert fit.coefficients.shape == (*batch, 25)
    assert fit.coefficients.dtype == (np.float32 if dtype is np.float32 else np.float64)
    assert fit.converged
    each = [fsh.fit_coefficients(one, grid, 5).coefficients for one in values.reshape(-1, 200)]
    assert np.allclose(
        fit.coefficients.reshape(-1, 25),
        np.reshape(each, (-1, 25)),
        rtol=0,
        atol=1e-4 if dtype is np.float32 else 1e-11,
    )


def test_zero_is_fitted_by_zero() -> None:
    fit = fsh.fit_coefficients(np.zeros((2, 100)), fsh.fibonacci_grid(100), 4)
    assert fit.converged and not fit.coefficients.any() and fit.iterations == 0


@pytest.mark.parametrize(
    ("scale", "dtype"), [(1e200, np.float64), (1e-200, np.float64), (1e30, np.float32), (1e-30, np.float32)]
)
def test_scale_of_the_samples_does_not_matter(scale: float, dtype: type, rng: np.random.Generator) -> None:
    """Squares of such numbers leave the range of their type."""
    grid = fsh.fibonacci_grid(600)
    coefficients = rng.standard_normal(64)
    values = (fsh.evaluate(coefficients, grid) * scale).astype(dtype)
    fit = fsh.fit_coefficients(values, grid, 8)
    assert fit.converged
    assert relative_l2(fit.coefficients.astype(np.float64) / scale, coefficients) < (
        1e-12 if dtype is np.float64 else 1e-5
    )


def test_functions_of_very_different_size_in_one_batch(rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(400)
    coefficients = rng.standard_normal((3, 25)) * [[1e-12], [1.0], [1e12]]
    fit = fsh.fit_coefficients(fsh.evaluate(coefficients, grid), grid, 5)
    error = np.linalg.norm(fit.coefficients - coefficients, axis=1) / np.linalg.norm(coefficients, axis=1)
    assert error.max() < 1e-12


def test_too_few_iterations_are_reported(rng: np.random.Generator) -> None:
    directions, values = scattered(rng, 120), rng.standard_normal(120)
    with pytest.warns(fsh.ConvergenceWarning, match=r"stopped after 2 steps .* 120 samples"):
        short = fsh.fit_coefficients(values, directions, 10, max_iterations=2)
    assert short.iterations == 2 and not short.converged and short.residual > 1e-12
    long = fsh.fit_coefficients(values, directions, 10, max_iterations=5000)
    assert long.residual < short.residual


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_do_not_change_a_byte(threads: int) -> None:
    rng = np.random.default_rng(3)
    directions, values = scattered(rng, 1501), rng.standard_normal((3, 1501))
    first = fsh.fit_coefficients(values, directions, 12, threads=1)
    assert (
        fsh.fit_coefficients(values, directions, 12, threads=threads).coefficients.tobytes()
        == first.coefficients.tobytes()
    )


GRID = fsh.fibonacci_grid(50)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"bandwidth": 8}, ValueError, r"50 samples do not determine b² = 64 coefficients; give a smoothness > 0"),
        ({"values": np.ones(49)}, ValueError, r"values must have shape .*50\), got \(49,\)"),
        ({"values": np.full(50, np.nan)}, ValueError, "values must be finite, got 50"),
        ({"weights": np.ones(49)}, ValueError, r"weights must have shape .*got \(49,\)"),
        ({"weights": -np.ones(50)}, ValueError, "weights must .*non-negative"),
        ({"weights": np.zeros(50)}, ValueError, "weights must .*not all zero"),
        ({"weights": np.ones((2, 50))}, ValueError, r"weights must have shape \(n,\) = \(50,\)"),
        ({"smoothness": -1}, ValueError, "smoothness must be >= 0, got -1"),
        ({"smoothness": "a"}, TypeError, "smoothness must be a number, got str 'a'"),
        ({"smoothness": np.inf}, ValueError, "smoothness must be finite, got inf"),
        ({"tolerance": 0}, ValueError, "tolerance must be > 0, got 0"),
        ({"max_iterations": 0}, ValueError, "max_iterations must be at least 1, got 0"),
        ({"directions": np.ones((50, 3))}, ValueError, "directions must be unit vectors"),
    ],
)
def test_errors(options: dict[str, object], error: type, message: str) -> None:
    arguments = {"values": np.ones(50), "directions": GRID, "bandwidth": 3} | options
    with pytest.raises(error, match=message):
        fsh.fit_coefficients(**arguments)  # type: ignore[arg-type]
