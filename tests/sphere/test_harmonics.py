"""Harmonics against scipy and against identities that hold at any degree."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from fsh3d_o3d import _validation
from fsh3d_o3d.errors import MemoryEstimateError
from fsh3d_o3d.sphere.harmonics import analyse_exactly, harmonics_by_degree
from fsh3d_o3d.sphere.nufft_engine import analyse_directly
from tests.sphere.oracles import real_harmonics, scattered

POLES_AND_AXES = np.concatenate([np.eye(3), -np.eye(3), [[1e-9, 0, 1]], [[0, -1e-4, -np.sqrt(1 - 1e-8)]]])


def test_every_harmonic_up_to_degree_40_against_scipy(rng: np.random.Generator) -> None:
    directions = np.concatenate([scattered(rng, 300), POLES_AND_AXES])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    difference = fsh.spherical_harmonics(directions, 41) - real_harmonics(directions, 41)
    assert np.abs(difference).max() < 1e-13  # some hundred roundings; values reach 2.5


def test_low_degrees_written_out(rng: np.random.Generator) -> None:
    directions = scattered(rng, 50)
    x, y, z = directions.T
    one, linear, square = np.sqrt([1 / (4 * np.pi), 3 / (4 * np.pi), 15 / (4 * np.pi)])
    expected = np.stack(
        [
            np.full(50, one),
            *(linear * y, linear * z, linear * x),
            *(square * x * y, square * y * z, square / np.sqrt(12) * (3 * z * z - 1), square * x * z),
            square / 2 * (x * x - y * y),
        ],
        axis=1,
    )
    assert np.abs(fsh.spherical_harmonics(directions, 3) - expected).max() < 1e-15


@pytest.mark.parametrize("b", [1, 2, 200])
def test_addition_theorem(b: int, rng: np.random.Generator) -> None:
    """Σ_m Y(l, m)² = (2l+1)/4π everywhere."""
    degree = np.arange(b)
    table = fsh.spherical_harmonics(np.concatenate([scattered(rng, 20), np.eye(3)]), b)
    sums = np.add.reduceat(table**2, degree**2, axis=1) * 4 * np.pi / (2 * degree + 1)
    assert np.abs(sums - 1).max() < 1e-12  # errors grow as the degree times rounding


@pytest.mark.parametrize("sine", [0.02, np.exp(-1), 0.6])
def test_addition_theorem_up_to_the_largest_bandwidth(sine: float) -> None:
    """From degree 1926 on sin^m θ would underflow for orders that matter (worst where sin θ = 1/e)."""
    degree = np.arange(1900)
    (row,) = fsh.spherical_harmonics([[sine, 0, np.sqrt(1 - sine**2)]], 1900)
    sums = np.add.reduceat(row**2, degree**2) * 4 * np.pi / (2 * degree + 1)
    assert np.abs(sums - 1).max() < 1e-10


def test_degrees_and_orders() -> None:
    degree, order = fsh.degrees_and_orders(40)
    pairs = [(l, m) for l in range(40) for m in range(-l, l + 1)]  # noqa: E741
    assert list(zip(degree.tolist(), order.tolist(), strict=True)) == pairs
    assert degree.dtype == order.dtype == np.int64
    # Either side of a large square: no rounding of the square root.
    degree, order = fsh.degrees_and_orders(1500)
    assert (degree[1499**2 - 1], degree[1499**2], order[-1]) == (1498, 1499, 1499)


def test_arrays_of_each_degree_are_fresh(rng: np.random.Generator) -> None:
    directions = scattered(rng, 7)
    table = fsh.spherical_harmonics(directions, 6)
    kept = list(harmonics_by_degree(directions, 6))  # drawn to the end before use
    for degree, cosine, sine in kept:
        centre = degree * degree + degree
        # The table's directions are normalised once more, which moves them by a rounding.
        assert np.abs(cosine.T - table[:, centre : centre + degree + 1]).max() < 1e-14
        assert np.abs(sine[::-1].T - table[:, degree * degree : centre]).max(initial=0) < 1e-14


@given(n=st.integers(1, 1200), b=st.integers(1, 9), seed=st.integers(0, 2**31))
def test_exact_sums(n: int, b: int, seed: int) -> None:
    """Both point-by-point sums, with sizes on all sides of the block length 512."""
    rng = np.random.default_rng(seed)
    grid, values = fsh.grid_from_directions(scattered(rng, n)), rng.standard_normal(n)
    expected = values @ real_harmonics(grid.directions, b)
    scale = np.abs(values).sum()  # rounding of a sum is relative to its terms
    assert np.abs(analyse_exactly(grid.directions, values, b) - expected).max() < 1e-14 * scale
    assert np.abs(analyse_directly(values, b, grid) - expected).max() < 1e-14 * scale


def test_inputs_are_checked() -> None:
    with pytest.raises(ValueError, match=r"directions must be unit vectors"):
        fsh.spherical_harmonics([[0, 0, 3]], 4)
    with pytest.raises(TypeError, match=r"bandwidth must be an integer, got float 4.0"):
        fsh.spherical_harmonics([[0, 0, 1]], 4.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"bandwidth must be between 1 and 1900, got 2600"):
        fsh.spherical_harmonics([[0, 0, 1]], 2600)


def test_memory_is_estimated_and_the_estimate_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    directions = fsh.fibonacci_grid(10_000).directions
    estimates: list[float] = []
    monkeypatch.setattr(_validation, "memory", lambda estimate, *_: estimates.append(estimate))
    tracemalloc.start()
    fsh.spherical_harmonics(directions, 24)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(estimates) == 1
    assert estimates[0] / 2 < peak <= estimates[0] * 1.05


def test_matrices_that_do_not_fit_are_refused() -> None:
    directions = fsh.fibonacci_grid(10_000).directions
    with pytest.raises(MemoryEstimateError, match=r"matrix of 3610000 harmonics at 10000 directions needs about \d+"):
        fsh.spherical_harmonics(directions, 1900)
