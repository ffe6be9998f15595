"""Coefficients for e3nn: against its harmonics where it is installed, against its published low degrees everywhere."""

from __future__ import annotations

import pytest

from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, randn  # noqa: E402

NORMALIZATIONS = ["integral", "component", "norm"]


@pytest.mark.parametrize("normalization", NORMALIZATIONS)
def test_functions_are_the_same_in_e3nn(normalization):
    o3 = pytest.importorskip("e3nn.o3", reason="e3nn is not installed: its convention is checked to degree 2 alone")
    coefficients, directions = randn(3, 64), randn(20, 3)
    harmonics = o3.spherical_harmonics(list(range(8)), directions, normalize=True, normalization=normalization)
    found = ft.to_e3nn(coefficients, normalization) @ harmonics.mT
    assert difference(found, ft.evaluate(coefficients, directions)) < 1e-13


@pytest.mark.parametrize("normalization", NORMALIZATIONS)
def test_low_degrees_are_as_e3nn_documents_them(normalization):
    """Degree 1 is x, y, z; degree 2 √3 xz, √3 xy, y² − (x² + z²)/2, √3 yz, √3/2 (z² − x²), of norm 1 each."""
    coefficients, directions = randn(9), torch.nn.functional.normalize(randn(20, 3), dim=-1)
    x, y, z = directions.unbind(-1)
    root = 3**0.5
    second = [root * x * z, root * x * y, y * y - (x * x + z * z) / 2, root * y * z, root / 2 * (z * z - x * x)]
    harmonics = torch.stack([torch.ones_like(x), x, y, z, *second], -1)
    scale = {"norm": [1, 1, 1], "component": [1, 3**0.5, 5**0.5]}
    scale["integral"] = [part / (4 * torch.pi) ** 0.5 for part in scale["component"]]
    factors = torch.tensor([scale[normalization][degree] for degree in (0, 1, 1, 1, 2, 2, 2, 2, 2)])
    found = (harmonics * factors) @ ft.to_e3nn(coefficients, normalization)
    assert difference(found, ft.evaluate(coefficients, directions)) < 1e-7  # factors in float32


@pytest.mark.parametrize("normalization", NORMALIZATIONS)
def test_there_and_back(normalization):
    coefficients = randn(2, 3, 49, grad=True)
    assert difference(ft.from_e3nn(ft.to_e3nn(coefficients, normalization), normalization), coefficients) < 1e-14
    small = randn(2, 9, grad=True)
    for function in (ft.to_e3nn, ft.from_e3nn):
        assert torch.autograd.gradcheck(lambda c, f=function: f(c, normalization), small)


def test_other_names_are_refused():
    with pytest.raises(ValueError, match="normalization must be one of"):
        ft.to_e3nn(randn(9), "orthonormal")
