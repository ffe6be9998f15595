"""``fsh3d evaluate`` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsh3d_o3d.cli import main

SAMPLES = Path(__file__).parents[2] / "samples"
CLASSES = {
    "stones": ["bennu_like", "bennu_like_low", "bennu_cloud"],
    "ellipsoids": ["gem", "gem_rotated", "stone_degree8", "bumpy_ellipsoid"],
    "stars": ["starfish", "starfish_posed", "spiky_star"],
}


def classification(folder, classes):
    lines = ["PSB 1", f"{len(classes)} {sum(map(len, classes.values()))}"]
    for name, models in classes.items():
        lines += ["", f"{name} 0 {len(models)}", *models]
    path = folder / "samples.cla"
    path.write_text("\r\n".join(lines))
    return path


def evaluate(*arguments):
    return main(["evaluate", *map(str, arguments)])


def test_samples(tmp_path, capsys):
    file = classification(tmp_path, CLASSES)
    target, plot = tmp_path / "out.json", tmp_path / "pr.png"
    common = ("--models", SAMPLES, "--classification", file, "--option", "energies", "--workers", "2")
    assert evaluate(*common, "--json", target, "--plot", plot) == 0
    out, err = capsys.readouterr()
    assert err == ""
    values = json.loads(target.read_text())
    assert values["models"] == 10
    assert values["failed"] == []
    # A rotated gem, a posed starfish and a coarser asteroid are found first, whatever else the classes hold.
    assert values["micro"]["nearest_neighbor"] >= 0.6
    assert len(values["precision_recall"]) == 20
    assert values["seconds_per_model"] > 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    lines = out.splitlines()
    assert lines[0] == "shd (energies, fibonacci): 10 models, 3 classes scored, 0 failed"
    assert lines[2].split()[:2] == ["micro", f"{100 * values['micro']['nearest_neighbor']:.1f}"]
    assert lines[3].split()[-1] == f"{100 * values['macro']['dcg']:.1f}"
    # Again, from the cache; then on the other grid, which is another descriptor.
    assert evaluate(*common) == 0
    assert "10 from the cache" in capsys.readouterr().out
    assert evaluate(*common, "--grid", "equiangular") == 0
    out = capsys.readouterr().out
    assert "(energies, equiangular)" in out
    assert " 0 from the cache" in out
    assert values["neighborhood"] is None
    assert evaluate(*common, "--rerank", "5", "--neighbors", "3", "--json", target) == 0
    out = capsys.readouterr().out
    assert out.startswith("shd (energies, fibonacci, 5 re-ranked): 10 models")
    assert [line.split("  ")[0] for line in out.splitlines()[2:6]] == [
        "micro",
        "macro",
        "micro, common neighbours",
        "macro, common neighbours",
    ]
    again = json.loads(target.read_text())
    assert set(again["neighborhood"]) == {"micro", "macro"}
    assert again["micro"]["nearest_neighbor"] >= values["micro"]["nearest_neighbor"]


def test_failed_inputs_are_listed(tmp_path, capsys):
    classes = {**CLASSES, "broken": ["bad_word", "empty", "truncated"], "missing": ["no_such"]}
    file, target = classification(tmp_path, classes), tmp_path / "out.json"
    assert evaluate("--models", SAMPLES, "--classification", file, "--option", "energies", "--json", target) == 1
    out, err = capsys.readouterr()
    assert "10 models, 3 classes scored, 4 failed" in out
    assert err.count("\n") == err.count("fsh3d: failed: ") == 4
    assert f"fsh3d: failed: {SAMPLES / 'broken' / 'empty.off'}: " in err
    assert "fsh3d: failed: truncated: 4 files have this name" in err
    assert f"fsh3d: failed: no_such: no file of this name below {SAMPLES}" in err
    assert len(json.loads(target.read_text())["failed"]) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--models", "none"], "none: No such file or directory"),
        (["--classification", "none.cla"], "none.cla: No such file or directory"),
        (["--classification", SAMPLES / "gem.stl"], "classification file"),
        (["--json", "no/such/folder/out.json"], "there is no folder"),
        (["--plot", "curve.jpg"], "--plot must end in .png"),
        (["--workers", "0"], "not between 1 and 1024"),
        (["--workers", "two"], "invalid"),
        (["--option", "worst"], "invalid choice"),
    ],
)
def test_refused(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    file = classification(tmp_path, CLASSES)
    assert evaluate("--models", SAMPLES, "--classification", file, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err
    assert "internal error" not in err
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_nothing_to_score(tmp_path, capsys):
    file = classification(tmp_path, {"gems": ["gem", "gem_rotated"]})
    target = tmp_path / "out.json"
    assert evaluate("--models", SAMPLES, "--classification", file, "--option", "energies", "--json", target) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "fsh3d: error: 2 of 2 models could be described: no class has more than 2 models, "
        "so there is nothing to average"
    ]
    assert not target.exists()
