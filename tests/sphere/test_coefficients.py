"""Energies, truncation and filters, written out degree by degree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh


@given(b=st.integers(1, 12), batch=st.lists(st.integers(0, 3), max_size=2).map(tuple), seed=st.integers(0, 2**31))
def test_energies_are_norms_of_degrees(b: int, batch: tuple[int, ...], seed: int) -> None:
    coefficients = np.random.default_rng(seed).standard_normal((*batch, b * b))
    energies = fsh.degree_energies(coefficients)
    assert energies.shape == (*batch, b)
    for degree in range(b):
        own = coefficients[..., degree**2 : (degree + 1) ** 2]
        assert np.allclose(energies[..., degree], np.linalg.norm(own, axis=-1), rtol=1e-14)


@pytest.mark.parametrize("scale", [1e200, 1e-200, 1e-310, 1e300])
def test_energies_of_extreme_size(scale: float, rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal(16)
    energies = fsh.degree_energies(coefficients * scale)
    assert np.isfinite(energies).all()
    # Denormal numbers (1e-310) carry 13 digits.
    assert np.allclose(energies / scale, fsh.degree_energies(coefficients), rtol=1e-14 if scale != 1e-310 else 1e-11)


def test_energies_of_zero_and_of_single_precision() -> None:
    assert fsh.degree_energies(np.zeros((2, 9))).tolist() == [[0, 0, 0]] * 2
    energies = fsh.degree_energies(np.array([1e30, 0, 3e30, 4e30], dtype=np.float32))
    assert energies.dtype == np.float32
    assert np.allclose(energies, [1e30, 5e30], rtol=1e-6)


def test_a_degree_beside_a_much_larger_one_keeps_its_energy() -> None:
    assert fsh.degree_energies([1e200, 3e-10, 0, 4e-10]).tolist() == pytest.approx([1e200, 5e-10], rel=1e-14)


def test_truncate(rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal((2, 25))
    low = fsh.truncate(coefficients, 3)
    assert np.array_equal(low, coefficients[:, :9])
    low[:] = 0  # a copy
    assert coefficients[:, :9].all()
    assert np.array_equal(fsh.truncate(coefficients, 5), coefficients)
    with pytest.raises(ValueError, match=r"bandwidth must be between 1 and 5, got 6"):
        fsh.truncate(coefficients, 6)


def test_filter_multiplies_each_degree(rng: np.random.Generator) -> None:
    coefficients, gains = rng.standard_normal((2, 16)), rng.standard_normal(4)
    filtered = fsh.filter_coefficients(coefficients, gains)
    for degree in range(4):
        own = slice(degree**2, (degree + 1) ** 2)
        assert np.array_equal(filtered[:, own], coefficients[:, own] * gains[degree])
    assert np.array_equal(fsh.filter_coefficients(coefficients, lambda degree: gains[degree]), filtered)
    assert fsh.filter_coefficients(coefficients.astype(np.float32), gains).dtype == np.float32


def test_filters_written_out() -> None:
    degree = np.arange(6)
    assert fsh.ideal_filter(6, 4).tolist() == [1, 1, 1, 1, 0, 0]
    assert fsh.ideal_filter(3, 9).tolist() == [1, 1, 1]
    assert np.allclose(fsh.heat_filter(6, 0.1), np.exp(-0.1 * degree * (degree + 1)), rtol=1e-15)
    assert fsh.heat_filter(6, 0).tolist() == [1] * 6
    sigma = [1, *(np.sin(np.pi * k / 6) / (np.pi * k / 6) for k in range(1, 6))]
    assert np.allclose(fsh.lanczos_filter(6), sigma, rtol=1e-15)


def test_heat_flows_on_the_sphere(rng: np.random.Generator) -> None:
    """Heat for s and then for t is heat for s + t, and keeps the mean."""
    s, t = rng.uniform(0, 0.1, 2)
    assert np.allclose(fsh.heat_filter(8, s) * fsh.heat_filter(8, t), fsh.heat_filter(8, s + t), rtol=1e-13)
    assert fsh.heat_filter(8, 1e307).tolist() == [1, *[0] * 7]  # the end of time, without overflow


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fsh.filter_coefficients(np.ones(9), np.ones(4)),
            r"gain_per_degree must have shape \(b,\) = \(3,\), got \(4,\)",
        ),
        (lambda: fsh.filter_coefficients(np.ones(9), [1, np.inf, 1]), "gain_per_degree must be finite"),
        (lambda: fsh.filter_coefficients(np.ones(8), np.ones(3)), "coefficients must have shape"),
        (lambda: fsh.heat_filter(4, -1), "time must be >= 0, got -1"),
        (lambda: fsh.ideal_filter(4, -1), "cutoff must be at least 0, got -1"),
        (lambda: fsh.lanczos_filter(0), "bandwidth must be between"),
        (lambda: fsh.degree_energies([np.nan]), "coefficients must be finite, got 1 NaN or infinite of 1"),
        (lambda: fsh.degree_energies(np.ones((2, 0))), r"square number of coefficients last, got \(2, 0\)"),
    ],
)
def test_errors(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()  # type: ignore[operator]
