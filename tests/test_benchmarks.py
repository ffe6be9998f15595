"""The benchmarks run at small sizes and report what they say they do; figures of time are never asserted."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.spatial import cKDTree

import fsh3d_o3d as fsh
from benchmarks import __main__ as command
from benchmarks import _measure, _partial_methods, _partial_pairs, _table, harmonics, registration_partial
from benchmarks._table import Check, Column, Curve, Plot, Row, Table, write_tables
from fsh3d_o3d.geometry import area_samples
from tests.optional import skip_without_torch

# Figures that do not depend on the machine's speed: their targets hold at any size.
ACCURACY = {
    "residual",
    "min·n/4π",
    "max·n/4π",
    "negative",
    "steps",
    "warned where not exact",
    "noise ×",
    "error",
    "energies",
    "deviation",
    "RMS in hole",
    "mean change, equiangular / Fibonacci",
    "median",
    "max",
    "success",
    "times FPFH's share",
}
TABLES = {
    "weights": ["weights", "weights_small_grids"],
    "roundtrip": ["roundtrip"],
    "harmonics": ["harmonics"],
    "transform": ["transform_dgemm", "transform_ducc0", "transform_crossover"],
    "radial": ["radial_meshes", "radial_clouds"],
    "features": ["features_rotation"],
    "descriptors": ["descriptors"],
    "local_features": ["local_features"],
    "registration": ["registration", "registration_partial", "registration_partial_confidence"],
    "index": ["index"],
    "rotation": ["rotation", "rotation_pair", "rotation_batch"],
    "learning": ["learning_transform", "learning_evaluation", "learning_memory", "learning_device"],
}


@pytest.mark.parametrize("name", list(command.BENCHMARKS))
def test_quick_run_gives_well_formed_tables(name: str) -> None:
    skip_without_torch(needed=name == "learning")
    tables = list(command.BENCHMARKS[name](quick=True))
    assert [table.name for table in tables] == TABLES[name]
    for table in tables:
        keys = {column.key for column in table.columns}
        assert table.rows
        for row in table.rows:
            assert set(row.cells) == keys
            times = [cell for cell in row.cells.values() if isinstance(cell, _measure.Timing)]
            assert all(0 < timing.minimum <= timing.median <= timing.maximum for timing in times)
            numbers = [cell for cell in row.cells.values() if isinstance(cell, float)]
            assert all(math.isfinite(number) for number in numbers)
            missed = [str(check) for check in row.checks if check.quantity in ACCURACY and not check.met]
            assert not missed, row.cells
        json.dumps(table.record(), allow_nan=False)
        assert len(table.markdown().splitlines()) >= len(table.rows) + 4
        for curve in () if table.plot is None else table.plot.curves:
            assert len(curve.x) == len(curve.y) > 0


def test_command_writes_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--output", str(tmp_path), "--only", "harmonics", "--quick"]) == 0
    printed = capsys.readouterr().out
    assert "2 of 2 targets reached" in printed
    document = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert [table["name"] for table in document["tables"]] == ["harmonics"]
    assert document["environment"]["python"]
    assert "| l ≤ |" in (tmp_path / "results.md").read_text(encoding="utf-8")
    # Matplotlib is an extra of the benchmarks: a picture is written exactly where it is installed.
    assert (tmp_path / "harmonics.png").exists() == (importlib.util.find_spec("matplotlib") is not None)


def test_unknown_benchmark_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command.main(["--output", str(tmp_path), "--only", "nonsense"])
    assert caught.value.code == 2
    assert "nonsense" in capsys.readouterr().err


class Clock:
    """In place of the module ``time``: goes on by what the timed calls say they take, and by nothing else."""

    def __init__(self) -> None:
        self._wall = self._processor = 0.0

    def pass_by(self, wall: float, processor: float) -> None:
        self._wall += wall
        self._processor += processor

    def perf_counter(self) -> float:
        return self._wall

    def process_time(self) -> float:
        return self._processor


def test_interleaving_counts_calls_alike_and_takes_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    clock = Clock()
    monkeypatch.setattr(_measure, "time", clock)
    calls = {
        "a": lambda: (order.append("a"), clock.pass_by(2.0, 0.5)),
        "b": lambda: (order.append("b"), clock.pass_by(3.0, 6.0)),
    }
    times = _measure.interleave(calls, rounds=4, budget=60.0)
    # Two warm-up calls a side, then rounds in alternating order.
    assert "".join(order) == "aabb" + "abba" * 2
    assert all(len(timing.samples) == 4 for timing in times.values())
    assert times["a"].samples == (2.0,) * 4 and times["b"].samples == (3.0,) * 4
    assert (times["a"].cores, times["b"].cores) == (0.25, 2.0)


def test_rounds_end_when_the_time_is_up_but_not_before_the_third(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(_measure, "time", clock)
    for seconds, rounds in ((1.0, 5), (100.0, 3)):
        timing = _measure.interleave({"a": lambda s=seconds: clock.pass_by(s, s)}, rounds=9, budget=4.5)["a"]
        assert len(timing.samples) == rounds


def test_short_calls_are_repeated_within_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(_measure, "time", clock)
    calls: list[int] = []
    timing = _measure.interleave({"a": lambda: (calls.append(1), clock.pass_by(2.0**-10, 0.0))}, rounds=3)["a"]
    assert timing.samples == (2.0**-10,) * 3
    assert len(calls) >= 3 * 5  # a sample takes 5 ms at least


def test_ratio_is_the_median_over_rounds() -> None:
    ours, peer = _measure.Timing((2.0, 9.0, 2.0), 1.0), _measure.Timing((1.0, 3.0, 1.0), 1.0)
    assert ours.over(peer) == 2.0
    assert ours.scaled(0.5).samples == (1.0, 4.5, 1.0)


def test_peak_memory_is_that_of_the_child() -> None:
    held = np.ones(40_000_000)  # 320 MB here must not count
    small = _measure.peak_memory("pass")
    large = _measure.peak_memory("import sys; block = b'x' * int(sys.argv[1])", 2**27)
    assert held[0] == 1
    # A bare interpreter takes about 10 MB; 100 MB leaves room for other builds.
    assert small < 100 * 2**20
    assert 0.9 * 2**27 < large - small < 1.5 * 2**27
    with pytest.raises(RuntimeError, match="out of luck"):
        _measure.peak_memory("raise SystemExit('out of luck')")


def test_checks_and_verdicts() -> None:
    met, missed = Check("ratio", 1.0, "<=", 1.3), Check("share", 0.5, ">=", 0.7)
    assert met.met and not missed.met
    assert not Check("error", math.nan, "<=", 1.0).met
    assert Row({}).verdict == "–"
    assert Row({}, (met,)).verdict == "pass"
    assert Row({}, (met, missed)).verdict == "MISS: share 0.5"
    assert Row({}, (met, missed)).target == "ratio <= 1.3, share >= 0.7"


def test_cells_are_shown_with_their_unit() -> None:
    milliseconds = Column("t", "ms", ".3g", 1e3)
    assert milliseconds.show(_measure.Timing((0.002, 0.001, 0.004), 1.0)) == "2 (1–4)"
    assert milliseconds.show(0.25) == "250"
    assert Column("x", "x").show(None) == "–"
    assert Column("x", "x", "d").show(7) == "7"
    assert [Column("x", "x").show(value) for value in (True, False, "word")] == ["yes", "no", "word"]


def test_missed_targets_name_the_case(tmp_path: Path) -> None:
    columns = (Column("b", "b"), Column("error", "error", ".1e"))
    rows = (
        Row({"b": 16, "error": 1e-3}, (Check("error", 1e-3, "<=", 1e-2),)),
        Row({"b": 32, "error": math.inf}, (Check("error", math.inf, "<=", 1e-2),)),
    )
    table = Table("demo", "Demonstration", columns, rows, Plot("b", "error", (Curve("ours", [16, 32], [1e-3, 1.0]),)))
    assert table.missed == ("demo: b 32, error inf: error <= 0.01 but inf",)
    write_tables(tmp_path, [table], {"python": "3"})
    record = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["tables"][0]["rows"]
    assert record[0]["checks"][0]["met"] is True
    assert record[1]["error"] is None  # JSON knows no infinity


def test_picture_has_room_for_title_legend_and_labels() -> None:
    """A long title and many curves; nothing may be cut off, lie on something else, or be drawn without a scale."""
    curves = [Curve(f"a long name {k}", [16, 64], [1e-3 * (k + 1.5), 2e-3], dashed=k % 2 == 1) for k in range(8)]
    plot = Plot("bandwidth b", "error", tuple(curves[:2]), 2e-3, "limit of this")
    for given in (plot, Plot("bandwidth b", "error", tuple(curves))):
        figure = _table._figure(Table("demo", "A title of many words. " * 5, (), (), given), given)
        FigureCanvasAgg(figure).draw()
        (axes,) = figure.axes
        legend, title = axes.get_legend(), axes._left_title
        own = axes.get_window_extent()
        for part in (legend, title, axes.xaxis.label, axes.yaxis.label):
            box = part.get_window_extent()
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
            assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
            assert not own.overlaps(box)
        assert not legend.get_window_extent().overlaps(title.get_window_extent())
        lines = axes.get_lines()
        assert lines[0].get_color() == lines[1].get_color()  # the two sides of a comparison
        assert [line.get_linestyle() for line in lines[:2]] == ["-", "--"]
        low, high = axes.get_ylim()
        assert sum(low <= tick <= high for tick in axes.get_yticks()) >= 2
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [curve.label for curve in curves]


def test_extended_precision_oracle_knows_low_degrees() -> None:
    direction = np.array([[0.48, -0.6, 0.64]])
    x, y, z = direction[0]
    found = np.asarray(harmonics.extended_harmonics(direction, 3)[0], dtype=np.float64)
    root = math.sqrt(3 / (4 * math.pi))
    expected = {
        0: math.sqrt(1 / (4 * math.pi)),
        1: root * y,
        2: root * z,
        3: root * x,
        4: math.sqrt(15 / (4 * math.pi)) * x * y,
        6: math.sqrt(5 / (16 * math.pi)) * (3 * z * z - 1),
        8: math.sqrt(15 / (16 * math.pi)) * (x * x - y * y),
    }
    for index, value in expected.items():
        # Both sides are a handful of roundings from the truth.
        assert found[index] == pytest.approx(value, rel=1e-14)
    # Against our own at a higher degree: 1e-13 is the target of the benchmark itself.
    np.testing.assert_allclose(
        np.asarray(harmonics.extended_harmonics(direction, 20), dtype=np.float64),
        fsh.spherical_harmonics(direction, 20),
        atol=1e-13,
    )


def test_partial_pairs_show_what_their_kind_says() -> None:
    shapes = _partial_pairs.partial_shapes(1, samples=True)
    ((_, mesh),) = shapes
    assert mesh.diagonal == pytest.approx(1.0)
    model = cKDTree(area_samples(mesh, 50_000)[0])
    for kind in _partial_pairs.PARTIAL_KINDS:
        (pair,) = _partial_pairs.partial_pairs(shapes, kind)
        (again,) = _partial_pairs.partial_pairs(shapes, kind)
        np.testing.assert_array_equal(again.source, pair.source)
        back = (pair.source - pair.shift) @ pair.rotation
        for cloud in (back, pair.target):
            # The true motion lays both on the model, but for noise and the spacing of its samples.
            apart = np.median(model.query(cloud)[0])
            assert apart < (0.012 if "1 % noise" in kind else 0.005), kind
        shared = np.mean(cKDTree(pair.target).query(back)[0] < 0.02)
        if kind == "parts that share a third":
            assert 0.25 < shared < 0.45
        if "cut off" in kind:
            assert len(back) == {"30": 14_000, "ha": 10_000, "80": 4_000}[kind[:2]]
            assert shared > 0.99
        # A pose that is the truth is found to be it, one that is not is not.
        truth = np.eye(4)
        truth[:3, :3], truth[:3, 3] = pair.rotation.T, -pair.shift @ pair.rotation
        assert registration_partial.distance_of(pair, truth) < 1e-12
        assert registration_partial.distance_of(pair, np.eye(4)) > 0.02


@pytest.mark.parametrize("installed", [True, False])
def test_a_peer_that_is_not_installed_is_told(installed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    some = registration_partial.Tries(np.array([0.001, 0.5]), np.array([1.0, 2.0]), np.array([0.9, 0.1]))
    names = ["ours", _partial_methods.REFERENCE] + ["KISS-Matcher + ICP"] * installed
    monkeypatch.setattr(registration_partial, "METHODS", dict.fromkeys(names))
    table = registration_partial.success_table({"half cut off": dict.fromkeys(names, some)}, 2)
    assert ("KISS-Matcher is not measured" in table.text()) != installed
    assert [row.cells["far"] for row in table.rows] == [0.5] * len(names)
    assert table.rows[0].cells["spread"] == "1.00 … 1.00"


def test_wrong_answers_with_confidence_are_told() -> None:
    tries = registration_partial.Tries(np.array([0.001, 0.5, 0.001, 0.5]), np.ones(4), np.array([1.0, 0.95, 0.3, 0.0]))
    table = registration_partial.confidence_table(tries)
    assert [(row.cells["pairs"], row.cells["right"]) for row in table.rows] == [
        (1, 0.0),
        (0, None),
        (1, 1.0),
        (0, None),
        (2, 0.5),
    ]
    assert len(table.missed) == 1
    assert "50 % of the right answers have 0.5 or more; of the 2 wrong ones 1 have more" in table.notes[-1]
