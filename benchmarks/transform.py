"""Speed of the transforms: against the machine's matrix products, against ducc0, and dense against NUFFT.

ducc0 is called as a stranger would call it who has the weights: once per function, on the product of samples and
weights, with all it needs made beforehand. Ours is ``forward`` and ``inverse`` with all they do, checks included.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Literal

import numpy as np

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
from fsh3d_o3d.sphere import EnginePair

Direction = Literal["forward", "inverse"]

_TIMES_FASTER = {(16, 64): 10.0, (32, 64): 3.0}
_NEVER_SLOWER = 1 / 1.1
_BATCHES = {8: 4, 16: 64, 32: 64, 64: 64, 128: 8, 256: 4, 512: 2}
_CROSSOVER_BATCHES = (1, 2, 4, 8, 16, 64)


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the tables against matrix products, against ducc0, and of the engines' crossovers."""
    yield _products((8,) if quick else (16, 32, 64), 256 if quick else 2048)
    yield _against_ducc0((8, 16) if quick else (16, 32, 64, 128, 256, 512))
    yield _crossovers((8,) if quick else (16, 24, 32, 40, 48, 64), (1, 4) if quick else _CROSSOVER_BATCHES)


def _products(bandwidths: tuple[int, ...], size: int) -> Table:
    """Dense analysis of 64 functions as a share of what BLAS can do."""
    rng = np.random.default_rng(0)
    left, right, product = rng.standard_normal((size, size)), rng.standard_normal((size, size)), np.empty((size, size))
    rows = []
    for b in bandwidths:
        case = fibonacci_case(b)
        n, batch = len(case.grid), 64
        transform = fsh.SphericalHarmonicTransform(b, case.grid, case.weights, "dense", threads=1)
        coefficients = random_coefficients(b, batch)
        values = transform.inverse(coefficients)
        # The two halves of the folded transform: (64, n/2) times (n/2, b²/2), twice.
        halves = rng.standard_normal((2, batch, n // 2)), rng.standard_normal((2, b * b // 2, n // 2))
        results = np.empty((2, batch, b * b // 2))
        with limited(1):
            times = interleave(
                {
                    "ours": partial(transform.forward, values),
                    "same": partial(_products_of, halves, results),
                    "square": partial(np.matmul, left, right, out=product),
                },
                budget=4.0,
            )
        flops = 2 * batch * (b * b / 2) * n
        scale = flops / (2 * size**3)
        share = times["square"].scaled(scale).over(times["ours"])
        cells: dict[str, Cell] = {
            "b": b,
            "n": n,
            "error": relative_error(transform.forward(values), coefficients),
            "ours": times["ours"],
            "rate": flops / times["ours"].median / 1e9,
            "same": flops / times["same"].median / 1e9,
            "square": 2 * size**3 / times["square"].median / 1e9,
            "of_same": times["same"].over(times["ours"]),
            "of_square": share,
        }
        rows.append(Row(cells, (Check("of square dgemm", share, ">=", 0.7),)))
    return Table(
        "transform_dgemm",
        "Dense forward transform of 64 functions, float64, one thread, beside dgemm",
        (
            Column("b", "b"),
            Column("n", "n"),
            Column("error", "error", ".1e"),
            Column("ours", "forward ms", ".3g", 1e3),
            Column("rate", "GFLOP/s", ".1f"),
            Column("same", "dgemm same shape", ".1f"),
            Column("square", f"dgemm {size}²", ".1f"),
            Column("of_same", "of same shape", ".0%"),
            Column("of_square", "of square", ".0%"),
        ),
        tuple(rows),
        notes=("Operations counted for the halved matrices, 64 b² n; the folding itself is not counted.",),
    )


def _products_of(halves: tuple[Any, Any], results: Any) -> None:
    for values, matrix, out in zip(*halves, results, strict=True):
        np.matmul(values, matrix.T, out=out)


def _against_ducc0(bandwidths: tuple[int, ...]) -> Table:
    rows = []
    for b in bandwidths:
        case = fibonacci_case(b)
        directions: tuple[Direction, ...] = ("forward", "inverse")
        for direction in directions:
            rows.append(_faced(case, direction, _BATCHES[b], 1, "float64"))
            rows += [
                _faced(case, direction, 1, threads, dtype) for threads in (1, 2) for dtype in ("float64", "float32")
            ]
    curves = []
    for direction in ("forward", "inverse"):
        for threads in (1, 2):
            own = [
                row.cells
                for row in rows
                if (row.cells["direction"], row.cells["threads"], row.cells["dtype"]) == (direction, threads, "float64")
                and row.cells["batch"] == 1
            ]
            x, y = ([float(cells[key]) for cells in own] for key in ("b", "ratio"))  # type: ignore[arg-type]
            curves.append(Curve(f"{direction}, {threads} thread{'s' * (threads > 1)}", x, y, dashed=threads > 1))
    return Table(
        "transform_ducc0",
        "SphericalHarmonicTransform (engine auto) against ducc0 called per function",
        (
            Column("b", "b"),
            Column("direction", "direction"),
            Column("batch", "batch"),
            Column("threads", "threads"),
            Column("dtype", "dtype"),
            Column("engine", "engine"),
            Column("error", "error", ".1e"),
            Column("peer_error", "ducc0 error", ".1e"),
            Column("ours", "ours ms/function", ".3g", 1e3),
            Column("peer", "ducc0 ms/function", ".3g", 1e3),
            Column("ratio", "ducc0 / ours", ".2f"),
        ),
        tuple(rows),
        Plot("bandwidth b", "ducc0 time / our time, single functions", tuple(curves), _NEVER_SLOWER),
        (
            "error: relative L2, of forward against the known coefficients, of inverse against direct sums at 64 "
            "points. Samples for forward are exact up to b = 64, beyond they are ducc0's to 3e-13.",
        ),
    )


def _faced(case: FibonacciCase, direction: Direction, batch: int, threads: int, dtype: str) -> Row:
    """One case of ours against ducc0."""
    b, locations = case.bandwidth, case.locations
    transform = fsh.SphericalHarmonicTransform(b, case.grid, case.weights, threads=threads)
    coefficients = random_coefficients(b, batch)
    exact: Any = _synthesised(case, coefficients)
    some = np.linspace(0, len(case.grid) - 1, 64).astype(int)
    expected = coefficients @ fsh.spherical_harmonics(case.grid.directions[some], b).T
    given, values, weights = coefficients.astype(dtype), exact.astype(dtype), case.weights.astype(dtype)
    packed = fsh.to_packed(given)

    def ours() -> Any:
        return transform.forward(values) if direction == "forward" else transform.inverse(given)

    def peer() -> Any:
        if direction == "forward":
            return [ducc0_adjoint(row * weights, locations, b - 1, threads) for row in values]
        return [ducc0_synthesis(row, locations, b - 1, threads) for row in packed]

    with limited(threads):
        times = interleave({"ours": ours, "peer": peer}, rounds=9, budget=0.8)
    own, other = ours(), np.stack(peer())
    if direction == "forward":
        errors = relative_error(own, coefficients), relative_error(fsh.from_packed(other), coefficients)
    else:
        errors = relative_error(own[:, some], expected), relative_error(other[:, some], expected)
    ratio = times["peer"].over(times["ours"])
    cells: dict[str, Cell] = {
        "b": b,
        "direction": direction,
        "batch": batch,
        "threads": threads,
        "dtype": dtype,
        "engine": _engine_name(EnginePair(case.grid, b, case.weights), batch),
        "error": errors[0],
        "peer_error": errors[1],
        "ours": times["ours"].scaled(1 / batch),
        "peer": times["peer"].scaled(1 / batch),
        "ratio": ratio,
    }
    limit = _TIMES_FASTER.get((b, batch), _NEVER_SLOWER) if direction == "forward" else _NEVER_SLOWER
    return Row(cells, (Check("ducc0 / ours", ratio, ">=", limit),))


def _synthesised(case: FibonacciCase, coefficients: Any) -> Any:
    """Values in float64, by matrices in slices of points where that is feasible."""
    b = case.bandwidth
    if b > 64:
        packed = fsh.to_packed(coefficients)
        return np.stack([ducc0_synthesis(row, case.locations, b - 1, 1) for row in packed])
    pieces = np.array_split(case.grid.directions, 1 + b // 16)
    return np.concatenate([coefficients @ fsh.spherical_harmonics(piece, b).T for piece in pieces], axis=1)


def _engine_name(pair: EnginePair, batch: int) -> str:
    return type(pair.pick(batch)).__name__.removesuffix("Engine").lower()


def _crossovers(bandwidths: tuple[int, ...], batches: tuple[int, ...]) -> Table:
    rows = []
    for b in bandwidths:
        case = fibonacci_case(b)
        pairs: dict[str, EnginePair] = {
            name: EnginePair(case.grid, b, case.weights, name) for name in ("dense", "nufft", "auto")
        }
        for threads in (1, 2):
            cells: dict[str, Cell] = {"b": b, "threads": threads}
            loss, first = 1.0, None
            for batch in batches:
                values = np.random.default_rng(b).standard_normal((batch, len(case.grid)))
                sides = {name: pairs[name].pick(batch) for name in ("dense", "nufft")}
                with limited(threads):
                    times = interleave(
                        {name: partial(engine.analyse, values, threads) for name, engine in sides.items()},
                        rounds=5,
                        budget=0.3,
                    )
                gain = times["nufft"].over(times["dense"])
                cells[str(batch)] = gain
                first = batch if first is None and gain >= 1 else first if gain >= 1 else None
                chosen = gain if _engine_name(pairs["auto"], batch) == "dense" else 1 / gain
                loss = max(loss, 1 / chosen)
            picked = [batch for batch in batches if _engine_name(pairs["auto"], batch) == "dense"]
            cells |= {"first": first, "auto": picked[0] if picked else None, "loss": loss}
            rows.append(Row(cells))
    curves = tuple(
        Curve(
            f"batch {batch}",
            list(bandwidths),
            [float(row.cells[str(batch)]) for row in rows if row.cells["threads"] == 1],  # type: ignore[arg-type]
        )
        for batch in batches
    )
    return Table(
        "transform_crossover",
        "Analysis by NUFFT over analysis by matrices (made before), time per batch: above 1 matrices win",
        (
            Column("b", "b"),
            Column("threads", "threads"),
            *(Column(str(batch), f"batch {batch}", ".2f") for batch in batches),
            Column("first", "dense wins from", "d"),
            Column("auto", "auto takes dense from", "d"),
            Column("loss", "auto loses at most ×", ".2f"),
        ),
        tuple(rows),
        Plot("bandwidth b", "NUFFT time / dense time, one thread", curves, 1.0, "equal"),
    )
