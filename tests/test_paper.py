"""The scripts that repeat the paper: each runs on a small input, and what they measure with is held to known truths."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.surface_comparison import surface_error
from fsh3d_o3d.sphere.icosahedron import icosphere
from tests.scripts import run_script

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "pipelines" / "paper"


@pytest.fixture
def script(monkeypatch):
    """Import a script as a module."""
    monkeypatch.syspath_prepend(PAPER)

    def load(name):
        for known in ("_common", name):
            monkeypatch.delitem(sys.modules, known, raising=False)
        return importlib.import_module(name)

    return load


def ran(folder, name, *arguments):
    """Run a script; return what it printed, its JSON and the names of its pictures."""
    done = run_script(PAPER / name, "--output", folder, *arguments, timeout=600)
    assert done.returncode == 0, done.stderr
    results = json.loads(next(folder.glob("*.json")).read_text(encoding="utf-8"))
    return done.stdout, results, {path.name for path in folder.glob("*.png")}


def test_grids(tmp_path):
    _, results, pictures = ran(tmp_path, "grids.py")
    assert pictures == {"fig3_grids.png"}
    assert set(results) == {"equiangular", "fibonacci", "healpix", "icosahedral", "cube"}
    assert results["equiangular"]["points"] == 4 * 16**2
    for evenness in results.values():
        # No lattice is denser than the hexagonal one; the sphere's curvature changes its distances by 1/n.
        assert evenness["minimum_distance"] < 1.01
        assert evenness["covering_radius"] > 0.99
    # The paper's argument: points crowd at the poles of the equiangular grid.
    assert results["fibonacci"]["area_deviation"] < results["equiangular"]["area_deviation"] / 20


def test_weights(tmp_path):
    _, results, pictures = ran(tmp_path, "weights.py")
    assert pictures == {"fig5_weights.png"}
    for figures in results.values():
        # 2b conditions for 2b rings have one solution; 1e-12 leaves room for the condition of the Legendre matrix.
        assert figures["one_weight_a_ring_minus_driscoll_healy"] < 1e-12
        assert figures["minimum_norm_on_equiangular_minus_driscoll_healy"] > 0.1
        assert figures["residual_analytic_6b2"] < 1e-12  # sums of 6144 terms
        assert figures["residual_area"] > 1e-4
    assert results["b=32"]["residual_analytic_4b2"] > 1e-10


def test_unit_sphere(tmp_path):
    _, results, pictures = ran(tmp_path, "unit_sphere.py")
    assert pictures == {"fig6_fig7_unit_sphere.png"}
    for count in ("n=4300", "n=4624", "n=6144"):
        found = results[count]
        assert found["analytic"]["error_max"] < 1e-11  # sums over the points and 1024 coefficients
        assert found["equal"]["error_rms"] > found["area"]["error_rms"] > 1e-4  # as in the paper's Fig. 6


def test_round_trip(tmp_path):
    _, results, pictures = ran(tmp_path, "round_trip.py")
    assert pictures == {"fig8_round_trip.png"}
    error = {name: figures["relative_rms"] for name, figures in results.items()}
    for exact in ("equiangular, 4096, Driscoll-Healy", "fibonacci, 4624, analytic", "fibonacci, 6144, analytic"):
        assert error[exact] < 1e-13  # rounding of sums of thousands of terms
    for inexact in ("healpix, 4800, equal", "icosahedral, 5762, equal"):
        assert error[inexact] > 1e-4


@pytest.mark.parametrize("sampled", ["rays", "clouds"])
def test_star_shapes(tmp_path, sampled):
    for name in ("gem.stl", "bennu_like_low.ply", "trefoil_knot.ply"):
        shutil.copy(ROOT / "samples" / name, tmp_path)
    options = ["--shapes", str(tmp_path), "--degrees", "8", "--workers", "1"]
    text, results, pictures = ran(tmp_path / "out", "star_shapes.py", *options, *(["--clouds"] * (sampled == "clouds")))
    suffix = "_clouds" if sampled == "clouds" else ""
    assert pictures == {f"table1{suffix}.png", f"fig9_deviation{suffix}.png"}
    assert results["shapes"] == ["bennu_like_low", "gem"]  # a knot is no star
    assert results["sampled"] == sampled
    assert "2 of 3 meshes are star-shaped" in text
    for metric in ("RMSE", "MAE", "VE"):
        cell = results["table_1"][metric]["ESH 4b² over SFG 6b²"]
        low, high = cell["interval"]
        assert low <= cell["ratio"] <= high
        assert results["table_2"]["SFG 6b² b=8"][metric]["mean"] > 0


def test_retrieval(tmp_path):
    text, results, pictures = ran(tmp_path, "retrieval.py", "--cpshd", "--cells", "16", "--workers", "1")
    assert pictures == {"fig11_precision_recall.png"}
    for method in ("SHD-ESH", "SHD-FSH3D", "CPSHD-ESH", "CPSHD-FSH3D", "CPSHD, balanced map-FSH3D"):
        assert results[method]["models"] == 9
        assert 0 < results[method]["micro"]["first_tier"] <= 1
    assert 0 < results["SHD: FSH3D over ESH"]["first_tier"]["chance"] <= 1
    assert "CPSHD, FSH3D over ESH" in text


def test_retrieval_wants_models_and_classification_together(tmp_path):
    done = run_script(PAPER / "retrieval.py", "--models", tmp_path)
    assert done.returncode == 2
    assert "give both --models and --classification" in done.stderr


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("retrieval.py", ("--models", ".", "--classification", "nowhere.cla"), "nowhere.cla"),
        ("retrieval.py", ("--models", ".", "--classification", "odd.cla"), "odd.cla: line 1"),
        ("star_shapes.py", ("--shapes", ".", "--workers", "1"), "no star-shaped mesh"),
        ("grids.py", ("--output", "odd.cla"), "odd.cla"),
    ],
)
def test_bad_input_is_one_line(tmp_path, name, arguments, said):
    """No file, no classification, no mesh, and a file where the folder for results should be."""
    (tmp_path / "odd.cla").write_text("not a classification\n", encoding="ascii")
    done = run_script(PAPER / name, *arguments, folder=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{name}: ")
    assert said in line


@pytest.mark.parametrize("method", ["ESH 4b²", "SFG 4b²", "SFG 4b², fit", "SFG 6b²"])
def test_a_pose_that_the_grid_shares_changes_no_error(script, method):
    """A half turn maps each grid to itself, so that any difference between the poses would be the measurement's."""
    star_shapes = script("star_shapes")
    points, triangles = icosphere(12)
    body = star_shapes.Subject(
        MeshArrays(points * (1 + 0.3 * points[:, :1] ** 3 + 0.2 * points[:, 1:2]), triangles),
        np.zeros(3),
        500,
        clouds=False,
    )
    turn = np.diag((-1.0, -1.0, 1.0)) if method.startswith("ESH") else np.diag((1.0, -1.0, -1.0))
    upright, turned = (body.coefficients(method, 12, rotation) for rotation in (np.eye(3), turn))
    # Rays choose their triangle in float32; at an edge, either gives the same distance to 1e-7.
    np.testing.assert_allclose(turned, upright, atol=1e-6)
    np.testing.assert_allclose(body.errors(turned), body.errors(upright), rtol=1e-3, atol=1e-7)
    other = body.coefficients(method, 12, Rotation.from_euler("y", 40, degrees=True).as_matrix())
    assert np.abs(other - upright).max() > 1e-6  # a pose that it does not share


def test_errors_are_those_of_surface_error(script):
    star_shapes = script("star_shapes")
    points, triangles = icosphere(12)
    body = star_shapes.Subject(MeshArrays(points * (1.0, 0.7, 0.8), triangles), np.zeros(3), 20_000, clouds=False)
    coefficients = body.coefficients("SFG 6b²", 6, np.eye(3))
    rmse, mae, volume = body.errors(coefficients)
    measured = surface_error(body.mesh, star_shapes.decoded(coefficients), samples=20_000)
    # Two samplings of the same integrals, of 20,000 points each.
    np.testing.assert_allclose((rmse, mae), (measured.rmse, measured.mae), rtol=0.02)
    # The decoded mesh has 10,000 chords, the exact volume none: 4e-4 of it.
    np.testing.assert_allclose(volume, measured.volume_error, atol=1e-3)


def test_average_precision_and_first_tier(script):
    """Three relatives of four, found at ranks 1, 3 and 4."""
    retrieval = script("retrieval")
    distances = np.array([[0.0, 1, 2, 3, 4]])
    labels = np.array(["a", "a", "b", "a", "a"])
    precision, tier = retrieval.per_query(distances, labels, np.array([True]))
    np.testing.assert_allclose(precision, [(1 + 2 / 3 + 3 / 4) / 3], rtol=1e-15)
    np.testing.assert_allclose(tier, [2 / 3], rtol=1e-15)


def test_chance(script):
    retrieval = script("retrieval")
    same = np.linspace(0, 1, 20)
    assert retrieval.chance(same, same, 0) == 1
    # Of 2^10 assignments of signs, two are as far from zero as ten equal differences; within sampling of 10,000 draws.
    assert 0.0005 < retrieval.chance(np.zeros(10), np.ones(10), 0) < 0.005
    assert retrieval.chance(np.zeros(30), np.ones(30), 0) < 0.001
