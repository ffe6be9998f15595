"""Rotation: error beside time of exact rotation, of one estimate, and of the ranking of many candidates.

ducc0 is called as a stranger would call it: Euler angles, packed coefficients, one function after another. Where healpy
is installed it is timed too. The peer of the estimates is the plain way: the correlation at 2,400 rotations spread
evenly over all (Alexa 2022, super-Fibonacci spirals) as one matrix product with rotated copies of the target, made
beforehand; the best is taken.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import ducc0
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from benchmarks._cases import random_coefficients, relative_error
from benchmarks._measure import interleave, limited
from benchmarks._table import Cell, Check, Column, Row, Table

_BRUTE = 2400
_TURN = Rotation.from_euler("ZYZ", [0.7, 1.1, -2.3])
_BATCHES = {16: 32, 32: 32, 64: 32, 128: 8, 256: 2}


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the tables of exact rotation, of single estimates and of batches."""
    yield _rotation((16, 32) if quick else tuple(_BATCHES))
    yield _pairs(2 if quick else 12, (300 if quick else _BRUTE))
    yield _batches(20 if quick else 200, (300 if quick else _BRUTE))


def _rotation(bandwidths: tuple[int, ...]) -> Table:
    matrix = _TURN.as_matrix()
    rows = []
    for b in bandwidths:
        coefficients = random_coefficients(b, _BATCHES[b])
        packed = [np.ascontiguousarray(row) for row in fsh.to_packed(coefficients)]
        calls: dict[str, Callable[[], object]] = {
            "ours": partial(fsh.rotate_coefficients, coefficients, matrix, threads=1),
            "ducc0": partial(_ducc0_rotations, packed, b - 1),
        }
        if importlib.util.find_spec("healpy") is not None:
            calls["healpy"] = partial(_healpy_rotations, packed, b - 1)
        with limited(1):
            times = interleave(calls)
        turned = fsh.rotate_coefficients(coefficients, matrix)
        directions = fsh.fibonacci_grid(500).directions
        error = relative_error(fsh.evaluate(turned, directions), fsh.evaluate(coefficients, directions @ matrix))
        back = relative_error(fsh.rotate_coefficients(turned, matrix.T), coefficients)
        energies = fsh.degree_energies(coefficients)
        kept = float(np.abs(fsh.degree_energies(turned) / energies - 1).max())
        cells: dict[str, Cell] = {
            "b": b,
            "error": error,
            "back": back,
            "energies": kept,
            "ours": times["ours"].scaled(1 / len(coefficients)),
            "ducc0": times["ours"].over(times["ducc0"]),
            "healpy": times["ours"].over(times["healpy"]) if "healpy" in times else None,
        }
        checks = (
            Check("error", error, "<=", 5e-12),
            Check("energies", kept, "<=", 1e-13),
            Check("time / ducc0", times["ours"].over(times["ducc0"]), "<=", 1.5),
        )
        rows.append(Row(cells, checks))
    return Table(
        "rotation",
        "Exact rotation of coefficients, one thread: error against re-sampling, there and back, and of degree energies",
        (
            Column("b", "b", "d"),
            Column("error", "error", ".1e"),
            Column("back", "there and back", ".1e"),
            Column("energies", "energies", ".1e"),
            Column("ours", "ms a function", ".3g", 1e3),
            Column("ducc0", "time / ducc0", ".2f"),
            Column("healpy", "time / healpy", ".2f"),
        ),
        tuple(rows),
    )


def _pairs(count: int, brute: int) -> Table:
    """One pair at b = 16 with 32 shells; the copy is turned and noisy."""
    grid = super_fibonacci(brute)
    rows = []
    for noise in (0.0, 0.1):
        cases = [_pair(seed, noise) for seed in range(count)]
        found = [fsh.estimate_rotation(source, target).rotation for source, target, _ in cases]
        bases = [_turned(target[:, :64], grid) for _, target, _ in cases]
        coarse = [grid[_best(base, source[:, :64])] for base, (source, _, _) in zip(bases, cases, strict=True)]
        source, target, _ = cases[0]
        with limited(1):
            times = interleave(
                {
                    "ours": partial(fsh.estimate_rotation, source, target),
                    "product": partial(_best, bases[0], source[:, :64]),
                }
            )
        errors = np.array([_degrees(one, case[2]) for one, case in zip(found, cases, strict=True)])
        plain = np.array([_degrees(one, case[2]) for one, case in zip(coarse, cases, strict=True)])
        cells: dict[str, Cell] = {
            "noise": noise,
            "error": float(errors.max()),
            "brute": float(np.median(plain)),
            "ours": times["ours"],
            "ratio": times["ours"].over(times["product"]),
        }
        # A copy with noise can be told no better than noise allows.
        checks = (
            Check("error", float(errors.max()), "<=", 1e-6 if noise == 0 else 0.5),
            Check("ms a pair", times["ours"].median * 1e3, "<=", 5.0),
        )
        rows.append(Row(cells, checks))
    return Table(
        "rotation_pair",
        f"One pair, b = 16, 32 shells, one thread, {count} pairs; brute force: {brute} rotations, degrees < 8, rotated "
        "copies given",
        (
            Column("noise", "noise"),
            Column("error", "largest error °", ".1e"),
            Column("brute", "brute force, median °", ".1f"),
            Column("ours", "ms a pair", ".3g", 1e3),
            Column("ratio", "time / brute force", ".2f"),
        ),
        tuple(rows),
    )


def _batches(candidates: int, brute: int) -> Table:
    """Many candidates against one target: 24 functions of bandwidth 8."""
    rng = np.random.default_rng(3)
    decay = (fsh.degrees_and_orders(8)[0] + 1.0) ** -1.5
    sources, target = rng.standard_normal((candidates, 24, 64)) * decay, rng.standard_normal((24, 64)) * decay
    sources[..., 0] = target[..., 0] = 0  # degree 0 is the same for all rotations
    base = _turned(target, super_fibonacci(brute))
    _, thorough = fsh.estimate_rotations(sources, target, steps=20)
    rows = []
    for threads in (1, 2):
        with limited(threads):
            times = interleave(
                {
                    "ours": partial(fsh.estimate_rotations, sources, target, threads=threads),
                    "product": partial(_scores, base, sources),
                }
            )
        loss = float(np.mean(1 - fsh.estimate_rotations(sources, target)[1] / thorough))
        cells: dict[str, Cell] = {
            "threads": threads,
            "loss": loss,
            "brute": float(np.mean(1 - _scores(base, sources).max(axis=1) / thorough)),
            "ours": times["ours"],
            "ratio": times["ours"].over(times["product"]),
        }
        checks = (Check(f"ms for {candidates}", times["ours"].median * 1e3, "<=", 25.0),) if threads == 2 else ()
        rows.append(Row(cells, checks))
    return Table(
        "rotation_batch",
        f"{candidates} candidates, 24 functions of bandwidth 8: mean share of the highest correlation that is missed; "
        f"brute force: {brute} rotations, rotated copies given",
        (
            Column("threads", "threads", "d"),
            Column("loss", "missed", ".1e"),
            Column("brute", "missed by brute force", ".1e"),
            Column("ours", "ms", ".3g", 1e3),
            Column("ratio", "time / brute force", ".2f"),
        ),
        tuple(rows),
    )


def super_fibonacci(count: int) -> NDArray[np.float64]:
    """Return ``count`` rotations (n, 3, 3) of low discrepancy (Alexa 2022, algorithm 1)."""
    # ψ solves ψ⁴ = ψ + 4.
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    radius, other = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.stack((radius * np.sin(alpha), radius * np.cos(alpha), other * np.sin(beta), other * np.cos(beta)))
    return np.asarray(Rotation.from_quat(quaternions.T).as_matrix())


def _pair(seed: int, noise: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    decay = (fsh.degrees_and_orders(16)[0] + 1.0) ** -1.5
    source, other = rng.standard_normal((2, 32, 256)) * decay
    matrix = Rotation.random(rng=rng).as_matrix()
    return source, np.asarray(fsh.rotate_coefficients(source, matrix) + noise * other), matrix


def _turned(target: NDArray[np.float64], rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """The target turned back by each rotation, one a row, ready for a product with sources."""
    return np.stack([fsh.rotate_coefficients(target, matrix.T, threads=1).ravel() for matrix in rotations])


def _scores(base: NDArray[np.float64], sources: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(sources.reshape(len(sources), -1) @ base.T)


def _best(base: NDArray[np.float64], source: NDArray[np.float64]) -> int:
    return int((base @ source.ravel()).argmax())


def _degrees(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(first - second) / np.sqrt(8)))))


def _ducc0_rotations(packed: list[Any], lmax: int) -> None:
    alpha, beta, gamma = _TURN.as_euler("ZYZ")
    for row in packed:
        ducc0.sht.rotate_alm(row, lmax, gamma, beta, alpha, nthreads=1)


def _healpy_rotations(packed: list[Any], lmax: int) -> None:
    import healpy

    for row in packed:
        healpy.rotate_alm(row.copy(), *_TURN.as_euler("ZYZ"), lmax=lmax)
