"""Values and gradients at any directions: the NumPy layer's numbers, derivatives, shapes, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from fsh3d_o3d.torch import recursion, sparse_maps, sums  # noqa: E402
from tests.torch.cases import difference, randn  # noqa: E402


def unit(vectors):
    return vectors / vectors.norm(dim=-1, keepdim=True)


@given(st.integers(1, 30), st.lists(st.integers(0, 3), max_size=2), st.integers(1, 40), st.integers(0, 9))
def test_values_are_those_of_the_numpy_layer(b, batch, count, seed):
    coefficients, directions = randn(*batch, b * b, seed=seed), randn(count, 3, seed=seed + 1)
    found = ft.evaluate(coefficients, directions)
    # Few points say little of the norm of a function: relative to that of the coefficients, which bounds both.
    scale = b * float(coefficients.norm()) + 1e-300
    expected = fsh.evaluate(coefficients.numpy(), unit(directions).numpy())
    assert np.linalg.norm(found.numpy() - expected) < 1e-13 * scale


@pytest.mark.parametrize("b", [1, 2, 5, 14])
def test_gradients_are_those_of_the_numpy_layer(b):
    coefficients, directions = randn(b * b), unit(randn(30, 3))
    found = ft.evaluate_gradient(coefficients, directions)
    # ducc0's derivatives are b times as large as the values, and as many times less exact.
    assert np.abs(found.numpy() - fsh.evaluate_gradient(coefficients.numpy(), directions.numpy())).max() < 1e-12 * b
    assert float((found * directions).sum(-1).abs().max()) < 1e-13 * b * b  # tangent


@pytest.mark.parametrize("b", [1, 4, 13])  # the recursion, and ducc0's fast transform
def test_derivatives_of_both_arguments(b):
    coefficients, directions = randn(2, b * b, grad=True), randn(5, 3, grad=True)
    for function in (ft.evaluate, ft.evaluate_gradient):
        # Finite differences of 1e-6 of functions that change within 1/b.
        assert torch.autograd.gradcheck(function, (coefficients, directions), atol=1e-5 * b, rtol=1e-3)
    if b == 4:
        assert torch.autograd.gradgradcheck(ft.evaluate, (coefficients, directions))


def test_a_complex_step_finds_the_same_slope():
    """Independent of differences: x + ih of a polynomial of degree 3, whose slope the imaginary part is to rounding."""
    directions = unit(randn(20, 3)).requires_grad_()
    grid = fsh.fibonacci_grid(96)
    samples = grid.directions[:, 0] ** 2 * grid.directions[:, 2] - grid.directions[:, 1]
    coefficients = torch.from_numpy(fsh.SphericalHarmonicTransform(4, grid).forward(samples))
    step = randn(20, 3, seed=1)
    (slope,) = torch.autograd.grad(ft.evaluate(coefficients, directions).sum(), directions)
    moved = directions.detach() + 1e-30j * step
    moved = moved / (moved * moved).sum(-1, keepdim=True).sqrt()
    expected = (moved[:, 0] ** 2 * moved[:, 2] - moved[:, 1]).imag / 1e-30
    # Only rounding of the transform remains.
    assert float(((slope * step).sum(-1) - expected).abs().max()) < 1e-13


def test_poles_are_places_like_others():
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1]], dtype=torch.float64, requires_grad=True)
    coefficients = randn(100)
    (slope,) = torch.autograd.grad(ft.evaluate(coefficients, poles).sum(), poles)
    assert bool(torch.isfinite(slope).all())
    assert difference(slope, ft.evaluate_gradient(coefficients, poles)) < 1e-12
    assert torch.autograd.gradcheck(lambda places: ft.evaluate(coefficients[:25], places), poles)


def test_only_where_vectors_point_counts():
    coefficients, directions = randn(36), randn(9, 3)
    assert difference(ft.evaluate(coefficients, 7 * directions), ft.evaluate(coefficients, directions)) < 1e-14


@pytest.mark.parametrize(
    ("functions", "places"),
    [((), ()), ((3,), ()), ((2, 3), (1,)), ((2, 3), (2, 1)), ((2, 3), (2, 3)), ((), (4,)), ((0,), ()), ((2, 1), (3,))],
)
def test_leading_axes_broadcast(functions, places):
    coefficients, directions = randn(*functions, 16, grad=True), randn(*places, 5, 3, grad=True)
    values = ft.evaluate(coefficients, directions)
    leading = torch.broadcast_shapes(functions, places)
    assert values.shape == (*leading, 5)
    wide = coefficients.expand(*leading, 16).reshape(-1, 16), directions.expand(*leading, 5, 3).reshape(-1, 5, 3)
    each = [ft.evaluate(one, where) for one, where in zip(*wide, strict=True)]
    expected = torch.stack(each) if each else torch.zeros(0, 5, dtype=torch.float64)
    assert difference(values.reshape(-1, 5), expected) < 1e-14
    own = torch.autograd.grad(values.sum() + 0 * coefficients.sum(), (coefficients, directions), allow_unused=True)
    assert own[0].shape == coefficients.shape
    assert ft.evaluate_gradient(coefficients, directions).shape == (*leading, 5, 3)


def test_engines_agree_and_blocks_do_not_show():
    coefficients, directions = randn(1, 2, 20 * 20), unit(randn(1, 30_000, 3))
    slow = recursion.synthesise(coefficients, directions)
    assert len(list(recursion.blocks(30_000, 20, torch.device("cpu")))) > 1
    assert difference(sums.synthesise(coefficients, directions), slow) < 2e-13
    values = randn(1, 2, 30_000)
    assert difference(sums.analyse(values, directions, 20), recursion.analyse(values, directions, 20)) < 2e-13


def test_derivatives_are_band_limited():
    """Rotating by a small angle is what the map of infinitesimal rotations says."""
    coefficients = randn(49)
    for axis in range(3):
        angle = 1e-5
        vector = np.eye(3)[axis] * angle
        cross = np.cross(vector, np.eye(3)).T
        near = [np.eye(3) + sign * cross + cross @ cross / 2 for sign in (1, -1)]
        turned = [fsh.rotate_coefficients(coefficients.numpy(), matrix) for matrix in near]
        found = sparse_maps.turned(coefficients)[axis]
        # The square of the step, times the third derivative.
        assert np.abs((turned[0] - turned[1]) / (2 * angle) - found.numpy()).max() < 1e-6
    for kind in ("gradient", "rotation"):
        assert torch.autograd.gradcheck(lambda c, k=kind: sparse_maps._apply(c, k, False), randn(2, 16, grad=True))


def test_bad_input_is_named():
    coefficients, directions = randn(16), randn(5, 3)
    for call, kind, message in (
        (lambda: ft.evaluate(coefficients, directions.float()), TypeError, "coefficients are torch.float64 and direct"),
        (lambda: ft.evaluate(coefficients.to("meta"), directions), ValueError, "on meta and directions on cpu"),
        (lambda: ft.evaluate(coefficients, directions * 0), ValueError, "5 vectors are zero"),
        (lambda: ft.evaluate(coefficients, directions[:, :2]), ValueError, r"shape \(…, m, 3\), got \(5, 2\)"),
        (lambda: ft.evaluate(coefficients / 0, directions), ValueError, "must be finite"),
        (lambda: ft.evaluate(coefficients, directions / 0), ValueError, "must be finite"),
        (lambda: ft.evaluate(randn(2, 16), randn(3, 5, 3)), ValueError, "leading axes of directions"),
        (lambda: ft.evaluate(coefficients.half(), directions), TypeError, "float32 or float64"),
    ):
        with pytest.raises(kind, match=message):
            call()


def test_values_are_looked_at_on_the_cpu_alone():
    """On a device the answer would have to be waited for; there, anomaly detection asks."""
    result = ft.evaluate(torch.empty(16, device="meta"), torch.empty(5, 3, device="meta"))
    assert result.shape == (5,) and result.device.type == "meta"
