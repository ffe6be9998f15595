"""Which engine carries out what."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere.dense_engine import DenseEngine
from fsh3d_o3d.sphere.engines import EnginePair
from fsh3d_o3d.sphere.nufft_engine import NufftEngine


def picked(b: int, n: int, batch: int, engine: str = "auto") -> type:
    return type(EnginePair(fsh.fibonacci_grid(n), b, engine=engine).pick(batch))  # type: ignore[arg-type]


def test_auto_goes_by_bandwidth_batch_and_memory() -> None:
    assert picked(16, 1536, 1) is DenseEngine
    assert picked(32, 6144, 1) is NufftEngine
    assert picked(32, 6144, 64) is DenseEngine
    assert picked(200, 1000, 64) is NufftEngine
    assert picked(16, 300_000, 64) is NufftEngine  # 614 MB of matrix


@pytest.mark.parametrize("batch", [1, 100])
def test_a_named_engine_is_used_always(batch: int) -> None:
    assert picked(100, 1000, batch, "dense") is DenseEngine
    assert picked(2, 24, batch, "nufft") is NufftEngine


def test_engines_agree(rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(600)
    values, coefficients = rng.standard_normal((2, 600)), rng.standard_normal((2, 100))
    dense, fast = (EnginePair(grid, 10, fsh.equal_weights(grid), name).pick(2) for name in ("dense", "nufft"))
    assert np.abs(dense.analyse(values) - fast.analyse(values)).max() < 1e-12
    assert np.abs(dense.synthesise(coefficients) - fast.synthesise(coefficients)).max() < 1e-11


def test_unknown_engine() -> None:
    with pytest.raises(ValueError, match=r"engine must be one of 'auto', 'dense', 'nufft', got 'gpu'"):
        EnginePair(fsh.fibonacci_grid(24), 2, engine="gpu")  # type: ignore[arg-type]
