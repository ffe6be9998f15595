"""Inputs that several benchmarks share, and ducc0 as a stranger would call it."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import ducc0
import numpy as np
from numpy.typing import NDArray

import fsh3d_o3d as fsh

TOLERANCE = {"float64": 3e-13, "float32": 2e-6}
"""epsilon asked of ducc0, ours and the peer's alike."""


@dataclass(frozen=True, eq=False)
class FibonacciCase:
    """The default grid of a bandwidth with its weights, prepared for both sides."""

    bandwidth: int
    """b."""
    grid: fsh.SphericalGrid
    """6b² points."""
    weights: NDArray[np.float64]
    """(n,) analytic."""
    locations: NDArray[np.float64]
    """(n, 2) colatitude and longitude, as ducc0 takes them."""


@functools.lru_cache(maxsize=12)
def fibonacci_case(bandwidth: int) -> FibonacciCase:
    """Return the case of a bandwidth; weights are solved, not read from the user's cache."""
    grid = fsh.fibonacci_grid(6 * bandwidth**2)
    weights = fsh.analytic_weights(grid, bandwidth, cache=False).weights
    return FibonacciCase(bandwidth, grid, weights, np.stack([grid.colatitude, grid.longitude], axis=1))


def random_coefficients(bandwidth: int, batch: int = 1, seed: int = 1) -> NDArray[np.float64]:
    """Return (batch, b²) independent standard normal coefficients."""
    return np.random.default_rng([seed, bandwidth]).standard_normal((batch, bandwidth**2))


def relative_error(found: Any, expected: Any) -> float:
    """Return ‖found − expected‖ / ‖expected‖ in L2, computed in float64."""
    difference = np.asarray(found, dtype=np.float64) - np.asarray(expected, dtype=np.float64)
    return float(np.linalg.norm(difference) / np.linalg.norm(expected))


def ducc0_adjoint(values: Any, locations: NDArray[np.float64], lmax: int, threads: int) -> Any:
    """Return Σ_j v_j conj Y(ω_j) of one function, packed."""
    return ducc0.sht.adjoint_synthesis_general(
        map=values[None], spin=0, lmax=lmax, loc=locations, epsilon=TOLERANCE[values.dtype.name], nthreads=threads
    )[0]


def ducc0_synthesis(packed: Any, locations: NDArray[np.float64], lmax: int, threads: int) -> Any:
    """Return the values of one function from its packed coefficients."""
    name = "float32" if packed.dtype == np.complex64 else "float64"
    return ducc0.sht.synthesis_general(
        alm=packed[None], spin=0, lmax=lmax, loc=locations, epsilon=TOLERANCE[name], nthreads=threads
    )[0]
