"""The transform as a module: the numbers of the NumPy layer, exact gradients, precision, devices, states, bad input."""

from __future__ import annotations

import copy
import pickle
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsh3d_o3d as fsh
from benchmarks._measure import peak_memory
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from tests.torch.cases import difference, randn  # noqa: E402

GRIDS = {
    "6b²": lambda b: None,
    "odd": lambda b: fsh.fibonacci_grid(6 * b * b + 1),
    "equiangular": fsh.equiangular_grid,
    "cube": lambda b: fsh.cube_grid(2 * b + 2),
}
WEIGHTS = {"equiangular": fsh.driscoll_healy_weights, "cube": lambda b: fsh.area_weights(fsh.cube_grid(2 * b + 2))}


def planned(b, grid, **options):
    weights = WEIGHTS.get(grid, lambda b: None)(b)
    return ft.SphericalHarmonicTransform(b, GRIDS[grid](b), weights, dtype=torch.float64, **options)


@given(
    st.integers(1, 28),
    st.lists(st.integers(0, 4), max_size=2),
    st.sampled_from(list(GRIDS)),
    st.sampled_from(["auto", "dense", "sums"]),
    st.integers(0, 9),
)
def test_the_numbers_are_those_of_the_numpy_layer(b, batch, grid, engine, seed):
    transform = planned(b, grid, engine=engine)
    values = randn(*batch, len(transform.grid), seed=seed)
    coefficients = randn(*batch, b * b, seed=seed + 1)
    # 1e-13 of the norm of the function, which is what ducc0 promises; matrices are some 1e-15 off.
    scale = float(values.norm()) * (4 * np.pi / len(transform.grid)) ** 0.5
    error = transform(values).numpy() - transform.plan.forward(values.numpy())
    assert np.linalg.norm(error) <= 1e-13 * scale
    assert difference(transform.inverse(coefficients), transform.plan.inverse(coefficients.numpy())) < 1e-13
    assert transform(values).shape == (*batch, b * b)
    assert transform.inverse(coefficients).shape == (*batch, len(transform.grid))


@pytest.mark.parametrize("engine", ["dense", "sums"])
@pytest.mark.parametrize("grid", GRIDS)
def test_gradients(engine, grid):
    transform = planned(2, grid, engine=engine)
    values, coefficients = randn(1, len(transform.grid), grad=True), randn(2, 4, grad=True)
    for function, argument in ((transform, values), (transform.inverse, coefficients)):
        assert torch.autograd.gradcheck(function, argument)
        assert torch.autograd.gradgradcheck(function, argument)


@pytest.mark.parametrize("engine", ["dense", "sums"])
def test_each_way_is_the_adjoint_of_the_other(engine):
    """⟨Y c, v⟩ = ⟨c, Yᵀ v⟩ at a bandwidth where finite differences say little."""
    transform = ft.SphericalHarmonicTransform(20, engine=engine, dtype=torch.float64)
    values, coefficients = randn(3, 2400, grad=True), randn(3, 400, seed=1, grad=True)
    other = randn(3, 2400, seed=2)
    (gradient,) = torch.autograd.grad(transform.inverse(coefficients), coefficients, other)
    assert difference(gradient, transform(other / transform.weights)) < 1e-12
    (gradient,) = torch.autograd.grad(transform(values), values, coefficients)
    assert difference(gradient, transform.inverse(coefficients) * transform.weights) < 1e-12


@pytest.mark.parametrize(("dtype", "limit"), [(torch.float64, 1e-14), (torch.float32, 1e-6)])
@pytest.mark.parametrize("b", [16, 32])
def test_round_trip(b, dtype, limit):
    """Rounding of a sum over 6b² points and b² coefficients; docs have the table up to b = 128."""
    transform = ft.SphericalHarmonicTransform(b, engine="dense", dtype=dtype)
    coefficients = randn(2, b * b, dtype=dtype)
    assert difference(transform(transform.inverse(coefficients)), coefficients) < limit


def test_fewer_coefficients_are_a_smoother_function():
    for engine in ("dense", "sums"):
        transform = ft.SphericalHarmonicTransform(6, engine=engine, dtype=torch.float64)
        coefficients = randn(2, 16)
        assert difference(transform(transform.inverse(coefficients))[:, :16], coefficients) < 1e-13


def test_precision_changes_lose_nothing():
    transform = ft.SphericalHarmonicTransform(5, dtype=torch.float64)
    values = randn(150)
    before = transform(values)
    assert transform.float()(values.float()).dtype == torch.float32
    assert torch.equal(transform.double()(values), before)
    assert torch.equal(copy.deepcopy(transform)(values), before)
    assert torch.equal(pickle.loads(pickle.dumps(transform))(values), before)
    with pytest.raises(TypeError, match=r"float32 or float64, not torch\.float16"):
        transform.half()
    assert torch.equal(transform(values), before)  # as if it had not been asked


def test_devices_are_those_of_the_module():
    """The device without memory stands in for those that this machine does not have: nothing may be read from it."""
    for engine in ("dense", "sums"):
        transform = ft.SphericalHarmonicTransform(20, engine=engine).to("meta")
        values = torch.empty(3, 2400, device="meta", requires_grad=True)
        coefficients = transform(values)
        assert coefficients.device.type == "meta" and coefficients.shape == (3, 400)
        transform.inverse(coefficients).sum().backward()
        assert values.grad.device.type == "meta"
    made = ft.SphericalHarmonicTransform(4, device="meta")
    assert all(part.device.type == "meta" for part in made.buffers())


def test_a_state_is_of_its_grid():
    transform = ft.SphericalHarmonicTransform(4)
    assert list(transform.state_dict()) == ["weights", "directions"]
    assert not list(transform.parameters())
    ft.SphericalHarmonicTransform(4).load_state_dict(transform.state_dict())
    with pytest.raises(RuntimeError, match="another grid, of 96 points where this one has 97"):
        ft.SphericalHarmonicTransform(4, fsh.fibonacci_grid(97)).load_state_dict(transform.state_dict())
    weighted = ft.SphericalHarmonicTransform(4, transform.grid, fsh.equal_weights(transform.grid), dtype=torch.float64)
    transform.load_state_dict(weighted.state_dict())
    assert torch.equal(transform.double().weights, weighted.weights.float().double())  # they stay, as they came


def test_the_same_call_gives_the_same_bytes():
    for engine in ("dense", "sums"):
        transform = ft.SphericalHarmonicTransform(16, engine=engine)
        values = randn(3, 1536, dtype=torch.float32, grad=True)
        runs = [(transform(values), *torch.autograd.grad(transform(values).square().sum(), values)) for _ in range(2)]
        assert all(torch.equal(one, other) for one, other in zip(*runs, strict=True))


def test_grids_without_exact_weights_warn_as_in_numpy():
    directions = fsh.fibonacci_grid(100).directions
    directions[:, 2] = np.abs(directions[:, 2])  # the northern half alone
    grid = fsh.grid_from_directions(directions)
    with pytest.warns(fsh.QuadratureWarning) as numpy_warning:
        fsh.SphericalHarmonicTransform(4, grid)
    with pytest.warns(fsh.QuadratureWarning) as ours:
        ft.SphericalHarmonicTransform(4, grid)
    assert str(ours[0].message) == str(numpy_warning[0].message)
    assert ours[0].filename == __file__


def test_bad_input_is_named():
    transform = ft.SphericalHarmonicTransform(3, dtype=torch.float64)
    good = randn(54)
    with pytest.raises(TypeError, match=r"values must be a torch\.Tensor, got ndarray"):
        transform(good.numpy())
    with pytest.raises(TypeError, match=r"values are torch\.float32 and the transform's buffers torch\.float64"):
        transform(good.float())
    with pytest.raises(TypeError, match=r"values must be float32 or float64, got torch\.int64"):
        transform(good.long())
    with pytest.raises(ValueError, match="values are on meta and the transform's buffers on cpu"):
        transform(good.to("meta"))
    with pytest.raises(ValueError, match="1 NaN or infinite of 54 values"):
        transform(torch.where(good == good[3], torch.nan, good))
    with pytest.raises(ValueError, match=r"values must have shape \(…, n\) = \(…, 54\), got \(5,\)"):
        transform(good[:5])
    with pytest.raises(ValueError, match="coefficients are of bandwidth 4, the transform of 3"):
        transform.inverse(randn(16))
    with pytest.raises(ValueError, match="square number of coefficients"):
        transform.inverse(randn(15))
    with pytest.raises(ValueError, match="do not learn"):
        ft.SphericalHarmonicTransform(3, weights=torch.ones(54, requires_grad=True))
    with pytest.raises(TypeError, match="grid"):
        ft.SphericalHarmonicTransform(3, good)
    with pytest.raises(ValueError, match="engine must be one of"):
        ft.SphericalHarmonicTransform(3, engine="fast")
    with pytest.raises(TypeError, match=r"dtype must be torch\.float32 or torch\.float64"):
        ft.SphericalHarmonicTransform(3, dtype=torch.int32)
    transform.weights.requires_grad_()
    with pytest.raises(ValueError, match="do not learn"):
        transform(good)


def test_under_autocast_it_keeps_its_precision():
    transform = ft.SphericalHarmonicTransform(8)
    values = randn(384, dtype=torch.float32)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(transform(values), transform.forward(values))
        halves = transform(values.bfloat16())
    assert torch.equal(transform(values), transform(values.clone()))
    assert halves.dtype == torch.float32
    assert torch.equal(halves, transform(values.bfloat16().float()))


@pytest.mark.parametrize("engine", ["dense", "sums"])
def test_it_compiles_in_one_piece(engine):
    """Without a compiler of C++, which not every machine has: what is traced, and the gradient of it."""
    transform = ft.SphericalHarmonicTransform(13, engine=engine, dtype=torch.float64)
    compiled = torch.compile(transform, backend="aot_eager", fullgraph=True)
    values = randn(2, len(transform.grid), grad=True)
    (expected,) = torch.autograd.grad(transform(values).square().sum(), values)
    (found,) = torch.autograd.grad(compiled(values).square().sum(), values)
    assert difference(found, expected) < 1e-13


MEMORY = """
import sys, torch
sys.path.insert(0, sys.argv[1])
from fsh3d_o3d import torch as ft
torch.set_num_threads(1)
transform = ft.SphericalHarmonicTransform(256, engine=sys.argv[2])
values = torch.ones(1, len(transform.grid), requires_grad=True)
transform(values).square().sum().backward()
assert bool(torch.isfinite(values.grad).all())
"""


def test_bandwidth_256_fits_into_two_gigabytes():
    root = fsh.__file__.rpartition("/fsh3d_o3d/")[0]
    assert peak_memory(MEMORY, root, "auto") < 2 * 2**30


def test_pytorch_comes_when_it_is_asked_for():
    """The package itself never loads it; ``tests/test_layers.py`` looks at that in a process of its own."""
    assert "torch" not in fsh.__all__
    assert sys.modules["fsh3d_o3d.torch"] is ft
    assert np.array_equal(ft.SphericalHarmonicTransform(2).grid.directions, fsh.fibonacci_grid(24).directions)
