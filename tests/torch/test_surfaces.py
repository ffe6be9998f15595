"""Decoded surfaces: the vertices and normals of the shapes, and gradients down to coefficients and centres."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from tests.geometry.mesh_shapes import box
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, randn  # noqa: E402


@pytest.fixture(scope="module")
def radial():
    return fsh.RadialShape.from_geometry(box((0.5, 1.0, 1.5)), 8)


@pytest.fixture(scope="module")
def conformal():
    return fsh.ConformalShape.from_geometry(box((0.5, 1.0, 1.5)), 8)


def test_radial_surfaces_are_those_of_the_shape(radial):
    mesh, normals = radial.mesh_arrays(642)
    decoder = ft.RadialDecoder(10, 642, dtype=torch.float64)
    found = decoder(torch.tensor(radial.coefficients), torch.tensor(radial.center))
    assert difference(found.vertices, mesh.vertices) < 1e-13
    assert difference(found.normals, normals) < 1e-12  # ducc0's derivatives are b times less exact than its values
    assert np.array_equal(decoder.triangles.numpy(), mesh.triangles)
    many = decoder(torch.tensor(radial.coefficients).expand(2, 3, -1), randn(3, 3))
    assert many.vertices.shape == many.normals.shape == (2, 3, 642, 3)


def test_conformal_surfaces_are_those_of_the_shape(conformal):
    mesh, normals = conformal.mesh_arrays(642)
    found = ft.ConformalDecoder(8, 642, dtype=torch.float64)(torch.tensor(conformal.coefficients))
    assert difference(found.vertices, mesh.vertices) < 1e-13
    assert difference(found.normals, normals) < 1e-11  # a product of two derivatives


def test_gradients(radial, conformal):
    places = fsh.fibonacci_grid(12).directions
    star = ft.RadialDecoder(3, directions=places, dtype=torch.float64)
    assert star.triangles.shape == (0, 3)
    coefficients = (0.1 * randn(2, 9) + torch.eye(9, dtype=torch.float64)[0] * 4).requires_grad_()
    assert torch.autograd.gradcheck(star, (coefficients, randn(2, 3, grad=True)))
    assert torch.autograd.gradgradcheck(lambda c: star(c).normals, coefficients)
    genus0 = ft.ConformalDecoder(3, directions=torch.tensor(places), dtype=torch.float64)
    sphere = torch.zeros(3, 9, dtype=torch.float64)
    sphere[[0, 1, 2], [3, 1, 2]] = 2.0
    bent = (sphere + 0.1 * randn(1, 3, 9)).requires_grad_()
    assert torch.autograd.gradcheck(genus0, bent)
    assert torch.autograd.gradgradcheck(lambda c: genus0(c).normals, bent)


def test_the_enclosed_volume_has_the_gradient_that_it_should(radial):
    """dV/dc of ∫ r³/3 is ∫ r² Y: through triangles, up to what they cut off, which shrinks with their area."""
    coefficients = torch.tensor(radial.coefficients, requires_grad=True)
    decoder = ft.RadialDecoder(8, 10_242, dtype=torch.float64)
    a, b, c = decoder(coefficients).vertices[decoder.triangles].unbind(-2)
    volume = (a * torch.linalg.cross(b, c)).sum() / 6
    (found,) = torch.autograd.grad(volume, coefficients)
    exact = fsh.SphericalHarmonicTransform(12)
    expected = exact.forward(exact.inverse(radial.coefficients) ** 2)[:64]
    assert float(volume.detach()) == pytest.approx(radial.volume, rel=2e-3)
    assert difference(found, expected) < 5e-3


def test_decoders_move_and_stay_exact(radial):
    decoder = ft.RadialDecoder(8, 42)
    coefficients = torch.tensor(radial.coefficients)
    assert (
        difference(decoder.double()(coefficients).vertices, radial.mesh_arrays(42)[0].vertices - radial.center) < 1e-13
    )
    away = decoder.to("meta")(coefficients.to("meta"))
    assert away.normals.shape == (42, 3) and away.normals.device.type == "meta"


def test_bad_input_is_named():
    decoder = ft.RadialDecoder(3, 12)
    for call, kind, message in (
        (lambda: decoder(torch.zeros(16)), ValueError, "bandwidth 4, the decoder of 3"),
        (lambda: decoder(torch.zeros(9).double()), TypeError, "float64 and the decoder's buffers"),
        (lambda: decoder(torch.ones(9), torch.ones(2)), ValueError, r"center must have shape \(…, 3\)"),
        (lambda: ft.ConformalDecoder(3, 12)(torch.ones(2, 9)), ValueError, r"shape \(…, 3, b²\), got \(2, 9\)"),
        (lambda: ft.RadialDecoder(3, directions=np.ones((4, 3))), ValueError, "unit vectors"),
        (lambda: ft.RadialDecoder(0), ValueError, "bandwidth"),
    ):
        with pytest.raises(kind, match=message):
            call()
    assert decoder(torch.zeros(0, 9)).vertices.shape == (0, 12, 3)
