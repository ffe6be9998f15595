"""Conversions against functions evaluated with the other harmonics."""

from __future__ import annotations

import ducc0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import factorial, lpmv

import fsh3d_o3d as fsh
from tests.sphere.oracles import angles, complex_harmonics, scattered


def paper_harmonics(directions: np.ndarray, bandwidth: int) -> np.ndarray:
    """Eq. (1) as the authors compute it: (−1)^m N P e^{imφ}, P with the Condon–Shortley phase (scipy's lpmv)."""
    theta, phi = angles(directions)
    columns = []
    for l in range(bandwidth):  # noqa: E741
        for m in range(-l, l + 1):
            k = abs(m)
            norm = np.sqrt((2 * l + 1) / (4 * np.pi) * factorial(l - k) / factorial(l + k))
            value = (-1) ** k * norm * lpmv(k, l, np.cos(theta)) * np.exp(1j * k * phi)
            columns.append(value if m >= 0 else (-1) ** k * value.conj())
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    ("convention", "harmonics"), [("condon_shortley", complex_harmonics), ("paper", paper_harmonics)]
)
def test_complex_coefficients_give_the_same_function(
    convention: str, harmonics: object, rng: np.random.Generator
) -> None:
    b = 9
    directions, coefficients = scattered(rng, 40), rng.standard_normal((2, b * b))
    found = fsh.to_complex(coefficients, convention) @ harmonics(directions, b).T  # type: ignore[operator,arg-type]
    assert np.abs(found.imag).max() < 1e-13
    assert np.abs(found.real - fsh.evaluate(coefficients, directions)).max() < 1e-12


def test_complex_coefficients_are_inner_products(rng: np.random.Generator) -> None:
    """f̂(l, m) = ∫ f conj(Y) (Eq. 3), by quadrature with scipy's harmonics."""
    transform = fsh.SphericalHarmonicTransform(6)
    values = fsh.evaluate(rng.standard_normal(36), transform.grid)
    expected = (transform.weights * values) @ complex_harmonics(transform.grid.directions, 6).conj()
    assert np.abs(fsh.to_complex(transform.forward(values)) - expected).max() < 1e-13


def test_relation_of_the_conventions(rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal(25)
    _, order = fsh.degrees_and_orders(5)
    sign = (-1.0) ** order
    shortley, paper = fsh.to_complex(coefficients), fsh.to_complex(coefficients, "paper")
    assert np.array_equal(paper, sign * shortley)
    mirror = np.array([l * l + l - m for l in range(5) for m in range(-l, l + 1)])  # noqa: E741
    for own in (shortley, paper):
        assert np.abs(own[mirror] - sign * own.conj()).max() < 1e-15


@pytest.mark.parametrize("geometry", ["GL", "CC"])
def test_packed_layout_is_that_of_ducc0(geometry: str, rng: np.random.Generator) -> None:
    """ducc0 (whose layout is healpy's) synthesises the packed coefficients on a grid of its own."""
    b, rows, columns = 12, 16, 27
    coefficients = rng.standard_normal((2, b * b))
    if geometry == "GL":
        nodes = np.polynomial.legendre.leggauss(rows)[0][::-1]
        theta = np.arccos(nodes)
    else:
        theta = np.linspace(0, np.pi, rows)
    phi = 2 * np.pi * np.arange(columns) / columns
    directions = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.repeat(np.cos(theta)[:, None], columns, 1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    for own in coefficients:
        values = ducc0.sht.synthesis_2d(
            alm=fsh.to_packed(own)[None], spin=0, lmax=b - 1, geometry=geometry, ntheta=rows, nphi=columns
        )
        assert np.abs(values.ravel() - fsh.evaluate(own, directions)).max() < 1e-12


def test_packed_order_is_that_of_healpy(rng: np.random.Generator) -> None:
    """healpy.Alm.getidx: m (2 l_max + 1 − m)/2 + l."""
    b = 5
    coefficients = rng.standard_normal(b * b)
    packed, full = fsh.to_packed(coefficients), fsh.to_complex(coefficients)
    assert packed.shape == (15,)
    for m in range(b):
        for l in range(m, b):  # noqa: E741
            assert packed[m * (2 * (b - 1) + 1 - m) // 2 + l] == pytest.approx(full[l * l + l + m], abs=1e-15)


@given(
    b=st.integers(1, 12),
    batch=st.lists(st.integers(0, 3), max_size=2).map(tuple),
    single=st.booleans(),
    seed=st.integers(0, 2**31),
)
def test_round_trips(b: int, batch: tuple[int, ...], single: bool, seed: int) -> None:
    dtype = np.float32 if single else np.float64
    coefficients = np.random.default_rng(seed).standard_normal((*batch, b * b)).astype(dtype)
    epsilon = 4 * np.finfo(dtype).eps * np.abs(coefficients).max(initial=0)
    there = [fsh.to_complex(coefficients), fsh.to_complex(coefficients, "paper"), fsh.to_packed(coefficients)]
    back = [fsh.from_complex(there[0]), fsh.from_complex(there[1], "paper"), fsh.from_packed(there[2])]
    for other, again in zip(there, back, strict=True):
        assert other.dtype == (np.complex64 if single else np.complex128)
        assert again.dtype == dtype and again.shape == coefficients.shape
        assert np.abs(again - coefficients).max(initial=0) <= epsilon


def test_norms_are_kept(rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal(49)
    assert np.linalg.norm(fsh.to_complex(coefficients)) == pytest.approx(np.linalg.norm(coefficients), rel=1e-14)


def test_real_input_to_from_complex() -> None:
    assert fsh.from_complex([2, 0, 3, 0]).tolist() == [2, 0, 3, 0]
    assert fsh.from_packed([2, 3, 0]).tolist() == [2, 0, 3, 0]


@pytest.mark.parametrize("convention", ["condon_shortley", "paper"])
def test_coefficients_of_complex_functions_are_refused(convention: str) -> None:
    with pytest.raises(ValueError, match=r"not those of a real function.*by up to"):
        fsh.from_complex([0, 1, 0, 1j], convention)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"not those of a real function"):
        fsh.from_complex([1j], convention)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: fsh.to_complex(np.ones(4), "scipy"),
            ValueError,
            "convention must be one of 'condon_shortley', 'paper', got 'scipy'",
        ),
        (lambda: fsh.from_complex(np.ones(4), None), ValueError, "convention must be one of"),
        (lambda: fsh.to_complex(np.ones(3)), ValueError, "square number"),
        (lambda: fsh.to_complex(np.ones(4) * 1j), TypeError, "real numbers, got dtype complex128"),
        (lambda: fsh.from_complex(["a"]), TypeError, "coefficients must be numbers"),
        (lambda: fsh.from_complex([np.nan]), ValueError, "coefficients must be finite"),
        (lambda: fsh.from_complex([complex(0, np.inf)]), ValueError, "coefficients must be finite"),
        (lambda: fsh.from_packed(np.ones(4)), ValueError, r"must have shape \(…, b\(b\+1\)/2\), got \(4,\)"),
        (lambda: fsh.from_packed(1.0), ValueError, r"got \(\)"),
        (lambda: fsh.from_packed([np.nan]), ValueError, "packed coefficients must be finite"),
        (lambda: fsh.from_packed(["a"]), TypeError, "packed coefficients must be numbers"),
        (lambda: fsh.from_packed([1, 1j, 0]), ValueError, "not those of a real function"),
    ],
)
def test_errors(call: object, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        call()  # type: ignore[operator]


def test_weights_of_the_paper(rng: np.random.Generator) -> None:
    """docs/conventions.md: w^{(b)} = w/(√2π √4π) satisfies Eq. (11), and makes Eq. (12) 1/√4π times Eq. (3)."""
    transform = fsh.SphericalHarmonicTransform(5)
    directions = transform.grid.directions
    paper = transform.weights / (np.sqrt(2 * np.pi) * np.sqrt(4 * np.pi))
    equation_11 = np.sqrt(2 * np.pi) * paper @ paper_harmonics(directions, 10).conj()
    assert np.abs(equation_11 - np.eye(100)[0]).max() < 1e-14
    assert paper.sum() == pytest.approx(np.sqrt(2), rel=1e-14)
    coefficients = rng.standard_normal(25)
    values = fsh.evaluate(coefficients, directions)
    equation_12 = np.sqrt(2 * np.pi) * (paper * values) @ paper_harmonics(directions, 5).conj()
    assert np.abs(equation_12 * np.sqrt(4 * np.pi) - fsh.to_complex(coefficients, "paper")).max() < 1e-13
