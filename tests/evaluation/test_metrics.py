"""Metrics against values worked out by hand and against the definitions, one query at a time in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsh3d_o3d.evaluation import metrics
from fsh3d_o3d.evaluation.metrics import RECALL_LEVELS, retrieval_metrics

NAMES = ("nearest_neighbor", "first_tier", "second_tier", "e_measure", "dcg")

# Six models on a line, a a b a b b at 0 1 2.5 4.5 7 11: distances are all different from each query.
LINE = np.array([0, 1, 2.5, 4.5, 7, 11])
LINE_LABELS = ["a", "a", "b", "a", "b", "b"]
# What is relevant among the five others, nearest first, read off the line.
LINE_RELEVANT = {
    0: [1, 0, 1, 0, 0],  # 1a 2b 3a 4b 5b
    1: [1, 0, 1, 0, 0],  # 0a 2b 3a 4b 5b
    2: [0, 0, 0, 1, 1],  # 1a (1.5) 3a (2) 0a (2.5) 4b (4.5) 5b (8.5)
    3: [0, 0, 1, 1, 0],  # 2b (2) 4b (2.5) 1a (3.5) 0a (4.5) 5b (6.5)
    4: [0, 1, 1, 0, 0],  # 3a (2.5) 5b (4) 2b (4.5) 1a (6) 0a (7)
    5: [1, 0, 1, 0, 0],  # 4b (4) 3a (6.5) 2b (8.5) 1a 0a
}


def distances_on_a_line():
    return np.abs(LINE[:, None] - LINE[None, :])


def reference(distances, labels):
    """The definitions word by word, one query at a time: rows (label, nn, ft, st, e, dcg) and the curve."""
    count = len(labels)
    rows, curve = [], [[] for _ in range(20)]
    for query in range(count):
        size = sum(label == labels[query] for label in labels)
        ranking = sorted(range(count), key=lambda other: (distances[query][other], other))
        if size >= 2:
            at = [i for i, other in enumerate(ranking) if labels[other] == labels[query]]
            precision = [(n + 1) / (i + 1) for n, i in enumerate(at)]
            for level in range(1, 21):
                if level * size >= 20:
                    position = level * size / 20 - 1
                    curve[level - 1].append(float(np.interp(position, range(size), precision)))
        if size <= 2:
            continue
        hits = [labels[other] == labels[query] for other in ranking if other != query]
        page = min(32, count - 1)
        found = sum(hits[:page])
        rows.append(
            (
                labels[query],
                float(hits[0]),
                sum(hits[: size - 1]) / (size - 1),
                sum(hits[: 2 * (size - 1)]) / (size - 1),
                0.0 if found == 0 else 2 / (1 / (found / page) + 1 / (found / (size - 1))),
                (hits[0] + sum(hit / math.log2(i) for i, hit in enumerate(hits[1:], start=2)))
                / (1 + sum(1 / math.log2(j) for j in range(2, size))),
            )
        )
    return rows, [float(np.mean(values)) if values else 0.0 for values in curve]


def values(scores):
    return [getattr(scores, name) for name in NAMES]


def test_worked_out_by_hand():
    result = retrieval_metrics(distances_on_a_line(), LINE_LABELS)
    # C − 1 = 2: first tier looks at 2 results, second at 4; the first 32 are all 5, so P = 2/5, R = 1, E = 4/7.
    # DCG: positions 1 … 5 count 1, 1, 1/log2 3, 1/2, 1/log2 5, a perfect ranking 2.
    third, fifth = 1 / math.log2(3), 1 / math.log2(5)
    dcg = [(1 + third), (1 + third), (0.5 + fifth), (third + 0.5), (1 + third), (1 + third)]
    first_tier = (0.5 + 0.5 + 0 + 0 + 0.5 + 0.5) / 6
    second_tier = (1 + 1 + 0.5 + 1 + 1 + 1) / 6
    expected = [3 / 6, first_tier, second_tier, 4 / 7, sum(dcg) / 12]
    assert values(result) == pytest.approx(expected, abs=1e-14)  # sums of six numbers near 1
    by_class = {scores.label: scores for scores in result.classes}
    assert by_class["a"].size == by_class["b"].size == 3
    assert by_class["a"].second_tier == pytest.approx(1, abs=1e-14)
    assert by_class["b"].second_tier == pytest.approx((0.5 + 1 + 1) / 3, abs=1e-14)
    assert by_class["a"].dcg == pytest.approx((1 + third + 1 + third + third + 0.5) / 6, abs=1e-14)
    assert values(result.macro) == pytest.approx(values(result), abs=1e-14)  # classes of one size


def test_the_hand_made_table_is_the_line():
    for query, relevant in LINE_RELEVANT.items():
        order = [i for i in np.argsort(distances_on_a_line()[query]) if i != query]
        assert [int(LINE_LABELS[i] == LINE_LABELS[query]) for i in order] == relevant


def test_precision_recall_worked_out_by_hand():
    result = retrieval_metrics(distances_on_a_line(), LINE_LABELS)
    # With the query first, the three relevant results of query 0 are at ranks 1, 2, 4: precision 1, 1, 3/4.
    at = [[1, 1, 3 / 4], [1, 1, 3 / 4], [1, 2 / 5, 3 / 6], [1, 2 / 4, 3 / 5], [1, 2 / 3, 3 / 4], [1, 1, 3 / 4]]
    last = np.mean([row[2] for row in at])
    halfway = np.mean([0.5 * row[0] + 0.5 * row[1] for row in at])  # recall 0.5 of 3 is half-way from 1 to 2
    assert result.precision_recall.shape == RECALL_LEVELS.shape == (20,)
    assert result.precision_recall[-1] == pytest.approx(last, abs=1e-14)
    assert result.precision_recall[9] == pytest.approx(halfway, abs=1e-14)
    assert (result.precision_recall[:6] == 0).all()  # recall 0.3 of three models is less than one
    assert result.precision_recall[6] > 0


LIBRARIES = {
    "classes of all sizes, many ties, not symmetric": (np.repeat(np.arange(8), [1, 2, 3, 4, 7, 11, 20, 41]), 12),
    "more than one page of a class": (np.repeat(np.arange(2), [50, 34]), 10**6),
    "fewer models than a page": (np.repeat(np.arange(3), [3, 5, 4]), 10**6),
    "classes of one and two are candidates only": (np.repeat(np.arange(30), [1] * 12 + [2] * 17 + [6]), 40),
    "all at one distance": (np.repeat(np.arange(4), [3, 9, 9, 20]), 1),
}
"""Labels, and how many different distances there are."""


@pytest.mark.parametrize("name", LIBRARIES)
def test_libraries_against_the_definitions(name):
    labels, distances = LIBRARIES[name]
    random = np.random.default_rng(5)
    labels = random.permutation(labels).tolist()
    matrix = random.integers(0, distances, (len(labels), len(labels)))
    rows, curve = reference(matrix.tolist(), labels)
    result = retrieval_metrics(matrix, labels)
    by_class = {label: [row[1:] for row in rows if row[0] == label] for label in {row[0] for row in rows}}
    means = {label: np.mean(table, axis=0) for label, table in by_class.items()}
    # Sums of at most a hundred numbers near 1.
    assert values(result.micro) == pytest.approx(np.mean([row[1:] for row in rows], axis=0).tolist(), abs=1e-12)
    assert values(result.macro) == pytest.approx(np.mean(list(means.values()), axis=0).tolist(), abs=1e-12)
    assert result.precision_recall.tolist() == pytest.approx(curve, abs=1e-12)
    assert [(scores.label, scores.size) for scores in result.classes] == [
        (label, labels.count(label)) for label in sorted(means)
    ]
    for scores in result.classes:
        assert values(scores) == pytest.approx(means[scores.label].tolist(), abs=1e-12)


@st.composite
def labelled_matrices(draw):
    count = draw(st.integers(3, 12))
    labels = [0, 0, 0, *draw(st.lists(st.integers(0, 3), min_size=count - 3, max_size=count - 3))]
    seed = draw(st.integers(0, 2**32 - 1))
    return np.random.default_rng(seed).integers(0, 5, (count, count)).astype(float), labels


@given(labelled_matrices())
def test_agrees_with_the_definitions(case):
    matrix, labels = case
    rows, curve = reference(matrix.tolist(), labels)
    result = retrieval_metrics(matrix, labels)
    # Both sum at most a dozen numbers near 1.
    assert values(result) == pytest.approx(np.mean([row[1:] for row in rows], axis=0).tolist(), abs=1e-13)
    assert result.precision_recall.tolist() == pytest.approx(curve, abs=1e-13)


@given(labelled_matrices())
def test_only_the_order_counts(case):
    matrix, labels = case
    before = matrix.copy()
    result, stretched = retrieval_metrics(matrix, labels), retrieval_metrics(matrix**3 - 7, labels)
    assert values(result) == values(stretched)
    assert (result.precision_recall == stretched.precision_recall).all()
    assert (matrix == before).all()


def test_perfect_ranking():
    labels = np.repeat(["x", "y"], 40)
    result = retrieval_metrics(labels[:, None] != labels[None, :], labels)
    assert values(result) == pytest.approx([1, 1, 1, 2 * 32 / (32 + 39), 1], abs=1e-14)
    # Forty models reach recall 0.05 with the second of them: every level is reached, without one wrong result.
    assert (result.precision_recall == 1).all()


def test_ties_go_to_the_lower_index():
    # All at one distance: for query 0 and 2 the first other is of class 0, for 1 it is model 0, of another class.
    result = retrieval_metrics(np.zeros((6, 6)), [0, 1, 0, 1, 0, 1])
    assert [scores.nearest_neighbor for scores in result.classes] == [pytest.approx(2 / 3), 0]


def test_query_is_left_out_wherever_it_ranks():
    matrix = distances_on_a_line()
    np.fill_diagonal(matrix, 1e9)
    assert values(retrieval_metrics(matrix, LINE_LABELS)) == values(
        retrieval_metrics(distances_on_a_line(), LINE_LABELS)
    )


def test_blocks_of_rows_do_not_show(monkeypatch, rng):
    matrix, labels = rng.random((50, 50)), rng.integers(0, 6, 50)
    whole = retrieval_metrics(matrix, labels)
    monkeypatch.setattr(metrics, "_BLOCK_ENTRIES", 150)
    parts = retrieval_metrics(matrix, labels)
    assert values(parts) == values(whole)
    # Sums in another order.
    assert parts.precision_recall == pytest.approx(whole.precision_recall, abs=1e-14)


def test_unscored_classes_are_candidates_only():
    matrix = distances_on_a_line()
    result = retrieval_metrics(matrix, LINE_LABELS, unscored={"b", "another"})
    assert [scores.label for scores in result.classes] == ["a"]
    assert result.nearest_neighbor == pytest.approx(2 / 3, abs=1e-14)  # query 3 still has b beside it
    assert result.precision_recall[-1] == pytest.approx((3 / 4 + 3 / 4 + 3 / 5) / 3, abs=1e-14)


@pytest.mark.parametrize(
    ("matrix", "labels", "error", "message"),
    [
        (np.zeros((3, 4)), [0, 0, 0], ValueError, r"\(N, N\), got \(3, 4\)"),
        (np.zeros((0, 0)), [], ValueError, r"\(N, N\)"),
        (np.zeros(9), [0, 0, 0], ValueError, r"\(N, N\)"),
        (np.zeros((3, 3)), [0, 0], ValueError, r"labels must have shape \(N,\) = \(3,\)"),
        (np.full((3, 3), np.nan), [0, 0, 0], ValueError, "9 NaN or infinite"),
        (np.full((3, 3), np.inf), [0, 0, 0], ValueError, "9 NaN or infinite"),
        (np.zeros((3, 3), dtype=complex), [0, 0, 0], TypeError, "real numbers"),
        (np.zeros((3, 3)), [0.0, 0.0, 0.0], TypeError, "integers or strings"),
        (np.zeros((4, 4)), [0, 0, 1, 1], ValueError, "no class has more than 2"),
    ],
)
def test_bad_input(matrix, labels, error, message):
    with pytest.raises(error, match=message):
        retrieval_metrics(matrix, labels)
