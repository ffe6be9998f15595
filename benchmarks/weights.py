"""Analytic weights: how exact, how even, how many steps, how long beside the fast transforms they are made of.

The peer is ducc0 doing as many synthesis and adjoint pairs of degree 2b − 1 on the same nodes as we take steps: the
least that conjugate gradients on all points could cost. No library is known that solves for such weights itself.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

import fsh3d_o3d as fsh
from benchmarks._cases import ducc0_adjoint, ducc0_synthesis
from benchmarks._measure import Timing, interleave, limited, peak_memory
from benchmarks._table import Cell, Check, Column, Curve, Plot, Row, Table

_GIB = 2**30
_TIMED = (32, 128, 256, 1024)  # bandwidths whose time has a target
_LARGE = 512  # from here on one round, unwarmed, and three pairs stand for all
_MEMORY = """
import sys
import fsh3d_o3d as fsh
b = int(sys.argv[1])
fsh.analytic_weights(fsh.fibonacci_grid(6 * b * b), b, cache=False)
"""


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the tables for n = 6b² and for the grids below it."""
    yield _default_grids((8, 16) if quick else (16, 32, 64, 128, 256, 512, 1024), quick)
    yield _small_grids((8, 12) if quick else (16, 24, 32))


def _default_grids(bandwidths: tuple[int, ...], quick: bool) -> Table:
    rows = []
    for b in bandwidths:
        grid = fsh.fibonacci_grid(6 * b * b)
        locations = np.stack([grid.colatitude, grid.longitude], axis=1)
        for threads in (1, 2):
            solution, ours, pairs = _against_pairs(grid, locations, b, threads, quick)
            # The largest case alone, in a process of its own: what a user's machine must have.
            memory = peak_memory(_MEMORY, b) if b == bandwidths[-1] and threads == 1 else None
            rows.append(_row(b, threads, solution, ours, pairs, memory))
    single = [row.cells for row in rows if row.cells["threads"] == 1]
    curves = tuple(
        Curve(label, list(bandwidths), [getattr(cells[key], "median", np.nan) for cells in single])
        for label, key in (("analytic_weights", "ours"), ("as many ducc0 pairs", "pairs"))
    )
    return Table(
        "weights",
        "Analytic weights on 6b² Fibonacci points",
        (
            Column("b", "b"),
            Column("n", "n"),
            Column("threads", "threads"),
            Column("iterations", "steps", "d"),
            Column("residual", "residual", ".1e"),
            Column("smallest", "min·n/4π", ".3f"),
            Column("largest", "max·n/4π", ".3f"),
            Column("negative", "negative", "d"),
            Column("ours", "ours s", ".3g"),
            Column("pairs", "ducc0 pairs s", ".3g"),
            Column("ratio", "ours / pairs", ".2f"),
            Column("memory", "peak GiB", ".2f", 1 / _GIB),
        ),
        tuple(rows),
        Plot("bandwidth b", "seconds, one thread", curves),
        ("residual: largest violation of Eq. (8); pairs: as many as steps, same nodes, degree 2b − 1, same threads.",),
    )


def _against_pairs(
    grid: fsh.SphericalGrid, locations: Any, b: int, threads: int, quick: bool
) -> tuple[fsh.WeightSolution, Timing, Timing]:
    """The solution, our time, and the time of as many pairs as it took steps."""
    lmax, large = 2 * b - 1, b >= _LARGE
    values = np.random.default_rng(b).standard_normal(len(grid))
    found: list[fsh.WeightSolution] = []

    def solve() -> None:
        found[:] = [fsh.analytic_weights(grid, b, threads=threads, cache=False)]

    if not large:
        solve()
    repeats = 3 if large else max(1, found[0].iterations)

    def pairs() -> None:
        for _ in range(repeats):
            packed = ducc0_adjoint(values, locations, lmax, threads)
            ducc0_synthesis(packed, locations, lmax, threads)

    with limited(threads):
        times = interleave(
            {"ours": solve, "pairs": pairs},
            rounds=1 if large else 3 if quick or b >= 256 else 7,
            budget=3.0,
            warm=not large,
        )
    steps = max(1, found[0].iterations)
    return found[0], times["ours"], times["pairs"].scaled(steps / repeats)


def _row(b: int, threads: int, solution: fsh.WeightSolution, ours: Timing, pairs: Timing, memory: int | None) -> Row:
    n = len(solution.weights)
    smallest, largest = (n / (4 * np.pi) * value for value in (solution.minimum, solution.maximum))
    ratio = ours.over(pairs)
    checks = []
    if threads == 1:  # the solution does not depend on threads
        checks += [
            Check("residual", solution.residual, "<=", 1e-12),
            Check("min·n/4π", smallest, ">=", 0.9),
            Check("max·n/4π", largest, "<=", 1.12),
            Check("negative", solution.negative, "<=", 0),
            Check("steps", solution.iterations, "<=", 15),
        ]
    if b in _TIMED:
        checks.append(Check("ratio", ratio, "<=", 1.3))
    if memory is not None:
        checks.append(Check("peak GiB", memory / _GIB, "<=", 6.0))
    cells: dict[str, Cell] = {
        "b": b,
        "n": n,
        "threads": threads,
        "iterations": solution.iterations,
        "residual": solution.residual,
        "smallest": smallest,
        "largest": largest,
        "negative": solution.negative,
        "ours": ours,
        "pairs": pairs,
        "ratio": ratio,
        "memory": memory,
    }
    return Row(cells, tuple(checks))


def _small_grids(bandwidths: tuple[int, ...]) -> Table:
    rows = []
    for b in bandwidths:
        for rule, n in (("4b²", 4 * b * b), ("4(b+2)²", 4 * (b + 2) ** 2)):
            grid = fsh.fibonacci_grid(n)
            found: list[fsh.WeightSolution] = []

            def solve(grid: fsh.SphericalGrid = grid, b: int = b, found: list[fsh.WeightSolution] = found) -> None:
                found[:] = [fsh.analytic_weights(grid, b, threads=1, cache=False)]

            with limited(1), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", fsh.QuadratureWarning)
                times = interleave({"ours": solve}, rounds=1, warm=False)
            solution = found[0]
            warned = any(issubclass(warning.category, fsh.QuadratureWarning) for warning in caught)
            amplification = float(np.sqrt(n * np.square(solution.weights).sum()) / (4 * np.pi))
            cells: dict[str, Cell] = {
                "b": b,
                "rule": rule,
                "n": n,
                "iterations": solution.iterations,
                "residual": solution.residual,
                "smallest": solution.minimum * n / (4 * np.pi),
                "largest": solution.maximum * n / (4 * np.pi),
                "negative": solution.negative,
                "amplification": amplification,
                "converged": solution.converged,
                "warned": warned,
                "ours": times["ours"].median,
            }
            checks = (
                Check("warned where not exact", float(warned != solution.converged), ">=", 1.0),
                Check("noise ×", amplification, "<=", 2.0),
            )
            rows.append(Row(cells, checks))
    return Table(
        "weights_small_grids",
        "Analytic weights below 6b² points: exact where bounded, else bounded with a warning",
        (
            Column("b", "b"),
            Column("rule", "rule"),
            Column("n", "n"),
            Column("iterations", "steps", "d"),
            Column("residual", "residual", ".1e"),
            Column("smallest", "min·n/4π", ".2f"),
            Column("largest", "max·n/4π", ".2f"),
            Column("negative", "negative", "d"),
            Column("amplification", "noise ×", ".2f"),
            Column("converged", "exact"),
            Column("warned", "warned"),
            Column("ours", "s", ".2g"),
        ),
        tuple(rows),
        notes=("noise ×: root mean square of the weights over the equal weight; steps 0: by factorisation.",),
    )
