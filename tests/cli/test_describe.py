"""``fsh3d describe``: one or many files, what is written, what happens to those that fail."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.cli import describe
from fsh3d_o3d.descriptors.shd import SHDOption, shd_descriptor
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.shapes.storage import read_arrays

SAMPLES = Path(__file__).parents[2] / "samples"
GEM, HORN, BROKEN = SAMPLES / "gem.stl", SAMPLES / "horn.off", SAMPLES / "broken" / "truncated.off"


def run(*arguments) -> int:
    parser = argparse.ArgumentParser()
    describe.add_parser(parser.add_subparsers())
    options = parser.parse_args(["describe", *map(str, arguments)])
    return options.run(options)


def test_features_of_several_files(tmp_path, capsys):
    target = tmp_path / "f.npz"
    assert run(GEM, HORN, "-o", target) == 0
    kind, arrays = read_arrays(target)
    assert kind == "features"
    assert arrays["paths"].tolist() == [str(GEM), str(HORN)]
    assert str(arrays["fingerprint"]) == SHDOption.best().fingerprint
    assert arrays["shape"].tolist() == [12, 300]
    assert arrays["features"].dtype == np.float32
    expected = shd_descriptor(read_geometry_arrays(HORN), SHDOption.best())
    np.testing.assert_array_equal(arrays["features"][1], expected)
    assert "2 of 2 files" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("arguments", "shape"),
    [
        (["--option", "energies"], (16, 32)),
        (["--option", "energies", "--bandwidth", "8", "--shells", "5"], (8, 5)),
        (["--option", "published"], (17, 32)),
        (["--bandwidth", "6", "--shells", "8"], (6, 300)),
    ],
    ids=["energies", "smaller energies", "published", "smaller best"],
)
def test_options(tmp_path, capsys, arguments, shape):
    assert run(GEM, "-o", tmp_path / "f.npz", "--json", *arguments) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["shape"] == list(shape)
    assert summary["described"] == 1
    assert summary["failed"] == []
    with np.load(tmp_path / "f.npz") as file:
        assert file["features"].shape == (1, shape[0] * shape[1])


def test_a_file_that_fails_does_not_stop_the_others(tmp_path, capsys):
    missing = tmp_path / "none.off"
    assert run(BROKEN, GEM, missing, "-o", tmp_path / "f.npz", "--json") == 1
    out, err = capsys.readouterr()
    assert [Path(failure["path"]).name for failure in json.loads(out)["failed"]] == [BROKEN.name, "none.off"]
    lines = err.splitlines()
    assert len(lines) == 2
    assert str(BROKEN) in lines[0]
    assert str(missing) in lines[1]
    assert "No such file" in lines[1]
    assert read_arrays(tmp_path / "f.npz")[1]["paths"].tolist() == [str(GEM)]


def test_a_shape_without_area_is_named_with_its_reason(tmp_path, capsys):
    flat = tmp_path / "line.off"
    flat.write_text("OFF\n3 1 0\n0 0 0\n1 1 1\n2 2 2\n3 0 1 2\n")
    assert run(flat, "-o", tmp_path / "f.npz") == 2
    err = capsys.readouterr().err
    assert str(flat) in err
    assert "no area" in err
    assert [path.name for path in tmp_path.iterdir()] == ["line.off"]


def test_same_input_same_bytes(tmp_path):
    for name in ("a.npz", "b.npz"):
        assert run(GEM, HORN, "-o", tmp_path / name) == 0
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "features.txt"], "must end in .npz"),
        (["-o", "nowhere/f.npz"], "there is no folder"),
        (["-o", "f.npz", "--bandwidth", "0"], "--bandwidth must be"),
        (["-o", "f.npz", "--shells", "-3"], "shells must be"),
        (["-o", "f.npz", "--shells", "15"], "bands must divide"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_usage_is_refused_before_the_work(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        run(GEM, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_an_input_is_not_overwritten(tmp_path):
    source = tmp_path / "shape.npz"
    source.write_bytes(b"precious")
    with pytest.raises(ValueError, match="the output and input 1 are the same file"):
        run(source, "-o", source)
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(ValueError, match="is a folder"):
        run(GEM, "-o", tmp_path / "folder.npz")


def test_a_folder_is_all_that_is_below_it(tmp_path, capsys):
    (tmp_path / "parts" / "deep").mkdir(parents=True)
    for source, name in ((GEM, "gem.stl"), (HORN, "deep/horn.off"), (BROKEN, "deep/broken.off")):
        (tmp_path / "parts" / name).write_bytes(source.read_bytes())
    (tmp_path / "parts" / "notes.txt").write_text("no shape")
    target = tmp_path / "f.npz"
    assert run(tmp_path / "parts", HORN, "-o", target, "--json", "--workers", "2") == 1
    out, err = capsys.readouterr()
    assert [Path(path).name for path in read_arrays(target)[1]["paths"]] == ["gem.stl", "horn.off", "horn.off"]
    assert [Path(one["path"]).name for one in json.loads(out)["failed"]] == ["broken.off"]
    assert ".txt 1" in err
    (tmp_path / "empty").mkdir()
    assert run(tmp_path / "empty", "-o", target) == 2
    assert "no meshes or point clouds in this folder" in capsys.readouterr().err
