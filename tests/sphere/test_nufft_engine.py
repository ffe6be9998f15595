"""Fast transforms against sums with scipy's harmonics, in one piece and in blocks of points."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import _validation
from fsh3d_o3d.errors import MemoryEstimateError
from fsh3d_o3d.sphere import nufft_engine
from fsh3d_o3d.sphere.nufft_engine import NufftEngine, synthesise_gradient
from tests.sphere.oracles import real_harmonics, relative_l2, scattered


@pytest.mark.parametrize("b", [1, 2, 5, 30])
@pytest.mark.parametrize("n", [1, 2, 301])
@pytest.mark.parametrize("batch", [0, 1, 3])
def test_sums(b: int, n: int, batch: int, rng: np.random.Generator) -> None:
    grid, weights = fsh.grid_from_directions(scattered(rng, n)), rng.uniform(0.5, 1.5, n)
    basis = real_harmonics(grid.directions, b)
    values, coefficients = rng.standard_normal((batch, n)), rng.standard_normal((batch, b * b))
    # 3e-13 is what the fast transform is asked for, relative to the norm of what it sums.
    found = NufftEngine(grid, b, weights).analyse(values, 1)
    assert np.allclose(found, (values * weights) @ basis, rtol=0, atol=1e-12 * np.sqrt(n) * b)
    assert np.allclose(NufftEngine(grid, b).synthesise(coefficients, 1), coefficients @ basis.T, rtol=0, atol=1e-12 * b)
    assert found.shape == (batch, b * b)


def test_single_precision(rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(2400)
    basis = real_harmonics(grid.directions, 20)
    coefficients = rng.standard_normal((2, 400)).astype(np.float32)
    engine = NufftEngine(grid, 20, fsh.equal_weights(grid))
    values = engine.synthesise(coefficients)
    assert values.dtype == engine.analyse(values).dtype == np.float32
    assert relative_l2(values, coefficients @ basis.T) < 1e-5  # asked for 2e-6


def test_adjoint(rng: np.random.Generator) -> None:
    """⟨Y c, v⟩ = ⟨c, Yᵀ v⟩."""
    engine = NufftEngine(fsh.fibonacci_grid(500), 12)
    coefficients, values = rng.standard_normal((1, 144)), rng.standard_normal((1, 500))
    left = np.vdot(engine.synthesise(coefficients), values)
    assert left == pytest.approx(np.vdot(coefficients, engine.analyse(values)), abs=1e-10)


@pytest.mark.parametrize("count", [1, 4])
def test_large_functions_are_split_alike_for_any_number_of_threads(count: int, rng: np.random.Generator) -> None:
    b = 160  # 6b² = 153,600 points, above the size from which one function is split
    grid = fsh.fibonacci_grid(6 * b * b)
    engine = NufftEngine(grid, b, fsh.equal_weights(grid))
    assert (len(engine._blocks(1)) > 1) and len(engine._blocks(2)) == 1
    coefficients = rng.standard_normal((count, b * b))
    values, again = (engine.synthesise(coefficients, threads) for threads in (1, 2))
    # To a few roundings and not to the byte: see "Determinism" in docs/conventions.md.
    assert np.abs(values - again).max() < 1e-14 * b * np.abs(coefficients).max()
    sums, others = engine.analyse(values, 1), engine.analyse(values, 2)
    assert np.abs(sums - others).max() < 1e-14 * b * np.abs(sums).max()


def test_blocks_give_the_sum_of_all_points(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    grid, values = fsh.fibonacci_grid(3001), rng.standard_normal((1, 3001))
    coefficients = rng.standard_normal((1, 16))
    engine = NufftEngine(grid, 4, rng.uniform(0.5, 1.5, 3001))
    whole = engine.analyse(values), engine.synthesise(coefficients)
    monkeypatch.setattr(nufft_engine, "_SPLIT_POINTS", 1000)
    blocks = engine._blocks(1)
    assert len(blocks) > 1
    assert [block.start for block in blocks] == [0, *(block.stop for block in blocks[:-1])]
    assert blocks[-1].stop == 3001
    assert relative_l2(engine.analyse(values), whole[0]) < 1e-12
    assert relative_l2(engine.synthesise(coefficients), whole[1]) < 1e-12


def test_gradient_of_low_harmonics(rng: np.random.Generator) -> None:
    """f = z: ∂θ f = −sin θ, ∂φ f = 0; f = x: cos θ cos φ and −sin φ."""
    grid = fsh.grid_from_directions(scattered(rng, 40))
    theta, phi = grid.colatitude, grid.longitude
    norm = np.sqrt(4 * np.pi / 3)
    south, east = synthesise_gradient(np.array([0, 0, norm, 0]), 2, grid)
    assert np.abs(south + np.sin(theta)).max() < 1e-12 and np.abs(east).max() < 1e-12
    south, east = synthesise_gradient(np.array([0, 0, 0, norm]), 2, grid)
    assert np.abs(south - np.cos(theta) * np.cos(phi)).max() < 1e-12
    assert np.abs(east + np.sin(phi)).max() < 1e-12
    assert not synthesise_gradient(np.array([2.0]), 1, grid).any()


def test_transforms_that_do_not_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_validation, "_available_memory", lambda: 1e6)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    engine = NufftEngine(fsh.fibonacci_grid(100), 300)
    for call, size in ((engine.analyse, 100), (engine.synthesise, 90_000)):
        with pytest.raises(MemoryEstimateError, match=r"fast transform of bandwidth 300 on 100 points needs about"):
            call(np.zeros((1, size)))
