"""Retrieval metrics as the tools of the Princeton Shape Benchmark define them.

Every model is a query for the others of its class. Shilane, Min, Kazhdan, Funkhouser, "The Princeton Shape Benchmark",
SMI 2004, section 4; where the paper leaves room, the benchmark's own tools (psbTable, psbPlot) decide.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray, IntArray
from fsh3d_o3d._value import value

__all__ = ["RECALL_LEVELS", "ClassScores", "RetrievalMetrics", "RetrievalScores", "retrieval_metrics"]

_RECALL_POINTS = 20  # of the curve, as the benchmark's psbPlot draws it
RECALL_LEVELS: Float64Array = np.arange(1, _RECALL_POINTS + 1) / _RECALL_POINTS
"""Recall at which ``RetrievalMetrics.precision_recall`` gives the precision: 0.05, 0.10, …, 1."""
RECALL_LEVELS.setflags(write=False)

_LARGEST_CLASS_LEFT_OUT = 2  # models; psbTable scores no class this small
_FIRST_PAGE = 32  # results that the E-measure looks at, as the benchmark defines it
_BLOCK_ENTRIES = 2**22  # of the distance matrix, ranked at a time: about 150 MB of work space


@value
class RetrievalScores:
    """The five figures of one table row, as fractions in [0, 1]."""

    nearest_neighbor: float
    """Share of queries whose first result is of their class."""
    first_tier: float
    """Recall within the first C − 1 results, C being the size of the query's class."""
    second_tier: float
    """Recall within the first 2(C − 1) results."""
    e_measure: float
    """Harmonic mean of precision and recall within the first 32 results."""
    dcg: float
    """Discounted cumulative gain, relative to that of a perfect ranking."""


_FIGURES = tuple(field.name for field in fields(RetrievalScores))


@value
class ClassScores(RetrievalScores):
    """Averages over the queries of one class."""

    label: int | str
    """The class, as in the given labels."""
    size: int
    """Models in the class."""


@value
class RetrievalMetrics(RetrievalScores):
    """What a ranking is worth; the five figures are averages over queries (micro averages)."""

    precision_recall: Float64Array
    """(20,) precision at ``RECALL_LEVELS``, averaged over the queries whose class is large enough to reach a level;
    0 where there is none. Unlike the table, the curve counts the query among its results, and classes of two."""
    macro: RetrievalScores
    """Averages over classes of the classes' averages."""
    classes: tuple[ClassScores, ...]
    """One for every class that counts, by label."""

    @property
    def micro(self) -> RetrievalScores:
        """The averages over queries by themselves."""
        return RetrievalScores(**{name: getattr(self, name) for name in _FIGURES})


def retrieval_metrics(distances: object, labels: object, *, unscored: Collection[int | str] = ()) -> RetrievalMetrics:
    """Score the rankings that a distance matrix gives.

    Row q ranks all others by distance, ties by the lower index; the query itself is left out. Classes of one or two
    models are candidates but no queries. With C the size of the query's class, P and R precision and recall among the
    first 32 and rel_i = 1 where result i is of the class: E = 2 / (1/P + 1/R) and
    DCG = (rel_1 + Σ_{i ≥ 2} rel_i / log2 i) / (1 + Σ_{j=2}^{C−1} 1 / log2 j).

    Args:
        distances: (N, N) finite real numbers, row by query; need not be symmetric, may be negative similarities.
            Ranked in their own precision (float32 or float64), in blocks of rows: little memory beside the matrix.
        labels: (N,) class of each model: integers or strings.
        unscored: Labels of classes that are candidates but no queries whatever their size, such as the benchmark's
            class of miscellaneous models.

    Raises:
        ValueError: Not square, not finite, another number of labels than rows, or no class of three or more.
        TypeError: Not numbers, or labels that are neither integers nor strings.

    Example:
        >>> values = np.array([0.0, 0.1, 0.3, 5.0, 5.1, 5.3])  # of six models; distances are their differences
        >>> labels = ["bolt", "bolt", "bolt", "nut", "nut", "nut"]
        >>> metrics = fsh.retrieval_metrics(np.abs(values[:, None] - values), labels)
        >>> print(metrics.nearest_neighbor, metrics.first_tier)
        1.0 1.0
        >>> [scores.label for scores in metrics.classes]
        ['bolt', 'nut']
    """
    matrix = check.real_array(distances, "distances")
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
        raise ValueError(f"distances must have shape (N, N), got {matrix.shape}")
    names, classes = _classes(labels, len(matrix))
    sizes = np.bincount(classes)
    ignored = np.array([name in unscored for name in names.tolist()])
    scored = (sizes > _LARGEST_CLASS_LEFT_OUT) & ~ignored
    if not scored.any():
        raise ValueError(f"no class has more than {_LARGEST_CLASS_LEFT_OUT} models, so there is nothing to average")
    # The curve knows no lower limit but one: a class of one has nothing to be found.
    plotted = (sizes >= _LARGEST_CLASS_LEFT_OUT) & ~ignored

    scores = np.zeros((len(matrix), len(_FIGURES)))
    precision = np.zeros(_RECALL_POINTS)
    reached = np.zeros(_RECALL_POINTS, dtype=np.int64)
    step = max(1, _BLOCK_ENTRIES // len(matrix))
    for start in range(0, len(matrix), step):
        queries = np.arange(start, min(start + step, len(matrix)))
        order = np.argsort(matrix[queries], axis=1, kind="stable")
        relevant = classes[order] == classes[queries, None]
        others = relevant[order != queries[:, None]].reshape(len(queries), -1)
        counted = scored[classes[queries]]
        scores[queries[counted]] = _table(others[counted], sizes[classes[queries[counted]]])
        shown = plotted[classes[queries]]
        total, count = _curve(relevant[shown], sizes[classes[queries[shown]]])
        precision += total
        reached += count

    means = np.stack([np.bincount(classes, column) for column in scores.T], axis=1)[scored] / sizes[scored, None]
    curve = precision / np.maximum(reached, 1)
    curve.setflags(write=False)
    return RetrievalMetrics(
        **_named(scores[scored[classes]].mean(axis=0)),
        precision_recall=curve,
        macro=RetrievalScores(**_named(means.mean(axis=0))),
        classes=tuple(
            ClassScores(**_named(row), label=label, size=size)
            for row, label, size in zip(means, names[scored].tolist(), sizes[scored].tolist(), strict=True)
        ),
    )


def _named(row: Float64Array) -> dict[str, Any]:
    return dict(zip(_FIGURES, row.tolist(), strict=True))


def _classes(labels: object, count: int) -> tuple[NDArray[Any], IntArray]:
    """The distinct labels in order, and each model's position among them."""
    array = np.asarray(check.unmasked(labels, "labels"))
    if array.shape != (count,):
        raise ValueError(f"labels must have shape (N,) = ({count},), one for each row of distances, got {array.shape}")
    if array.dtype.kind not in "iuU":
        raise TypeError(f"labels must be integers or strings, got dtype {array.dtype}")
    names, classes = np.unique(array, return_inverse=True)
    return names, classes.astype(np.int64)


def _table(relevant: NDArray[np.bool_], sizes: IntArray) -> Float64Array:
    """The five figures of queries (q, 5) from what is relevant among the others (q, N − 1), nearest first."""
    if len(relevant) == 0:
        return np.empty((0, 5))
    candidates = relevant.shape[1]
    wanted = sizes - 1
    found = np.cumsum(relevant, axis=1, dtype=np.int64)
    row = np.arange(len(relevant))
    page = min(_FIRST_PAGE, candidates)
    discount = 1 / np.log2(np.maximum(np.arange(1, candidates + 1), 2))  # positions 1 and 2 both count fully
    return np.column_stack(
        [
            relevant[:, 0],
            found[row, wanted - 1] / wanted,
            found[row, np.minimum(2 * wanted, candidates) - 1] / wanted,
            2 * found[:, page - 1] / (page + wanted),  # = 2 / (1/P + 1/R), and 0 where nothing is found
            relevant @ discount / np.cumsum(discount)[wanted - 1],
        ]
    )


def _curve(relevant: NDArray[np.bool_], sizes: IntArray) -> tuple[Float64Array, IntArray]:
    """Sums over queries of the interpolated precision (20,), and the number of queries (20,) that reach each level.

    ``relevant`` (q, N) counts the query itself. At recall r the precision is interpolated linearly at position
    r C − 1 among the precisions at the C relevant results; queries with r C < 1 do not reach the level.
    """
    if len(relevant) == 0:
        return np.zeros(_RECALL_POINTS), np.zeros(_RECALL_POINTS, dtype=np.int64)
    last = np.cumsum(sizes)
    first = last - sizes
    nth = np.arange(last[-1]) - np.repeat(first, sizes)
    precision: FloatArray = (nth + 1) / (np.nonzero(relevant)[1] + 1)
    # Twentieths in integers: whether a level is reached must not hang on a rounding error.
    twentieths = np.outer(sizes, np.arange(1, _RECALL_POINTS + 1)) - _RECALL_POINTS
    reached = twentieths >= 0
    below, rest = np.divmod(np.maximum(twentieths, 0), _RECALL_POINTS)
    above = np.minimum(below + 1, sizes[:, None] - 1)
    low, high = precision[first[:, None] + below], precision[first[:, None] + above]
    values = low + (high - low) * (rest / _RECALL_POINTS)
    return np.where(reached, values, 0.0).sum(axis=0), reached.sum(axis=0)
