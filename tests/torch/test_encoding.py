"""Points as fields on shells: the sums that are documented, the descriptor's fields, gradients, invariances."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry import surface_of
from tests.geometry.mesh_shapes import box
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, randn, rotation  # noqa: E402

SMALL = fsh.SHDOption(bandwidth=4, shells=4, samples=256)
BOTH = dataclasses.replace(
    SMALL, widths=(0.5, 0.3), normal_width=0.5, frames=(0.0, 1.0), bands=2, invariant="cross_shell"
)


def test_fields_are_the_sums_that_are_documented():
    points, weights = randn(30, 3), torch.rand(30, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    encoder = ft.ShellEncoder(SMALL, dtype=torch.float64)
    p, w = points.numpy(), weights.numpy() / float(weights.sum())
    p = p - w @ p
    p /= np.sqrt(w @ (p**2).sum(1))
    fields, s, sigma = SMALL.shell_fields, SMALL.smoothing, SMALL.widths[0]
    transform = fsh.SphericalHarmonicTransform(4)
    expected = []
    for radius in fields.radii:
        x = radius * transform.grid.directions
        inside = (p**2).sum(1) < SMALL.radius**2
        kernel = np.exp(-((x[:, None] - p[inside]) ** 2).sum(2) / (2 * s * s))
        distance2 = -2 * s * s * np.log(np.maximum(kernel @ w[inside], np.exp(-700)))
        expected.append(transform.forward(np.exp(-distance2 / (2 * sigma**2)) * radius * np.sqrt(4 * np.pi)))
    assert difference(encoder(points, weights), np.array(expected)) < 1e-12


@pytest.mark.parametrize("option", [SMALL, BOTH], ids=["energies", "cross-shell"])
def test_it_is_the_descriptor_without_its_voxels(option):
    """The descriptor tends to it as its voxels shrink: twice as many a side, about a quarter of the difference."""
    samples = surface_of(box((0.5, 1.0, 1.5)), 256)
    cloud = fsh.PointArrays(samples.points, samples.normals)
    surface = surface_of(cloud, 256)  # with the weights that the descriptor gives to a cloud's points
    encoder = ft.ShellEncoder(option, dtype=torch.float64)
    found = encoder.feature(*map(torch.tensor, (surface.points, surface.weights, surface.normals)))
    error = [
        difference(found, fsh.shd_descriptor(cloud, dataclasses.replace(option, voxels=voxels))) for voxels in (40, 80)
    ]
    assert error[1] < 0.5 * error[0] < 0.1


def test_gradients_down_to_the_points():
    points, normals = randn(1, 6, 3, grad=True), randn(1, 6, 3, seed=4, grad=True)
    weights = (1 + 0.1 * randn(1, 6)).requires_grad_()
    option = dataclasses.replace(BOTH, bandwidth=2, shells=2, bands=1)
    feature = ft.ShellEncoder(option, dtype=torch.float64).feature
    assert torch.autograd.gradcheck(feature, (points, weights, normals), atol=1e-4, rtol=1e-3)
    assert torch.autograd.gradcheck(lambda p: ft.encode(p, dataclasses.replace(SMALL, bandwidth=2, shells=2)), points)


def test_position_size_and_rotation_do_not_count():
    points, normals = randn(40, 3), randn(40, 3, seed=1)
    encoder = ft.ShellEncoder(BOTH, dtype=torch.float64)
    before = encoder.feature(points, None, normals)
    assert difference(encoder.feature(7 * points + 3, None, normals), before) < 1e-12
    matrix = rotation(2)
    after = encoder.feature(points @ matrix.mT, None, normals @ matrix.mT)
    # A field has some energy beyond the degrees that are kept, and what is sampled of it turns a little.
    assert difference(after, before) < 0.1
    assert difference(encoder(points.expand(2, -1, -1))[1], encoder(points)) < 1e-13


def test_blocks_do_not_show(monkeypatch):
    points = randn(20, 3, grad=True)
    encoder = ft.ShellEncoder(SMALL, dtype=torch.float64)
    whole = encoder(points)
    (slope,) = torch.autograd.grad(whole.square().sum(), points)
    monkeypatch.setattr("fsh3d_o3d.torch.encoding._BLOCK", 2000)
    parts = encoder(points)
    assert difference(parts, whole) < 1e-14
    assert difference(torch.autograd.grad(parts.square().sum(), points)[0], slope) < 1e-13


def test_compilers_autocast_and_devices():
    encoder, points = ft.ShellEncoder(SMALL), randn(20, 3, dtype=torch.float32)
    expected = encoder(points)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(encoder(points), expected)
    assert difference(torch.compile(encoder, backend="aot_eager")(points), expected) < 1e-6
    assert (
        difference(encoder.double()(points.double()), ft.ShellEncoder(SMALL, dtype=torch.float64)(points.double())) == 0
    )
    assert encoder.to("meta")(points.double().to("meta")).shape == (4, 16)


def test_bad_input_is_named():
    encoder = ft.ShellEncoder(SMALL, dtype=torch.float64)
    points = randn(5, 3)
    for call, kind, message in (
        (lambda: encoder(points[:, :2]), ValueError, r"shape \(…, n, 3\)"),
        (lambda: encoder(points / 0), ValueError, "points must be finite"),
        (lambda: encoder(points.float()), TypeError, "points are torch.float32"),
        (lambda: encoder(points, torch.ones(4).double()), ValueError, r"weights must have shape \(5,\)"),
        (lambda: ft.ShellEncoder(fsh.SHDOption.published()), ValueError, "covariance"),
        (lambda: ft.ShellEncoder(fsh.SHDOption(route="exact")), ValueError, "nearest"),
        (lambda: ft.ShellEncoder(3), TypeError, "SHDOption"),
        (lambda: ft.encode(points.numpy()), TypeError, "ndarray"),
    ):
        with pytest.raises(kind, match=message):
            call()
    only = dataclasses.replace(SMALL, widths=(), normal_width=0.5)
    with pytest.raises(ValueError, match="the cloud has no normals"):
        ft.ShellEncoder(only).double()(points)
    assert encoder(randn(0, 5, 3)).shape == (0, 4, 16)
