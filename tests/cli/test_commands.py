"""The command as a user runs it: results, figures, exit codes, one-line messages, nothing half-written."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry import PointArrays, open3d_point_cloud
from fsh3d_o3d.geometry.measures import measure_mesh

SAMPLES = Path(__file__).parents[2] / "samples"


def refused(capsys, *arguments):
    """Run a command that must be refused; returns its one-line message."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    assert "internal error" not in err
    return err


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_reconstruct_writes_a_closed_mesh(tmp_path, capsys, suffix):
    target = tmp_path / f"out{suffix}"
    assert main(["reconstruct", str(SAMPLES / "stone_degree8.ply"), str(target), "--bandwidth", "16", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert {
        "method",
        "bandwidth",
        "rmse",
        "mae",
        "max",
        "volume_error",
        "diagonal",
        "closed",
        "genus",
    } <= figures.keys()
    assert figures["method"] == "radial"
    assert figures["bandwidth"] == 16
    assert figures["rmse"] < 1e-3  # degree 8 in bandwidth 16: what is left are the facets of both meshes
    assert figures["mae"] <= figures["rmse"] <= figures["max"]
    assert figures["volume_error"] < 1e-3
    written = measure_mesh(read_geometry_arrays(target))
    assert written.closed
    assert written.genus == 0
    assert written.outward
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


def test_reconstruct_says_what_it_did(tmp_path, capsys):
    assert main(["reconstruct", str(SAMPLES / "gem.stl"), str(tmp_path / "gem.ply"), "--bandwidth", "16"]) == 0
    out = capsys.readouterr().out
    assert "256 coefficients" in out
    assert "radial: star-shaped" in out
    assert "RMSE" in out
    assert str(tmp_path / "gem.ply") in out


def test_reconstruct_of_a_cloud_with_noise_outliers_and_a_hole(tmp_path, capsys):
    arguments = ["reconstruct", str(SAMPLES / "bennu_cloud.ply"), str(tmp_path / "cloud.ply"), "--bandwidth", "24"]
    assert main([*arguments, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["closed"]
    truth = read_geometry_arrays(SAMPLES / "bennu_like.ply")
    from fsh3d_o3d.geometry.surface_comparison import surface_error

    error = surface_error(truth, read_geometry_arrays(tmp_path / "cloud.ply")).relative()
    # Boulders beyond degree 24 and the filled hole; the cloud's own noise is 0.3 % of the diagonal.
    assert error.rmse < 0.01


def test_all_outputs_at_once(tmp_path, capsys):
    names = {"--save": "c.npz", "--picture": "p.png", "--report": "r.html"}
    options = [text for name, file in names.items() for text in (name, str(tmp_path / file))]
    source = str(SAMPLES / "gem.stl")
    assert (
        main(["reconstruct", source, str(tmp_path / "o.ply"), "--bandwidth", "16", "--smooth", "0.01", *options]) == 0
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.npz", "o.ply", "p.png", "r.html"]
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "gem.stl" in page
    with np.load(tmp_path / "c.npz") as file:
        assert file["coefficients"].shape == (256,)


def test_same_input_same_bytes(tmp_path):
    for name, threads in (("a", "1"), ("b", "2")):
        arguments = [str(SAMPLES / "gem.stl"), str(tmp_path / f"{name}.ply"), "--save", str(tmp_path / f"{name}.npz")]
        assert main(["reconstruct", *arguments, "--bandwidth", "20", "--threads", threads]) == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("gem.stl", {"star_shaped": True, "closed": True, "genus": 0, "method": "radial"}),
        ("horn.off", {"star_shaped": False, "closed": True, "genus": 0, "method": "conformal"}),
        ("double_torus.off", {"star_shaped": False, "closed": True, "genus": 2, "method": "shells"}),
        ("bowl.off", {"closed": False, "method": "conformal"}),  # 0.07 % closed first, 4.4 % by shells
        ("bennu_cloud.ply", {"kind": "point cloud", "method": "radial"}),
    ],
)
def test_info(capsys, name, expected):
    assert main(["info", str(SAMPLES / name), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert {key: facts[key] for key in expected} == expected
    assert facts["reason"]
    assert main(["info", str(SAMPLES / name)]) == 0
    assert "method" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "genus"), [("double_torus.off", 2), ("horn.off", 0)])
def test_shells_reconstruct_any_topology(tmp_path, capsys, name, genus):
    arguments = ["reconstruct", str(SAMPLES / name), str(tmp_path / "x.ply"), "--method", "shells", "--bandwidth", "24"]
    assert main([*arguments, "--resolution", "80", "--save", str(tmp_path / "x.npz"), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["closed"]
    assert figures["genus"] == genus
    assert figures["rmse"] < 0.005
    assert fsh.load_shape(tmp_path / "x.npz").radii.shape == (48,)


def test_the_method_is_chosen_and_what_became_of_the_original_is_said(tmp_path, capsys):
    arguments = ["reconstruct", str(SAMPLES / "bowl.off"), str(tmp_path / "x.ply"), "--bandwidth", "16"]
    assert main([*arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert (figures["method"], figures["way"], figures["closed"]) == ("conformal", "conformal, carved", True)
    assert figures["rmse"] < 0.01
    assert figures["warnings"]
    assert "is open and has become closed" in err
    assert main(arguments) == 0
    assert "closed first" in capsys.readouterr().out


def test_a_scan_of_one_side_is_written_as_an_open_surface(tmp_path, capsys):
    directions = fsh.fibonacci_grid(3000).directions
    scan = open3d_point_cloud(PointArrays(directions[directions[:, 0] < 0]))
    fsh.write_geometry(tmp_path / "scan.ply", scan)
    assert "fsh.reconstruct" in refused(
        capsys, "reconstruct", tmp_path / "scan.ply", tmp_path / "x.ply", "--method", "radial", "--bandwidth", "8"
    )
    arguments = ["reconstruct", str(tmp_path / "scan.ply"), str(tmp_path / "x.ply"), "--bandwidth", "12", "--json"]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["unseen"] > 0.2
    assert "was not seen" in err
    assert not measure_mesh(read_geometry_arrays(tmp_path / "x.ply")).closed


def test_repair_says_what_it_changed(tmp_path, capsys):
    arguments = ["reconstruct", str(SAMPLES / "bowl.off"), str(tmp_path / "x.ply"), "--method", "shells", "--repair"]
    assert main([*arguments, "--bandwidth", "8", "--resolution", "32", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["closed"]
    assert "not closed to closed" in err
    cloud = ("reconstruct", SAMPLES / "bennu_cloud.ply", tmp_path / "y.ply", "--method", "radial", "--repair")
    assert "takes a mesh" in refused(capsys, *cloud)


def test_options_of_the_other_method_are_refused(tmp_path, capsys):
    gem = SAMPLES / "gem.stl"
    assert "--shells goes with" in refused(capsys, "reconstruct", gem, tmp_path / "x.ply", "--shells", "9")
    arguments = ("reconstruct", gem, tmp_path / "x.ply", "--method", "shells", "--center", "best")
    assert "--center must be X,Y,Z" in refused(capsys, *arguments)


def test_not_star_shaped_says_how_far_and_what_fits(tmp_path, capsys):
    message = refused(capsys, "reconstruct", SAMPLES / "horn.off", tmp_path / "x.ply", "--method", "radial")
    assert "not star-shaped" in message
    assert "conformal" in message
    assert "shells" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", sorted((SAMPLES / "broken").iterdir()), ids=lambda path: path.name)
def test_broken_samples_are_refused_in_one_line(tmp_path, capsys, path):
    message = refused(capsys, "reconstruct", path, tmp_path / "x.ply", "--bandwidth", "8")
    assert path.name in message
    refused(capsys, "info", path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bandwidth", "0"], "--bandwidth must be between 1 and"),
        (["--bandwidth", "-4"], "--bandwidth must be between 1 and"),
        (["--bandwidth", "99999"], "--bandwidth must be between 1 and"),
        (["--bandwidth", "4000"], "GiB"),
        (["--smooth", "-1"], "time must be"),
        (["--smooth", "nan"], "time must be"),
        (["--method", "radial", "--center", "sideways"], "center must be one of"),
        (["--method", "radial", "--resolution", "3"], "resolution must be"),
        (["--method", "radial", "--resolution", "99999999"], "GiB"),
        (["--resolution", "1000"], "--resolution goes with --method radial or shells or conformal"),
        (["--repair"], "--repair goes with --method radial or shells or conformal"),
        (["--method", "radial", "--parts", "largest"], "--parts goes with --method auto or with --repair"),
        (["--threads", "0"], "threads must be"),
        (["--save", "coefficients.txt"], "--save must end in .npz"),
        (["--report", "/nowhere/page.html"], "there is no folder"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_options_are_refused(tmp_path, capsys, arguments, message):
    assert message in refused(capsys, "reconstruct", SAMPLES / "gem.stl", tmp_path / "x.ply", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_bad_outputs_are_refused_before_the_work(tmp_path, capsys):
    gem = SAMPLES / "gem.stl"
    assert "output must end in" in refused(capsys, "reconstruct", gem, tmp_path / "x.png")
    assert "there is no folder" in refused(capsys, "reconstruct", gem, tmp_path / "none" / "x.ply")
    (tmp_path / "folder.ply").mkdir()
    assert "is a folder" in refused(capsys, "reconstruct", gem, tmp_path / "folder.ply")
    assert "same file" in refused(capsys, "reconstruct", gem, gem)
    assert "No such file" in refused(capsys, "reconstruct", tmp_path / "none.ply", tmp_path / "x.ply")


@pytest.mark.parametrize(
    "arguments", [[], ["nonsense"], ["reconstruct"], ["reconstruct", "a", "b", "--center", "1,2"], ["info"]]
)
def test_bad_usage_is_exit_code_2(capsys, arguments):
    assert main(arguments) == 2
    assert "usage:" in capsys.readouterr().err


def test_help_and_version(capsys):
    assert main(["--help"]) == 0
    assert "reconstruct" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert "fsh3d_o3d" in capsys.readouterr().out


def test_cache_is_shown_and_cleared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FSH3D_CACHE_DIR", str(tmp_path))
    arguments = ["reconstruct", str(SAMPLES / "gem.stl"), str(tmp_path / "g.ply"), "--bandwidth", "7", "--quiet"]
    from fsh3d_o3d.sphere.weight_cache import clear_weight_cache

    clear_weight_cache()
    assert main(arguments) == 0
    capsys.readouterr()
    assert main(["cache"]) == 0
    assert "0 files" not in capsys.readouterr().out
    assert main(["cache", "--clear"]) == 0
    assert "removed" in capsys.readouterr().out
    assert main(["cache"]) == 0
    assert "0 files" in capsys.readouterr().out


def test_interrupt_is_reported_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("fsh3d_o3d.reconstruction.attempts.surface_error", interrupted)
    assert main(["reconstruct", str(SAMPLES / "gem.stl"), str(tmp_path / "x.ply"), "--bandwidth", "8"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_installed_command_starts_without_open3d():
    code = "import sys; from fsh3d_o3d.cli import main; main(['--help']); sys.exit('open3d' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0
