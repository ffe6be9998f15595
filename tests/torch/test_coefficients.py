"""Energies and filters by degree, with gradients."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from fsh3d_o3d.torch.coefficients import by_degree, from_degrees  # noqa: E402
from tests.torch.cases import difference, randn  # noqa: E402


def test_energies():
    coefficients = randn(3, 2, 49, grad=True)
    assert difference(ft.degree_energies(coefficients), fsh.degree_energies(coefficients.detach().numpy())) < 1e-15
    assert torch.autograd.gradcheck(ft.degree_energies, coefficients)
    assert torch.autograd.gradgradcheck(ft.degree_energies, randn(9, grad=True))


def test_a_degree_that_is_zero_has_no_slope():
    coefficients = torch.zeros(9, dtype=torch.float64, requires_grad=True)
    ft.degree_energies(coefficients).sum().backward()
    assert torch.equal(coefficients.grad, torch.zeros(9, dtype=torch.float64))


def test_filters():
    coefficients, time = randn(2, 25, grad=True), torch.tensor([0.1, 0.3], dtype=torch.float64, requires_grad=True)
    gains = ft.heat_filter(5, time)
    assert np.allclose(gains.detach().numpy(), [fsh.heat_filter(5, 0.1), fsh.heat_filter(5, 0.3)], rtol=1e-15)
    expected = fsh.filter_coefficients(coefficients.detach().numpy()[1], fsh.heat_filter(5, 0.3))
    assert difference(ft.filter_coefficients(coefficients, gains)[1], expected) < 1e-15
    assert torch.autograd.gradcheck(lambda c, t: ft.filter_coefficients(c, ft.heat_filter(5, t)), (coefficients, time))


def test_by_degree_and_back():
    coefficients = randn(3, 36, grad=True)
    assert torch.equal(from_degrees(by_degree(coefficients)), coefficients)
    assert torch.autograd.gradcheck(lambda c: from_degrees(by_degree(c).sin()), coefficients)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"gain_per_degree must have shape \(…, b\) = \(…, 3\), got \(4,\)"):
        ft.filter_coefficients(randn(9), randn(4))
    with pytest.raises(ValueError, match=r"time must be >= 0, got -1"):
        ft.heat_filter(3, torch.tensor(-1.0))
    with pytest.raises(TypeError, match=r"time must be a torch\.Tensor, got float"):
        ft.heat_filter(3, 0.1)
    with pytest.raises(ValueError, match="must be finite"):
        ft.degree_energies(randn(9) / 0)
