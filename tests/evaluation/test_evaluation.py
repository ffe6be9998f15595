"""Evaluation of a small library with a toy descriptor whose ranking is known."""

from __future__ import annotations

import json

import pytest

from fsh3d_o3d.evaluation.classification import read_classification
from fsh3d_o3d.evaluation.evaluation import evaluate_models
from tests.jobs import toys
from tests.jobs.mesh_files import write_box
from tests.jobs.toys import ToyDescriptor


@pytest.fixture
def library(tmp_path):
    """Flat boxes 1 2 3, long boxes 4 5 6, a miscellaneous one (7) among them, 8 that kills, 9 missing, 10 twice."""
    folder = tmp_path / "models"
    for model in (1, 2, 3):
        write_box(folder / f"flat/m{model}.off", (1, 10, 10 + model / 10))
    for model in (4, 5, 6):
        write_box(folder / f"m{model}/m{model}.OFF", (1, 1, 20 + model / 10))
    write_box(folder / "7.off", (1, 1, 20.45))
    write_box(folder / "8.off", vertices=toys.CRASH)
    write_box(folder / "10.off")
    write_box(folder / "other/m10.off")
    file = tmp_path / "test.cla"
    file.write_text("PSB 1\n4 10\nbox 0 0\nflat box 4\n1 2 3 8\nlong box 5\n4 5 6 9 10\n-1 0 1\n7\n")
    return folder, read_classification(file)


def test_scores_and_failures(library):
    folder, classification = library
    result = evaluate_models(folder, classification, ToyDescriptor(), workers=2, cache=False)
    assert result.models == 7
    assert [(failed.path, failed.reason.split(":")[0]) for failed in result.failed] == [
        ("9", f"no file of this name below {folder}"),
        ("10", "2 files have this name"),
        (str(folder / "8.off"), "the process describing it was killed by SIGSEGV"),
    ]
    assert [(scores.label, scores.size) for scores in result.metrics.classes] == [("box/flat", 3), ("box/long", 3)]
    # 4 (20.4) and 5 (20.5) have 7 (20.45) first, 6 (20.6) has 5: one of three long boxes finds its class first.
    assert result.metrics.nearest_neighbor == pytest.approx(4 / 6)
    assert result.metrics.macro.nearest_neighbor == pytest.approx((1 + 1 / 3) / 2)
    assert result.seconds_per_model > 0
    assert result.seconds > 0


def test_as_json(library):
    folder, classification = library
    result = evaluate_models(folder, classification, ToyDescriptor(), workers=1)
    values = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    figures = {"nearest_neighbor", "first_tier", "second_tier", "e_measure", "dcg"}
    assert set(values["micro"]) == set(values["macro"]) == figures
    assert values["micro"]["nearest_neighbor"] == result.metrics.nearest_neighbor
    assert values["macro"]["dcg"] == result.metrics.macro.dcg
    assert values["models"] == 7
    assert [set(failed) for failed in values["failed"]] == [{"path", "reason"}] * 3
    assert values["precision_recall"] == result.metrics.precision_recall.tolist()
    assert values["recall"] == pytest.approx([0.05 * i for i in range(1, 21)])
    assert values["classes"][0]["label"] == "box/flat"
    again = evaluate_models(folder, classification, ToyDescriptor(), workers=1)
    assert again.cached == 7
    assert again.as_dict()["micro"] == values["micro"]
    assert again.seconds_per_model == result.seconds_per_model


def test_too_little_to_score(library, tmp_path):
    folder, classification = library
    (tmp_path / "none").mkdir()
    with pytest.raises(ValueError, match=r"none of the 10 models .* could be described; 1: no file of this name"):
        evaluate_models(tmp_path / "none", classification, ToyDescriptor(), workers=1, cache=False)
    for model in (1, 4):
        write_box(next(folder.rglob(f"m{model}.*")), vertices=toys.RAISE)
    with pytest.raises(ValueError, match="5 of 10 models could be described: no class has more than 2"):
        evaluate_models(folder, classification, ToyDescriptor(), workers=1, cache=False)
