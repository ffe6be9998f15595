"""Equivariant layers: turned input, turned output, in float32 to rounding; and e3nn's convention."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, randn, rotation  # noqa: E402


@pytest.mark.parametrize("b", [1, 2, 7, 12])
def test_a_network_is_equivariant_in_float32(b):
    torch.manual_seed(1)
    layers = ft.ZonalConvolution(3, 5, b), ft.QuadraticNonlinearity(5, b), ft.ZonalConvolution(5, 2, b)
    network = torch.nn.Sequential(*layers)
    coefficients, matrix = randn(4, 3, b * b, dtype=torch.float32), rotation(b).float()
    turned = network(ft.rotate_coefficients(coefficients, matrix))
    assert difference(turned, ft.rotate_coefficients(network(coefficients), matrix)) < 1e-6


def test_convolution_multiplies_each_degree_by_a_gain():
    layer = ft.ZonalConvolution(2, 3, 5, dtype=torch.float64)
    coefficients = randn(4, 2, 25)
    gains = layer.weight.detach()[1, 0]
    single = torch.cat((coefficients[:, :1], torch.zeros(4, 1, 25, dtype=torch.float64)), 1)
    expected = fsh.filter_coefficients(coefficients[:, 0].numpy(), gains.numpy())
    assert difference(layer(single)[:, 1], expected) < 1e-14
    torch.nn.init.constant_(layer.bias, 2.0)
    transform = fsh.SphericalHarmonicTransform(5)
    constant = layer(torch.zeros(2, 25, dtype=torch.float64)).detach().numpy()
    assert np.allclose(transform.inverse(constant), 2.0)


def test_squares_are_exact():
    """The product of two functions, against a transform of bandwidth 2b that loses no degree."""
    layer = ft.QuadraticNonlinearity(1, 6, dtype=torch.float64)
    torch.nn.init.zeros_(layer.linear)
    coefficients = randn(1, 36)
    wide = fsh.SphericalHarmonicTransform(12)
    square = wide.forward(wide.inverse(coefficients.numpy()) ** 2)[:, :36]
    mean = float(coefficients.square().sum()) / (4 * np.pi)
    assert difference(layer(coefficients), square / np.sqrt(1 + mean)) < 1e-14


def test_gradients():
    coefficients = randn(2, 2, 9, grad=True)
    for layer in (
        ft.ZonalConvolution(2, 3, 3, dtype=torch.float64),
        ft.QuadraticNonlinearity(2, 3, dtype=torch.float64),
    ):
        parameters = tuple(layer.parameters())
        assert torch.autograd.gradcheck(lambda c, *_, own=layer: own(c), (coefficients, *parameters))
        assert torch.autograd.gradgradcheck(layer, coefficients)


def test_compilers_and_autocast():
    network = torch.nn.Sequential(ft.ZonalConvolution(2, 3, 4), ft.QuadraticNonlinearity(3, 4))
    coefficients = randn(5, 2, 16, dtype=torch.float32)
    expected = network(coefficients)
    compiled = torch.compile(network, backend="aot_eager", fullgraph=True)
    assert difference(compiled(coefficients), expected) < 1e-6
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(network(coefficients), expected)


def test_bad_input_is_named():
    layer = ft.ZonalConvolution(2, 3, 4)
    with pytest.raises(ValueError, match="bandwidth 5, the layer of 4"):
        layer(randn(2, 25, dtype=torch.float32))
    with pytest.raises(ValueError, match=r"shape \(…, 2, b²\), got \(3, 16\)"):
        layer(randn(3, 16, dtype=torch.float32))
    with pytest.raises(TypeError, match=r"coefficients are torch\.float64 and the layer's weights torch\.float32"):
        layer(randn(2, 16))
    assert layer(torch.zeros(0, 2, 16)).shape == (0, 3, 16)
