"""Rotation of coefficients and correlation over rotations: exact, and with gradients along the rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, exponential, randn, rotation  # noqa: E402


@given(st.integers(1, 24), st.lists(st.integers(0, 3), max_size=2), st.integers(0, 9))
def test_the_numbers_are_those_of_the_numpy_layer(b, batch, seed):
    coefficients, matrix = randn(*batch, b * b, seed=seed), rotation(seed)
    found = ft.rotate_coefficients(coefficients, matrix)
    assert difference(found, fsh.rotate_coefficients(coefficients.numpy(), matrix.numpy())) < 1e-13


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, np.pi])
def test_gradients_at_any_rotation(angle):
    """At the identity and at half turns angles are singular; rotations are not."""
    vector = (angle * randn(2, 1, 3) / randn(2, 1, 3).norm(dim=-1, keepdim=True)).requires_grad_()
    coefficients = randn(2, 2, 16, grad=True)

    def turned(c, w):
        return ft.rotate_coefficients(c, exponential(w))

    assert torch.autograd.gradcheck(turned, (coefficients, vector))
    if angle == 1:
        assert torch.autograd.gradgradcheck(turned, (coefficients, vector))


def test_the_gradient_is_tangent():
    """A step along it stays among the rotations to first order: Rᵀ G is antisymmetric."""
    matrix = rotation(3).requires_grad_()
    ft.rotate_coefficients(randn(25), matrix).cos().sum().backward()
    inside = matrix.detach().mT @ matrix.grad
    assert difference(inside, -inside.mT) < 1e-14


@pytest.mark.parametrize(("functions", "own"), [((), ()), ((3,), ()), ((2, 3), (2, 1)), ((), (4,)), ((0,), ())])
def test_leading_axes_broadcast(functions, own):
    coefficients, matrices = randn(*functions, 16, grad=True), rotation(1, *own)
    found = ft.rotate_coefficients(coefficients, matrices)
    leading = torch.broadcast_shapes(functions, own)
    assert found.shape == (*leading, 16)
    wide = coefficients.expand(*leading, 16).reshape(-1, 16), matrices.expand(*leading, 3, 3).reshape(-1, 3, 3)
    each = [ft.rotate_coefficients(one, matrix) for one, matrix in zip(*wide, strict=True)]
    assert difference(found.reshape(-1, 16), torch.stack(each) if each else torch.zeros(0, 16)) < 1e-14


def test_correlation_is_that_of_rotated_functions():
    source, target, matrices = randn(2, 3, 36, grad=True), randn(2, 3, 36, seed=1, grad=True), rotation(2, 5)
    found = ft.correlation(source, target, matrices)
    turned = [ft.rotate_coefficients(source, matrix) for matrix in matrices]
    assert difference(found, torch.stack([(one * target).sum((-1, -2)) for one in turned], -1)) < 1e-14
    grid = ft.CorrelationGrid(6, dtype=torch.float64)
    flat = ft.correlation(source, target, grid.rotations.reshape(-1, 3, 3))
    assert difference(grid(source, target).reshape(2, -1), flat) < 1e-13


def test_gradients_of_correlations():
    source, target, vectors = randn(2, 9, grad=True), randn(2, 9, seed=1, grad=True), randn(2, 3, grad=True)

    def at(s, t, w):
        return ft.correlation(s, t, exponential(w))

    assert torch.autograd.gradcheck(at, (source, target, vectors))
    assert torch.autograd.gradcheck(ft.CorrelationGrid(3, fineness=1, dtype=torch.float64), (source, target))


def test_following_the_gradient_aligns():
    """From the grid's best guess uphill to the rotation that was applied, as ``estimate_rotation`` finds it."""
    source = randn(2, 36)
    true = rotation(11)
    target = ft.rotate_coefficients(source, true)
    grid = ft.CorrelationGrid(6, dtype=torch.float64)
    best = grid.rotations.reshape(-1, 3, 3)[grid(source, target).argmax()]
    vector = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([vector], max_iter=50, line_search_fn="strong_wolfe", tolerance_grad=1e-12)

    def loss():
        optimiser.zero_grad()
        value = -ft.correlation(source, target, (exponential(vector) @ best)[None])[0]
        value.backward()
        return value

    optimiser.step(loss)
    # The maximum of a parabola is known to the root of the rounding of its value.
    assert float((exponential(vector) @ best - true).detach().abs().max()) < 1e-6


def test_float32_and_compilers():
    source, matrix = randn(3, 64, dtype=torch.float32), rotation(1)
    found = ft.rotate_coefficients(source, matrix.float())
    assert found.dtype == torch.float32
    assert difference(found, ft.rotate_coefficients(source.double(), matrix)) < 1e-6
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(ft.rotate_coefficients(source, matrix.float()), found)
    compiled = torch.compile(ft.rotate_coefficients, backend="aot_eager", fullgraph=True)
    assert difference(compiled(source, matrix.float()), found) < 1e-6


def test_bad_input_is_named():
    coefficients, matrix = randn(2, 16), rotation()
    for call, kind, message in (
        (lambda: ft.rotate_coefficients(coefficients, 2 * matrix), ValueError, "R Rᵀ differs from the identity"),
        (lambda: ft.rotate_coefficients(coefficients, -matrix), ValueError, "reflection"),
        (lambda: ft.rotate_coefficients(coefficients, matrix.float()), TypeError, "float64 and rotation"),
        (lambda: ft.rotate_coefficients(coefficients, matrix[:2]), ValueError, r"shape \(…, 3, 3\), got \(2, 3\)"),
        (lambda: ft.rotate_coefficients(coefficients, rotation(0, 3)), ValueError, "leading axes of rotation"),
        (lambda: ft.correlation(coefficients, coefficients[:1], matrix[None]), ValueError, "must both have shape"),
        (lambda: ft.correlation(coefficients, coefficients, matrix), ValueError, r"shape \(k, 3, 3\)"),
        (lambda: ft.CorrelationGrid(3).double()(coefficients, coefficients), ValueError, "bandwidth 4, the grid is fo"),
    ):
        with pytest.raises(kind, match=message):
            call()
