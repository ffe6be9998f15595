"""``fsh3d reconstruct --method conformal``: results, levels, repair, and what is refused."""

from __future__ import annotations

import functools
import json

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main
from fsh3d_o3d.closing.prepare_closed import prepare_closed
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.measures import measure_mesh
from tests.cli.test_commands import SAMPLES, refused
from tests.geometry import mesh_shapes as shapes

HORN = SAMPLES / "horn.off"


def conformal(source, target, *options):
    return main(["reconstruct", str(source), str(target), "--method", "conformal", *map(str, options)])


def test_a_horn_comes_back_with_everything_asked_for(tmp_path, capsys):
    outputs = {"--save": "c.npz", "--picture": "p.png", "--report": "r.html"}
    asked = [part for name, file in outputs.items() for part in (name, tmp_path / file)]
    assert conformal(HORN, tmp_path / "o.ply", "--bandwidth", 20, "--levels", "8,4", "--json", *asked) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["method"] == "conformal"
    assert figures["closed"]
    assert figures["genus"] == 0
    assert figures["flipped"] == 0
    assert figures["distortion_mean"] >= 1
    assert figures["coefficients"] == 3 * 400
    assert figures["rmse"] < 0.005
    assert figures["mae"] <= figures["rmse"] <= figures["max"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "c.npz",
        "o.b4.ply",
        "o.b8.ply",
        "o.ply",
        "p.png",
        "r.html",
    ]
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "horn.off" in page
    assert "conformal" in page
    shape = fsh.load_shape(tmp_path / "c.npz")
    assert isinstance(shape, fsh.ConformalShape)
    for bandwidth, mesh in shape.level_of_detail([4, 8]).items():
        level = read_geometry_arrays(tmp_path / f"o.b{bandwidth}.ply")
        np.testing.assert_array_equal(level.vertices, np.asarray(mesh.vertices))
        assert measure_mesh(level).genus == 0


@pytest.fixture
def small(tmp_path):
    """A long ellipsoid, in a folder of its own."""
    path = tmp_path / "in" / "ellipsoid.ply"
    path.parent.mkdir()
    write_geometry(path, shapes.ellipsoid((1, 1, 4), 6))
    return path


def test_it_says_what_it_wrote(tmp_path, capsys, small):
    assert (
        conformal(small, tmp_path / "o.obj", "--bandwidth", 6, "--levels", "3", "--area-weight", 0, "--smooth", 0.01)
        == 0
    )
    out = capsys.readouterr().out
    assert "conformal, 108 coefficients" in out
    assert str(tmp_path / "o.b3.obj") in out


def test_more_weight_on_areas_distorts_angles_more(tmp_path, capsys, small):
    distortion = []
    for weight in (0, 1):
        assert conformal(small, tmp_path / "o.ply", "--bandwidth", 6, "--area-weight", weight, "--json") == 0
        figures = json.loads(capsys.readouterr().out)
        distortion.append((figures["distortion_mean"], -figures["area_distortion"]))
    assert distortion[0] < distortion[1]
    assert distortion[0][1] < distortion[1][1]


TORUS = shapes.torus(n=20, m=10)
CLIPPED = shapes.without(shapes.sphere(4), np.arange(320) < 3)


@pytest.mark.parametrize(
    ("mesh", "problem"),
    [
        (TORUS, "genus 1"),
        (CLIPPED, "open"),
        (shapes.joined(shapes.box(), shapes.moved(shapes.box(), offset=(3, 0, 0))), "2 components"),
        (shapes.mobius(), "one-sided"),
    ],
    ids=["torus", "hole", "two boxes", "Möbius"],
)
def test_what_cannot_be_mapped_is_named(tmp_path, capsys, mesh, problem):
    source, target = tmp_path / "in.ply", tmp_path / "out.ply"
    write_geometry(source, mesh)
    message = refused(capsys, "reconstruct", source, target, "--method", "conformal", "--bandwidth", 8)
    assert problem in message
    assert "--repair" in message
    assert not target.exists()
    assert main(["info", str(source), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert not facts["maps_to_the_sphere"]
    if mesh is CLIPPED:
        assert facts["method"] == "radial"  # a small hole is filled
    assert mesh is CLIPPED or problem in facts["reason"]


@pytest.mark.parametrize(("mesh", "way"), [(TORUS, "carved"), (CLIPPED, "repaired")], ids=["carved", "repaired"])
def test_repair_helps_and_says_what_changed(tmp_path, capsys, monkeypatch, mesh, way):
    coarse = functools.partial(prepare_closed, cells_per_side=16)  # for speed
    monkeypatch.setattr("fsh3d_o3d.cli.methods.prepare_closed", coarse)
    source, target = tmp_path / "in.ply", tmp_path / "out.ply"
    write_geometry(source, mesh)
    assert conformal(source, target, "--bandwidth", 8, "--repair", "--json") == 0
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert figures["genus"] == 0
    assert figures["repair"] == way
    assert figures["repair_rms"] <= figures["repair_max"]
    assert err.count("\n") == 1
    assert err.startswith(way)
    assert "% of the diagonal" in err


def test_repair_of_a_good_mesh_changes_nothing(tmp_path, capsys, small):
    plain, repaired = tmp_path / "plain.ply", tmp_path / "repaired.ply"
    assert conformal(small, plain, "--bandwidth", 6) == 0
    capsys.readouterr()
    assert conformal(small, repaired, "--bandwidth", 6, "--repair") == 0
    assert "nothing to change" in capsys.readouterr().err
    assert plain.read_bytes() == repaired.read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--center", "0,0,0"], "--center goes with --method radial or shells"),
        (["--behaviour", "outermost"], "--behaviour goes with --method radial"),
        (["--shells", "8"], "--shells goes with --method shells"),
        (["--levels", "4,32", "--bandwidth", "16"], "--levels must not exceed the bandwidth 16, got 32"),
        (["--area-weight", "-1"], "area_weight must be"),
        (["--area-weight", "nan"], "area_weight must be"),
        (["--bandwidth", "4000"], "GiB"),
        (["--resolution", "3"], "resolution must be"),
        (["--method", "radial", "--levels", "4"], "--levels goes with --method conformal"),
        (["--method", "shells", "--area-weight", "1"], "--area-weight goes with --method conformal"),
    ],
    ids=" ".join,
)
def test_bad_options_are_refused(tmp_path, capsys, options, message):
    assert message in refused(capsys, "reconstruct", HORN, tmp_path / "x.ply", "--method", "conformal", *options)
    assert list(tmp_path.iterdir()) == []


def test_levels_are_checked_before_the_work(tmp_path, capsys):
    (tmp_path / "x.b4.ply").mkdir()
    arguments = ("reconstruct", HORN, tmp_path / "x.ply", "--method", "conformal", "--levels", "4")
    assert "is a folder" in refused(capsys, *arguments)
    source = tmp_path / "in.b4.ply"
    write_geometry(source, shapes.box())
    assert "same file" in refused(
        capsys, "reconstruct", source, tmp_path / "in.ply", "--method", "conformal", "--levels", "4"
    )
    for levels in ("", "4,x", "0", "4,,8"):
        assert conformal(HORN, tmp_path / "y.ply", "--levels", levels) == 2
        assert "is not a list of bandwidths" in capsys.readouterr().err


def test_a_cloud_is_refused(tmp_path, capsys):
    arguments = ("reconstruct", SAMPLES / "bennu_cloud.ply", tmp_path / "x.ply", "--method", "conformal")
    assert "takes a mesh" in refused(capsys, *arguments)
    assert "takes a mesh" in refused(capsys, *arguments, "--repair")
