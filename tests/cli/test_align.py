"""``fsh3d align``: the source lands on the target, figures are JSON, nothing is half-written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.cli import main
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import area_samples, measure_mesh

SAMPLES = Path(__file__).parents[2] / "samples"
HORN = SAMPLES / "horn.off"
TURN = Rotation.from_euler("xyz", [2.8, 0.4, -1.0]).as_matrix()


@pytest.fixture
def target(tmp_path):
    """The horn turned, doubled and moved."""
    mesh = read_geometry_arrays(HORN)
    path = tmp_path / "target.ply"
    write_geometry(path, MeshArrays(2 * mesh.vertices @ TURN.T + [3, 0, 1], mesh.triangles))
    return path


def run(*arguments) -> int:
    return main(["align", *map(str, arguments)])


def test_source_lands_on_the_target(tmp_path, capsys, target):
    out, matrix, picture = tmp_path / "out.obj", tmp_path / "t.txt", tmp_path / "p.png"
    assert run(HORN, target, "-o", out, "--transformation", matrix, "--picture", picture) == 0
    printed = capsys.readouterr().out
    assert "confidence 1.00" in printed
    for path in (out, matrix, picture):
        assert f"wrote {path}" in printed
    aligned, wanted = read_geometry_arrays(out), read_geometry_arrays(target)
    np.testing.assert_allclose(aligned.vertices, wanted.vertices, atol=1e-5)  # steps of 1e-5 end the iteration
    np.testing.assert_array_equal(aligned.triangles, wanted.triangles)
    read = np.loadtxt(matrix)
    source = read_geometry_arrays(HORN).vertices
    np.testing.assert_allclose(source @ read[:3, :3].T + read[:3, 3], aligned.vertices, atol=1e-14)
    np.testing.assert_array_equal(read[3], [0, 0, 0, 1])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in tmp_path.iterdir()} == {"target.ply", "out.obj", "t.txt", "p.png"}


def test_figures_as_json(tmp_path, capsys, target):
    assert run(HORN, target, "-o", tmp_path / "out.ply", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["scale"] == pytest.approx(2, abs=1e-5)
    assert figures["fitness"] == 1
    assert figures["confidence"] == 1
    assert figures["ambiguity"] == "none"
    assert not figures["reflected"]
    np.testing.assert_allclose(np.array(figures["transformation"])[:3, :3], 2 * TURN, atol=1e-5)
    assert {"transformation", "correlation", "fitness", "inlier_rmse"} == figures["candidates"][0].keys()


def test_options_reach_the_registration(tmp_path, capsys, target):
    out = tmp_path / "out.ply"
    assert run(HORN, target, "-o", out, "--no-scale", "--json") == 1  # without confidence
    figures = json.loads(capsys.readouterr().out)
    assert figures["scale"] == pytest.approx(1, abs=1e-12)
    assert figures["confidence"] < 0.5
    assert run(HORN, target, "-o", out, "--no-polish", "--json") == 0
    assert json.loads(capsys.readouterr().out)["inlier_rmse"] > 1e-4
    mirrored = tmp_path / "mirrored.ply"
    mesh = read_geometry_arrays(HORN)
    write_geometry(mirrored, MeshArrays(mesh.vertices * [-1, 1, 1], mesh.triangles[:, ::-1]))
    assert run(HORN, mirrored, "-o", out, "--reflections", "--json") == 0
    assert json.loads(capsys.readouterr().out)["reflected"]
    assert measure_mesh(read_geometry_arrays(out)).outward


def test_doubt_is_said(tmp_path, capsys):
    out = tmp_path / "out.ply"
    assert run(SAMPLES / "double_torus.off", SAMPLES / "double_torus.off", "-o", out) == 1
    said = capsys.readouterr()
    assert "other poses fit about as well" in said.out
    assert "the confidence is below 0.2" in said.err
    assert out.exists()  # an answer as good as any other
    assert run(HORN, SAMPLES / "starfish_posed.ply", "-o", out) == 1
    assert "the shapes differ" in capsys.readouterr().out


def test_clouds_keep_normals_and_colours(tmp_path):
    out = tmp_path / "out.ply"
    assert (
        run(SAMPLES / "trefoil_cloud.xyzrgb", SAMPLES / "trefoil_knot.ply", "-o", out) == 1
    )  # a knot of three leaves fits in six ways
    colored, given = read_geometry_arrays(out), read_geometry_arrays(SAMPLES / "trefoil_cloud.xyzrgb")
    np.testing.assert_allclose(colored.colors, given.colors, atol=1 / 255)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "out.txt"], "output must end in"),
        (["-o", "out.xyz"], "the source is a mesh"),
        (["-o", "nowhere/out.ply"], "there is no folder"),
        (["-o", "out.ply", "--picture", "p.jpg"], "--picture must end in .png"),
        (["-o", "out.ply", "--transformation", "t.npy"], "--transformation must end in .txt"),
        (["-o", "horn.off"], "output and the source are the same file"),
        (["-o", "gem.stl"], "output and the target are the same file"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_usage_is_refused(tmp_path, monkeypatch, capsys, arguments, message):
    for name in ("horn.off", "gem.stl"):
        (tmp_path / name).write_bytes((SAMPLES / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    assert run("horn.off", "gem.stl", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert len(err.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"horn.off", "gem.stl"}


def test_bad_files_are_named(tmp_path, capsys):
    broken = SAMPLES / "broken" / "truncated.ply"
    for pair in ((broken, HORN), (HORN, broken), (HORN, tmp_path / "none.ply")):
        assert run(*pair, "-o", tmp_path / "out.ply") == 2
        err = capsys.readouterr().err
        assert str(pair[0] if pair[0] != HORN else pair[1]) in err
    assert list(tmp_path.iterdir()) == []


def test_a_part_says_how_much_is_shared(tmp_path, capsys):
    whole = read_geometry_arrays(HORN)
    cloud = PointArrays(area_samples(whole, 8000)[0])
    half = tmp_path / "half.ply"
    write_geometry(half, PointArrays(cloud.points[cloud.points[:, 0] > np.median(cloud.points[:, 0])]))
    assert run(half, HORN, "-o", tmp_path / "out.ply", "--no-scale") == 0
    assert "% of the source lies on the target" in capsys.readouterr().out
    assert run(half, HORN, "-o", tmp_path / "out.ply", "--no-scale", "--json") == 0
    on_target, on_source = json.loads(capsys.readouterr().out)["overlap"]
    assert on_target > 0.9 > 0.6 > on_source
