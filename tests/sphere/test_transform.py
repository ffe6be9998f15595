"""The transform: round trips, integrals, rotations, shapes, dtypes, threads."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import fsh3d_o3d as fsh
from fsh3d_o3d import _validation
from fsh3d_o3d.errors import MemoryEstimateError, QuadratureWarning
from tests.sphere.oracles import real_harmonics, relative_l2, scattered

BATCHES = [(), (3,), (2, 3), (0,), (2, 0), (1, 1, 70)]


# -- round trips


@pytest.mark.parametrize("b", [1, 2, 3, 16, 48])
def test_dense_round_trip(b: int, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(b, engine="dense")
    coefficients = rng.standard_normal((2, b * b))
    # Rounding of sums of 6b² terms.
    assert relative_l2(transform.forward(transform.inverse(coefficients)), coefficients) < 5e-15


@pytest.mark.parametrize("b", [1, 2, 3, 16, 64, 128])
def test_fast_round_trip(b: int, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(b, engine="nufft")
    coefficients = rng.standard_normal(b * b)
    # The tolerance that the non-uniform transforms are asked for, met twice: there and back.
    assert relative_l2(transform.forward(transform.inverse(coefficients)), coefficients) < 3e-13


@given(
    b=st.integers(1, 12),
    batch=st.lists(st.integers(0, 3), max_size=2).map(tuple),
    engine=st.sampled_from(["auto", "dense", "nufft"]),
    scale=st.sampled_from([1e-200, 1e-30, 1.0, 1e30, 1e200]),
    seed=st.integers(0, 2**31),
)
def test_round_trips_of_any_shape_and_size(b: int, batch: tuple, engine: str, scale: float, seed: int) -> None:
    transform = fsh.SphericalHarmonicTransform(b, engine=engine)  # type: ignore[arg-type]
    coefficients = scale * np.random.default_rng(seed).standard_normal((*batch, b * b))
    again = transform.forward(transform.inverse(coefficients))
    assert again.shape == coefficients.shape
    assert np.abs(again - coefficients).max(initial=0) <= 1e-12 * np.abs(coefficients).max(initial=0)


@given(st.integers(1, 10).flatmap(lambda b: arrays.arrays(np.float64, b * b, elements=st.floats(-1e100, 1e100))))
@example(np.array([5e-324]))
@example(np.full(100, -5e-324))
@example(np.array([1e-310, 5e-324, 0, 1e100]))
@settings(max_examples=15)
def test_hostile_coefficients(coefficients: np.ndarray) -> None:
    """Zeros, denormals and huge values side by side: errors stay relative to the largest.

    Nothing is relative to a denormal, which has fewer digits: below the smallest normal number errors are absolute.
    """
    b = math.isqrt(len(coefficients))
    transform = fsh.SphericalHarmonicTransform(b)
    again = transform.forward(transform.inverse(coefficients))
    bound = 1e-13 * b * np.abs(coefficients).max() + np.finfo(np.float64).tiny
    assert np.abs(again - coefficients).max() <= bound


@pytest.mark.parametrize(
    ("grid", "weights"),
    [
        (fsh.equiangular_grid(12), fsh.driscoll_healy_weights(12)),
        (fsh.fibonacci_grid(901), None),
        (fsh.icosahedral_grid(2), None),
    ],
    ids=["Driscoll–Healy", "odd Fibonacci", "icosahedral"],
)
def test_other_grids_are_exact_too(grid: fsh.SphericalGrid, weights: object, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(12, grid, weights)
    coefficients = rng.standard_normal(144)
    assert relative_l2(transform.forward(transform.inverse(coefficients)), coefficients) < 1e-13


def test_equal_weights_are_not_exact(rng: np.random.Generator) -> None:
    """What the analytic weights are for: equal ones err by 1e-3 (the paper's Fig. 3)."""
    grid = fsh.fibonacci_grid(6 * 16**2)
    transform = fsh.SphericalHarmonicTransform(16, grid, fsh.equal_weights(grid))
    coefficients = rng.standard_normal(256)
    assert 1e-5 < relative_l2(transform.forward(transform.inverse(coefficients)), coefficients) < 1e-1


# -- analytic truths


@pytest.mark.parametrize("engine", ["dense", "nufft"])
def test_integrals(engine: str) -> None:
    """f̂(0, 0)·√4π is the integral: ∫1 = 4π, ∫x² = 4π/3, ∫x²y² = 4π/15, ∫z = 0."""
    transform = fsh.SphericalHarmonicTransform(6, engine=engine)  # type: ignore[arg-type]
    x, y, z = transform.grid.directions.T
    integrals = transform.forward([np.ones_like(x), x * x, x * x * y * y, z])[:, 0] * np.sqrt(4 * np.pi)
    assert np.abs(integrals - 4 * np.pi * np.array([1, 1 / 3, 1 / 15, 0])).max() < 1e-12


def test_coefficients_of_written_out_functions() -> None:
    transform = fsh.SphericalHarmonicTransform(5)
    x, y, z = transform.grid.directions.T
    found = transform.forward([x, y, z, x * y])
    expected = np.zeros((4, 25))
    expected[[0, 1, 2], [3, 1, 2]] = np.sqrt(4 * np.pi / 3)
    expected[3, 4] = np.sqrt(4 * np.pi / 15)
    assert np.abs(found - expected).max() < 1e-14


def test_every_harmonic_of_scipy_is_one_coefficient() -> None:
    b = 20  # up to degree 40 in test_harmonics
    transform = fsh.SphericalHarmonicTransform(b, engine="dense")
    basis = real_harmonics(transform.grid.directions, b)
    assert np.abs(transform.forward(basis.T) - np.eye(b * b)).max() < 1e-13


def test_parseval(rng: np.random.Generator) -> None:
    """Σ c² = ∫ f²; f² has degree 2b − 2, which the weights of bandwidth b still integrate."""
    transform = fsh.SphericalHarmonicTransform(20)
    coefficients = rng.standard_normal(400)
    values = transform.inverse(coefficients)
    assert transform.weights @ values**2 == pytest.approx((coefficients**2).sum(), rel=1e-12)


@pytest.mark.parametrize(("degree", "order"), [(1, 0), (3, -2), (9, 9), (17, 4)])
def test_rotated_harmonic_stays_in_its_degree(degree: int, order: int, random_rotation: np.ndarray) -> None:
    transform = fsh.SphericalHarmonicTransform(20)
    single = np.zeros(400)
    single[degree * degree + degree + order] = 1
    rotated = transform.forward(fsh.evaluate(single, transform.grid.directions @ random_rotation))
    expected = np.zeros(20)
    expected[degree] = 1
    assert np.abs(fsh.degree_energies(rotated) - expected).max() < 1e-12


def test_energies_do_not_change_when_the_grid_is_rotated(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    transform = fsh.SphericalHarmonicTransform(24)
    coefficients = rng.standard_normal((3, 576))
    rotated = transform.forward(fsh.evaluate(coefficients, transform.grid.directions @ random_rotation))
    assert np.abs(fsh.degree_energies(rotated) / fsh.degree_energies(coefficients) - 1).max() < 1e-11


@pytest.mark.parametrize("engine", ["dense", "nufft"])
def test_linearity(engine: str, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(10, engine=engine)  # type: ignore[arg-type]
    f, g = rng.standard_normal((2, 600))
    combined = transform.forward(2.5 * f - g)
    assert np.abs(combined - 2.5 * transform.forward(f) + transform.forward(g)).max() < 1e-12


# -- shapes, dtypes, batches


@pytest.mark.parametrize("engine", ["auto", "dense", "nufft"])
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("threads", [1, 2])
def test_batches(engine: str, batch: tuple[int, ...], threads: int, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(5, engine=engine, threads=threads)  # type: ignore[arg-type]
    values = rng.standard_normal((*batch, 150))
    coefficients = transform.forward(values)
    assert coefficients.shape == (*batch, 25)
    assert transform.inverse(coefficients).shape == values.shape
    assert fsh.evaluate(coefficients, np.eye(3), threads=threads).shape == (*batch, 3)
    expected = (values * transform.weights) @ real_harmonics(transform.grid.directions, 5)
    assert np.allclose(coefficients, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("engine", ["dense", "nufft"])
def test_single_precision_stays_single(engine: str, rng: np.random.Generator) -> None:
    b = 20
    transform = fsh.SphericalHarmonicTransform(b, engine=engine)  # type: ignore[arg-type]
    coefficients = rng.standard_normal((4, b * b)).astype(np.float32)
    values = transform.inverse(coefficients)
    again = transform.forward(values)
    assert values.dtype == again.dtype == np.float32
    assert 1e-9 < relative_l2(again, coefficients) < 1e-5  # single: 1e-7 times sums of 2,400 terms
    assert fsh.evaluate(coefficients, np.eye(3)).dtype == np.float32


@pytest.mark.parametrize("dtype", [np.int8, np.int64, np.uint16, bool, np.float16, ">f8"])
def test_other_numbers_become_double(dtype: object, rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(4)
    values = rng.integers(0, 2, 96).astype(dtype)
    found = transform.forward(values)
    assert found.dtype == np.float64
    assert np.array_equal(found, transform.forward(values.astype(float)))


def test_inputs_may_be_strided_and_are_left_alone(rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(4)
    values = rng.standard_normal((96, 3))
    before = values.copy()
    assert np.array_equal(transform.forward(values.T), transform.forward(values.T.copy()))
    assert np.array_equal(values, before)


def test_fewer_coefficients_are_lower_degrees(rng: np.random.Generator) -> None:
    transform = fsh.SphericalHarmonicTransform(6)
    low = rng.standard_normal((2, 9))
    padded = np.concatenate([low, np.zeros((2, 27))], axis=1)
    assert np.array_equal(transform.inverse(low), transform.inverse(padded))


# -- threads


@pytest.mark.parametrize("engine", ["dense", "nufft"])
@pytest.mark.parametrize("batch", [(), (1,), (3,), (65,)])
def test_threads_do_not_change_a_byte(engine: str, batch: tuple[int, ...], rng: np.random.Generator) -> None:
    one, two = (fsh.SphericalHarmonicTransform(32, engine=engine, threads=k) for k in (1, 2))  # type: ignore[arg-type]
    directions = scattered(rng, 1001)
    for dtype in (np.float64, np.float32):
        values = rng.standard_normal((*batch, len(one.grid))).astype(dtype)
        coefficients = one.forward(values)
        exact = batch in ((), (1,))
        pairs = [
            (coefficients, two.forward(values), exact or engine == "dense"),
            (one.inverse(coefficients), two.inverse(coefficients), exact or engine == "dense"),
            # Chooses its engine by itself: the fast one for many functions.
            (*(fsh.evaluate(coefficients, directions, threads=k) for k in (1, 2)), exact),
        ]
        for found, again, same in pairs:
            if same:
                assert found.tobytes() == again.tobytes()
            else:  # to a few roundings: see "Determinism" in docs/conventions.md
                assert np.abs(found - again).max() <= 64 * np.finfo(dtype).eps * np.abs(found).max()


# -- evaluation


@pytest.mark.parametrize("b", [1, 4, 16, 40])
def test_evaluate_against_scipy_with_poles(b: int, rng: np.random.Generator) -> None:
    directions = np.concatenate([scattered(rng, 30), np.eye(3), -np.eye(3)])
    coefficients = rng.standard_normal((2, b * b))
    expected = coefficients @ real_harmonics(directions, b).T
    assert np.abs(fsh.evaluate(coefficients, directions) - expected).max() < 1e-12 * b
    grid = fsh.grid_from_directions(directions)
    assert np.array_equal(fsh.evaluate(coefficients, grid), fsh.evaluate(coefficients, directions))


def test_value_at_the_poles(rng: np.random.Generator) -> None:
    """Only order 0 is left: Σ_l c(l, 0) √((2l+1)/4π) (±1)^l."""
    b = 30
    coefficients = rng.standard_normal(b * b)
    degree = np.arange(b)
    zonal = coefficients[degree**2 + degree] * np.sqrt((2 * degree + 1) / (4 * np.pi))
    north, south = fsh.evaluate(coefficients, [[0, 0, 1], [0, 0, -1]])
    assert north == pytest.approx(zonal.sum(), abs=1e-11)
    assert south == pytest.approx((zonal * (-1.0) ** degree).sum(), abs=1e-11)


def test_gradient_of_height(rng: np.random.Generator) -> None:
    """The gradient of z on the sphere is e_z − z ω, also at the poles."""
    directions = np.concatenate([scattered(rng, 50), np.eye(3), -np.eye(3)])
    coefficients = np.array([0.3, 0, np.sqrt(4 * np.pi / 3), 0])
    expected = np.array([0, 0, 1]) - directions[:, 2:] * directions
    assert np.abs(fsh.evaluate_gradient(coefficients, directions) - expected).max() < 1e-12


@pytest.mark.parametrize("b", [2, 3, 12])
def test_gradient_against_differences(b: int, rng: np.random.Generator) -> None:
    directions = np.concatenate([scattered(rng, 20), [[0, 0, 1], [0, 0, -1], [1e-8, 0, 1]]])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    coefficients, step = rng.standard_normal(b * b), 1e-5
    gradient = fsh.evaluate_gradient(coefficients, directions)
    assert np.abs(np.einsum("ij,ij->i", gradient, directions)).max() < 1e-11  # tangent
    tangents = np.cross(directions, scattered(rng, len(directions)))
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    ahead, behind = (np.cos(step) * directions + sign * np.sin(step) * tangents for sign in (1, -1))
    difference = (fsh.evaluate(coefficients, ahead) - fsh.evaluate(coefficients, behind)) / (2 * step)
    # step² times third derivatives (b³ times the values) and the transform's error over the step.
    assert np.abs(np.einsum("ij,ij->i", gradient, tangents) - difference).max() < 1e-7 * b


def test_gradient_of_a_constant_and_of_single_precision() -> None:
    assert not fsh.evaluate_gradient([3.0], np.eye(3)).any()
    gradient = fsh.evaluate_gradient(np.array([0, 0, 1, 0], dtype=np.float32), np.eye(3))
    assert gradient.dtype == np.float64 and gradient.shape == (3, 3)


# -- least squares as analysis


def test_least_squares_where_weights_fail(rng: np.random.Generator) -> None:
    """n = 4b² at b = 32: quadrature is a warning and 1e-5, least squares recovers to rounding."""
    grid = fsh.fibonacci_grid(4096)
    transform = fsh.SphericalHarmonicTransform(32, grid, analysis="least_squares")
    coefficients = rng.standard_normal((2, 1024))
    values = transform.inverse(coefficients)
    assert relative_l2(transform.forward(values), coefficients) < 2e-12
    assert transform.forward(values.astype(np.float32)).dtype == np.float32
    assert relative_l2(transform.forward(values.astype(np.float32)), coefficients) < 1e-4
    assert transform.forward(np.zeros((0, 4096))).shape == (0, 1024)
    with pytest.warns(QuadratureWarning):
        weak = fsh.SphericalHarmonicTransform(32, grid)
    assert relative_l2(weak.forward(values), coefficients) < 1e-2


# -- the plan


def test_default_plan() -> None:
    transform = fsh.SphericalHarmonicTransform(7)
    assert transform.bandwidth == 7
    assert transform.grid is fsh.fibonacci_grid(294)
    assert np.array_equal(transform.weights, fsh.analytic_weights(transform.grid, 7).weights)
    assert repr(transform) == (
        "SphericalHarmonicTransform(bandwidth=7, grid=SphericalGrid('fibonacci', 294 directions), "
        "weights=<float64 294>, engine='auto', analysis='quadrature', threads=None)"
    )
    with pytest.raises(ValueError, match=r"read-only"):
        transform.weights[0] = 1


def test_given_weights_are_copied() -> None:
    grid = fsh.fibonacci_grid(24)
    weights = fsh.equal_weights(grid)
    transform = fsh.SphericalHarmonicTransform(2, grid, weights)
    weights[:] = 0  # the caller's array stays writeable, and the plan keeps its own
    assert transform.weights.sum() == pytest.approx(4 * np.pi)
    solution = fsh.analytic_weights(grid, 2)
    assert np.array_equal(fsh.SphericalHarmonicTransform(2, grid, solution).weights, solution.weights)


def test_oversampling() -> None:
    assert len(fsh.SphericalHarmonicTransform(8, oversampling=2).grid) == 512
    assert len(fsh.SphericalHarmonicTransform(3, oversampling=1.6).grid) == 58
    with pytest.raises(ValueError, match=r"a grid or an oversampling, not both"):
        fsh.SphericalHarmonicTransform(2, fsh.fibonacci_grid(24), oversampling=1.5)
    with pytest.raises(ValueError, match=r"oversampling must be >= 1 and <= 1000, got 0.5"):
        fsh.SphericalHarmonicTransform(2, oversampling=0.5)


GRID = fsh.fibonacci_grid(24)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: fsh.SphericalHarmonicTransform(0), ValueError, "bandwidth must be between 1 and 4096, got 0"),
        (lambda: fsh.SphericalHarmonicTransform(-4), ValueError, "bandwidth must be between 1 and 4096, got -4"),
        (lambda: fsh.SphericalHarmonicTransform(5000), ValueError, "bandwidth must be between 1 and 4096, got 5000"),
        (lambda: fsh.SphericalHarmonicTransform("8"), TypeError, "bandwidth must be an integer, got str '8'"),
        (lambda: fsh.SphericalHarmonicTransform(2, np.eye(3)), TypeError, "grid must be a SphericalGrid, got ndarray"),
        (
            lambda: fsh.SphericalHarmonicTransform(2, GRID, np.ones(23)),
            ValueError,
            r"weights must have shape .*24\), got \(23,\)",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2, GRID, np.ones((2, 24))),
            ValueError,
            r"weights must have shape \(n,\) = \(24,\)",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2, GRID, np.full(24, np.nan)),
            ValueError,
            "weights must be finite, got 24",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2, engine="fast"),
            ValueError,
            "engine must be one of 'auto'.*got 'fast'",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2, analysis="exact"),
            ValueError,
            "analysis must be one of 'quadrature'",
        ),
        (lambda: fsh.SphericalHarmonicTransform(2, threads=0), ValueError, "threads must be between 1 and 1024, got 0"),
        (
            lambda: fsh.SphericalHarmonicTransform(2).forward(np.ones(23)),
            ValueError,
            r"values must have shape \(…, n\) = \(…, 24\), got \(23,\)",
        ),
        (lambda: fsh.SphericalHarmonicTransform(2).forward(3.0), ValueError, r"values must have shape .*got \(\)"),
        (lambda: fsh.SphericalHarmonicTransform(2).forward([np.inf] * 24), ValueError, "values must be finite, got 24"),
        (
            lambda: fsh.SphericalHarmonicTransform(2).forward(["a"] * 24),
            TypeError,
            "values must be an array of real numbers",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2).forward(np.ones(24) * 1j),
            TypeError,
            "real numbers, got dtype complex128",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2).inverse(np.ones(5)),
            ValueError,
            r"coefficients must have shape \(…, b²\).*got \(5,\)",
        ),
        (
            lambda: fsh.SphericalHarmonicTransform(2).inverse(np.ones(9)),
            ValueError,
            "of bandwidth 3, the transform of 2; truncate",
        ),
        (lambda: fsh.evaluate(np.ones(4), [[0, 0, 5]]), ValueError, "directions must be unit vectors"),
        (lambda: fsh.evaluate([], np.eye(3)), ValueError, "coefficients must have shape"),
        (lambda: fsh.evaluate(2.0, np.eye(3)), ValueError, "coefficients must have shape"),
        (lambda: fsh.evaluate([np.nan], np.eye(3)), ValueError, "coefficients must be finite, got 1 NaN"),
        (
            lambda: fsh.evaluate_gradient(np.ones((2, 4)), np.eye(3)),
            ValueError,
            r"coefficients must have shape \(b²,\), got \(2, 4\)",
        ),
    ],
)
def test_errors_name_argument_expectation_and_input(call: object, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        call()  # type: ignore[operator]


def test_absurd_requests_are_refused_before_anything_is_allocated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_validation, "_available_memory", lambda: 2.0 * 2**30)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    with pytest.raises(MemoryEstimateError, match=r"GiB"):
        fsh.SphericalHarmonicTransform(3000)
    with pytest.raises(MemoryEstimateError, match=r"GiB"):
        fsh.fibonacci_grid(90_000_000)
    with pytest.raises(ValueError, match=r"n must be between"):
        fsh.fibonacci_grid(10**12)


def test_the_largest_bandwidth_is_refused_by_its_own_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """6·4096² points are more than a grid may have: say so in terms of what the caller gave, or of memory."""
    monkeypatch.setattr(_validation, "_available_memory", lambda: 2.0 * 2**30)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    with pytest.raises(ValueError, match=r"bandwidth|GiB"):
        fsh.SphericalHarmonicTransform(4096)


def test_available_memory_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert math.isfinite(fsh.SphericalHarmonicTransform(2).weights.sum())
    monkeypatch.setattr(_validation, "_available_memory", lambda: 1e3)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    with pytest.raises(MemoryEstimateError):
        fsh.SphericalHarmonicTransform(9, fsh.fibonacci_grid(499), fsh.equal_weights(fsh.fibonacci_grid(499))).forward(
            np.ones(499)
        )
