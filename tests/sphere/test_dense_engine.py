"""Matrix products against sums with scipy's harmonics, on symmetric grids and others."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import _validation
from fsh3d_o3d.errors import MemoryEstimateError
from fsh3d_o3d.sphere.dense_engine import DenseEngine, half_turn_parity
from tests.sphere.oracles import real_harmonics, scattered

GRIDS = {
    "even": fsh.fibonacci_grid(150),
    "odd": fsh.fibonacci_grid(151),
    "one": fsh.fibonacci_grid(1),
    "two": fsh.fibonacci_grid(2),
    "three": fsh.fibonacci_grid(3),
    "equiangular": fsh.equiangular_grid(6),
    "scattered": fsh.grid_from_directions(scattered(np.random.default_rng(5), 77)),
}


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("weighting", ["none", "symmetric", "not symmetric"])
@pytest.mark.parametrize("batch", [0, 1, 3, 130])
def test_sums(name: str, weighting: str, batch: int, rng: np.random.Generator) -> None:
    grid, b = GRIDS[name], 6
    weights = None if weighting == "none" else rng.uniform(0.5, 1.5, len(grid))
    if weighting == "symmetric":
        weights = weights + weights[::-1]
    engine = DenseEngine(grid, b, weights)
    basis = real_harmonics(grid.directions, b)
    values, coefficients = rng.standard_normal((batch, len(grid))), rng.standard_normal((batch, b * b))
    weighted = values if weights is None else values * weights
    # Sums of up to 151 terms of size 1.
    assert np.allclose(engine.analyse(values), weighted @ basis, rtol=0, atol=1e-12)
    assert np.allclose(engine.synthesise(coefficients), coefficients @ basis.T, rtol=0, atol=1e-12)


def test_parity_is_that_of_the_harmonics(rng: np.random.Generator) -> None:
    directions = scattered(rng, 9)
    turned = directions * [1, -1, -1]
    sign = 1 - 2.0 * half_turn_parity(7)
    assert np.abs(real_harmonics(turned, 7) - sign * real_harmonics(directions, 7)).max() < 1e-13


def test_symmetry_halves_the_matrices() -> None:
    engine = DenseEngine(fsh.fibonacci_grid(600), 10)
    blocks = engine._matrices(np.dtype(np.float64), weighted=False)
    assert sum(block.matrix.size for block in blocks) == 600 * 100 // 2


def test_inputs_are_not_written_to_and_results_are_not_reused(rng: np.random.Generator) -> None:
    engine = DenseEngine(GRIDS["even"], 6)
    values = rng.standard_normal((3, 150))
    values.setflags(write=False)
    first = engine.analyse(values)
    kept = first.copy()
    engine.analyse(rng.standard_normal((3, 150)))
    engine.synthesise(rng.standard_normal((3, 36)))
    assert np.array_equal(first, kept)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", [1536, 1537])
@pytest.mark.parametrize("weighting", ["symmetric", "not symmetric"])
def test_threads_do_not_change_a_byte(dtype: type, n: int, weighting: str, rng: np.random.Generator) -> None:
    weights = None if weighting == "symmetric" else rng.uniform(0.5, 1.5, n)
    for b in (8, 16, 32):
        engine = DenseEngine(fsh.fibonacci_grid(n), b, weights)
        for batch in (1, 2, 3, 8, 64, 70):
            values = rng.standard_normal((batch, n)).astype(dtype)
            coefficients = rng.standard_normal((batch, b * b)).astype(dtype)
            assert engine.analyse(values, 1).tobytes() == engine.analyse(values, 2).tobytes(), (b, batch)
            assert engine.synthesise(coefficients, 1).tobytes() == engine.synthesise(coefficients, 2).tobytes(), (
                b,
                batch,
            )


def test_one_engine_in_many_threads(rng: np.random.Generator) -> None:
    engine = DenseEngine(fsh.fibonacci_grid(600), 10)
    values = rng.standard_normal((8, 5, 600))
    expected = [engine.analyse(own, 1) for own in values]
    found: list[list[np.ndarray]] = [[] for _ in values]

    def work(i: int) -> None:
        found[i] = [engine.analyse(values[i], 1) for _ in range(20)]

    workers = [threading.Thread(target=work, args=(i,)) for i in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for own, truth in zip(found, expected, strict=True):
        assert len(own) == 20 and all(np.array_equal(one, truth) for one in own)


def test_matrices_that_do_not_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = DenseEngine(fsh.fibonacci_grid(6144), 32)
    monkeypatch.setattr(_validation, "_available_memory", lambda: 1e6)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    with pytest.raises(MemoryEstimateError, match=r"dense transform of bandwidth 32 on 6144 points needs about"):
        engine.analyse(np.zeros((1, 6144)))
