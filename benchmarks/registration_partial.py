"""Alignment of shapes seen in part: how often, how fast and how far the confidence can be believed, beside peers."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks._measure import limited
from benchmarks._partial_methods import METHODS, REFERENCE, TARGETS
from benchmarks._partial_pairs import PARTIAL_KINDS, PartialPair, partial_pairs, partial_shapes
from benchmarks._table import Cell, Check, Column, Row, Table

_NEAR, _FAR = 0.01, 0.02  # of the diagonal; mean distance of the model from itself below which a pose is right
_SHAPES = 20
_ALL = "all"
_NOTHING = 9.0  # diagonals: the distance of a pose that is not a pose
_BANDS = (0.0, 0.05, 0.2, 0.5, 0.9, 1.0)  # limits between which confidences are counted together
_TRUSTED, _WRONG = 0.5, 0.2  # confidence above which answers are to be right, and below which wrong ones are to be
_TARGETS = {
    "view and whole": (0.97, 0.99),
    "views 30° apart": (0.97, 1.0),
    "views 60° apart": (0.85, 0.93),
    "views 90° apart": (0.60, 0.85),
    "30 % cut off": (0.99, 1.0),
    "half cut off": (0.99, 1.0),
    "80 % cut off": (0.99, 1.0),
    "parts that share a third": (0.80, 0.90),
    "views 30° apart, 1 % noise": (0.95, 1.0),
}
"""Least shares of pairs that ours is to get right, within 1 and within 2 % of the diagonal."""
_SLOWEST = {"ours": 1.0, "ours, prepared target": 0.5}
"""Of the reference's time, all pairs together."""


@dataclass(frozen=True, eq=False)
class Tries:
    """What a method found on pairs of one kind, or of all."""

    distances: NDArray[np.float64]
    """Of the model under the found pose from where it is, in diagonals."""
    seconds: NDArray[np.float64]
    """Of processor time."""
    confidences: NDArray[np.float64]
    """NaN where the method has none."""

    @property
    def successes(self) -> tuple[float, float]:
        """Shares within 1 and within 2 % of the diagonal."""
        return float(np.mean(self.distances <= _NEAR)), float(np.mean(self.distances <= _FAR))


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of successes and times, and that of confidences."""
    shapes = partial_shapes(2 if quick else _SHAPES, samples=quick)
    results = {kind: _tried(list(partial_pairs(shapes, kind))) for kind in list(PARTIAL_KINDS)[:: 4 if quick else 1]}
    results[_ALL] = {name: _joined([tries[name] for tries in results.values()]) for name in METHODS}
    yield success_table(results, len(shapes))
    yield confidence_table(results[_ALL]["ours"])


def _tried(cases: list[PartialPair]) -> dict[str, Tries]:
    """Try every method on every pair, in turns, so that a slow spell of the machine hits all of them."""
    measured: dict[str, list[tuple[float, float, float]]] = {name: [] for name in METHODS}
    level = o3d.utility.VerbosityLevel.Error  # RANSAC warns where few matches are mutual
    with limited(1), o3d.utility.VerbosityContextManager(level):
        for name, method in METHODS.items():
            method(cases[0].source, TARGETS[name](cases[0]))  # plans are made once
        for number, case in enumerate(cases):
            o3d.utility.random.seed(number)  # RANSAC's luck is the same in every run
            for name in list(METHODS)[:: 1 if number % 2 == 0 else -1]:
                target = TARGETS[name](case)
                begin = time.process_time()
                pose, confidence = METHODS[name](case.source, target)
                seconds = time.process_time() - begin
                measured[name].append((distance_of(case, pose), seconds, np.nan if confidence is None else confidence))
    return {name: Tries(*np.array(figures).T) for name, figures in measured.items()}


def distance_of(case: PartialPair, pose: NDArray[np.float64]) -> float:
    """Return the mean distance to the model of the model as the pose puts it; a symmetry changes nothing."""
    moved = (case.model @ case.rotation.T + case.shift) @ pose[:3, :3].T + pose[:3, 3]
    return float(np.mean(cKDTree(case.model).query(moved)[0])) if np.isfinite(moved).all() else _NOTHING


def _joined(tries: list[Tries]) -> Tries:
    fields = ("distances", "seconds", "confidences")
    return Tries(*(np.concatenate([getattr(each, field) for each in tries]) for field in fields))


def success_table(results: dict[str, dict[str, Tries]], shapes: int) -> Table:
    """Return how often and how fast each method was, by kind of pair."""
    rows = [_row(kind, name, tries[name], tries[REFERENCE]) for kind, tries in results.items() for name in METHODS]
    kiss = any("KISS" in name for name in METHODS)
    missing = () if kiss else ("KISS-Matcher is not measured: it is not installed (pip install kiss-matcher).",)
    return Table(
        "registration_partial",
        f"Alignment of two clouds of {shapes} models seen in part, in any position, units known",
        (
            Column("kind", "pair"),
            Column("method", "method"),
            Column("pairs", "pairs", "d"),
            Column("near", "within 1 %", ".0f", 100),
            Column("far", "within 2 %", ".0f", 100),
            Column("seconds", "ms a pair", ".0f", 1e3),
            Column("ratio", "time / RANSAC", ".2f"),
            Column("spread", "its quartiles"),
        ),
        tuple(rows),
        notes=(
            "within 1, 2 %: pairs (%) whose pose puts the whole model that near itself (mean, of its diagonal).",
            "Medians of processor time; time / RANSAC is of the same pairs in turns. A target is prepared before.",
            *missing,
        ),
    )


def _row(kind: str, name: str, tries: Tries, reference: Tries) -> Row:
    near, far = tries.successes
    ratios = tries.seconds / reference.seconds
    quartiles = np.quantile(ratios, (0.25, 0.75))
    cells: dict[str, Cell] = {
        "kind": kind,
        "method": name,
        "pairs": len(tries.distances),
        "near": near,
        "far": far,
        "seconds": float(np.median(tries.seconds)),
        "ratio": float(np.median(ratios)),
        "spread": "{:.2f} … {:.2f}".format(*quartiles),
    }
    checks: tuple[Check, ...] = ()
    if name == "ours" and kind in _TARGETS:
        least = _TARGETS[kind]
        checks = (Check("within 1 %", near, ">=", least[0]), Check("within 2 %", far, ">=", least[1]))
    if name in _SLOWEST and kind == _ALL:
        checks = (Check("times RANSAC's time", float(np.median(ratios)), "<=", _SLOWEST[name]),)
    return Row(cells, checks)


def confidence_table(tries: Tries) -> Table:
    """Return how many answers were right, by their confidence."""
    right, confidences = tries.distances <= _FAR, tries.confidences
    rows = []
    for low, high in itertools.pairwise(_BANDS):
        inside = (confidences >= low) & ((confidences < high) | (high == _BANDS[-1]))
        share = float(np.mean(right[inside])) if inside.any() else None
        checks = (Check("share right", share, ">=", 0.99),) if share is not None and low >= _TRUSTED else ()
        rows.append(Row({"band": f"{low:g} … {high:g}", "pairs": int(inside.sum()), "right": share}, checks))
    trusted = float(np.mean(confidences[right] >= _TRUSTED)) if right.any() else 0.0
    wrong = confidences[~right]
    worst = f"of the {len(wrong)} wrong ones {int(np.sum(wrong > _WRONG))} have more than {_WRONG:g}"
    worst += f", the highest {wrong.max():.2f}" if len(wrong) else ""
    return Table(
        "registration_partial_confidence",
        "How far the confidence of these alignments can be believed (ours, all kinds of pairs)",
        (Column("band", "confidence"), Column("pairs", "pairs", "d"), Column("right", "right %", ".0f", 100)),
        tuple(rows),
        notes=(
            "right: within 2 % of the diagonal.",
            f"{100 * trusted:.0f} % of the right answers have {_TRUSTED:g} or more; {worst}.",
        ),
    )
