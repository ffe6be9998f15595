"""Coefficients → samples → coefficients: what comes back, by us and by the peers at like numbers of samples.

Peers: ducc0 called directly with our weights; pyshtools' Driscoll–Healy transform (2b × 2b samples); healpy on the
HEALPix grid of the most similar size, without and with three Jacobi iterations; our grid with equal and with Voronoi
weights.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fsh3d_o3d as fsh
from benchmarks._cases import (
    FibonacciCase,
    ducc0_adjoint,
    ducc0_synthesis,
    fibonacci_case,
    random_coefficients,
    relative_error,
)
from benchmarks._measure import interleave, limited
from benchmarks._table import Cell, Check, Column, Curve, Plot, Row, Table

DENSE_TOLERANCE = 5e-15
NUFFT_TOLERANCE = 3e-13
_VORONOI_BANDWIDTH = 64  # beyond, the diagram takes longer than all else here


@dataclass(frozen=True)
class _Method:
    """One way to go and come back."""

    name: str
    """For people."""
    points: int
    """Number of samples."""
    call: Callable[[], NDArray[np.float32] | NDArray[np.float64]]
    """Returns the (b²,) coefficients that came back."""
    limit: float | None = None
    """Target of the relative error."""


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of round trips."""
    dense = (8,) if quick else (16, 32, 48, 64)
    fast = (8, 16) if quick else (64, 128, 256, 512)
    rows: list[Row] = []
    for b in sorted({*dense, *fast}):
        coefficients = random_coefficients(b)[0]
        methods = _methods(fibonacci_case(b), coefficients, b in dense, b in fast)
        with limited(1):
            times = interleave({method.name: method.call for method in methods}, rounds=5, budget=1.0)
        for method in methods:
            error = relative_error(method.call(), coefficients)
            checks = () if method.limit is None else (Check("error", error, "<=", method.limit),)
            cells: dict[str, Cell] = {
                "b": b,
                "method": method.name,
                "n": method.points,
                "error": error,
                "time": times[method.name],
                "ratio": times[method.name].over(times[methods[0].name]),
            }
            rows.append(Row(cells, checks))
    names = dict.fromkeys(sorted((str(row.cells["method"]) for row in rows), key=_is_peer))
    curves = []
    for name in names:
        own = [row.cells for row in rows if row.cells["method"] == name]
        x, y = ([float(cells[key]) for cells in own] for key in ("b", "error"))  # type: ignore[arg-type]
        curves.append(Curve(name, x, y))
    missing = [name for name in ("pyshtools", "healpy") if importlib.util.find_spec(name) is None]
    yield Table(
        "roundtrip",
        "Round trip of random coefficients of degree < b, one thread",
        (
            Column("b", "b"),
            Column("method", "method"),
            Column("n", "samples"),
            Column("error", "relative L2 error", ".1e"),
            Column("time", "round trip ms", ".3g", 1e3),
            Column("ratio", "× first of its b", ".2f"),
        ),
        tuple(rows),
        Plot("bandwidth b", "relative L2 error", tuple(curves)),
        tuple(f"{name} is not installed and left out (extra `bench`)." for name in missing),
    )


def _is_peer(name: str) -> bool:
    return not name.startswith("ours")


def _methods(case: FibonacciCase, coefficients: NDArray[np.float64], dense: bool, fast: bool) -> list[_Method]:
    b, n = case.bandwidth, len(case.grid)
    methods = []
    if dense:
        methods.append(_Method("ours, dense", n, _ours(case, case.weights, "dense", coefficients), DENSE_TOLERANCE))
    if fast:
        methods.append(_Method("ours, nufft", n, _ours(case, case.weights, "nufft", coefficients), NUFFT_TOLERANCE))
    packed = fsh.to_packed(coefficients)

    def ducc0_call() -> NDArray[np.float32] | NDArray[np.float64]:
        values = ducc0_synthesis(packed, case.locations, b - 1, 1)
        return fsh.from_packed(ducc0_adjoint(values * case.weights, case.locations, b - 1, 1))

    methods.append(_Method("ducc0, our weights", n, ducc0_call))
    if importlib.util.find_spec("pyshtools"):
        methods.append(_Method("pyshtools DH", 4 * b * b, _pyshtools(b, coefficients)))
    if importlib.util.find_spec("healpy"):
        side = round(np.sqrt(n / 12))
        for iterations in (0, 3):
            name = "healpy" if iterations == 0 else f"healpy, {iterations} iterations"
            methods.append(_Method(name, 12 * side * side, _healpy(side, b, packed, iterations)))
    engine: Any = "dense" if dense else "nufft"
    methods.append(_Method("equal weights", n, _ours(case, fsh.equal_weights(case.grid), engine, coefficients)))
    if b <= _VORONOI_BANDWIDTH:
        methods.append(_Method("Voronoi weights", n, _ours(case, fsh.area_weights(case.grid), engine, coefficients)))
    return methods


def _ours(
    case: FibonacciCase, weights: NDArray[np.float64], engine: Any, coefficients: NDArray[np.float64]
) -> Callable[[], Any]:
    transform = fsh.SphericalHarmonicTransform(case.bandwidth, case.grid, weights, engine, threads=1)
    return lambda: transform.forward(transform.inverse(coefficients))


def _pyshtools(b: int, coefficients: NDArray[np.float64]) -> Callable[[], NDArray[np.float32] | NDArray[np.float64]]:
    from pyshtools.expand import MakeGridDH, SHExpandDH  # type: ignore[import-untyped]

    degree, order = fsh.degrees_and_orders(b)
    place = ((order < 0).astype(int), degree, np.abs(order))
    cilm = np.zeros((2, b, b))
    cilm[place] = coefficients
    # norm 4 is orthonormal, csphase 1 leaves out the Condon–Shortley phase: its layout holds our very numbers.
    return lambda: SHExpandDH(MakeGridDH(cilm, norm=4, csphase=1), norm=4, csphase=1)[place]


def _healpy(side: int, b: int, packed: Any, iterations: int) -> Callable[[], NDArray[np.float32] | NDArray[np.float64]]:
    import healpy  # type: ignore[import-untyped]

    def call() -> NDArray[np.float32] | NDArray[np.float64]:
        values = healpy.alm2map(packed, side, lmax=b - 1, pol=False)
        return fsh.from_packed(healpy.map2alm(values, lmax=b - 1, iter=iterations, pol=False))

    return call
