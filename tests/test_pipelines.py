"""Every script under pipelines/ runs on a small input."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.scripts import run_script

PIPELINES = Path(__file__).parents[1] / "pipelines"
SAMPLES = Path(__file__).parents[1] / "samples"


def test_demo(tmp_path):
    done = run_script(PIPELINES / "demo.py", "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    assert {"bennu_like.ply", "bennu_like.html", "bennu_like.png", "bennu_cloud.npz"} <= {
        p.name for p in tmp_path.iterdir()
    }
    assert "RMSE" in done.stdout
    assert "trefoil_knot.ply" in done.stdout
    assert "Distances between features" in done.stdout
    assert {"horn_aligned.ply", "horn_aligned.png", "samples.fsh", "hits.html"} <= {p.name for p in tmp_path.iterdir()}


def test_align_scans(tmp_path):
    done = run_script(PIPELINES / "align_scans.py", "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"aligned.ply", "aligned.png"}
    assert "confidence 1.00, ambiguity none, scale 0.00" in done.stdout
    assert "ICP from where they lie           fitness 0.000" in done.stdout
    assert "spherical registration, then ICP  fitness 1.000" in done.stdout


def test_merge_scans(tmp_path):
    small = ("--views", 8, "--pixels", 120, "--bandwidth", 12, "--shells", 24)
    done = run_script(PIPELINES / "merge_scans.py", SAMPLES / "horn.off", *small, "--output", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"merged.ply", "closed.ply", "scans.png", "closed.png"}
    assert "8 of 8 scans placed" in done.stdout
    assert "closed: True" in done.stdout
    # Half the noise along the rays, and what twelve degrees leave out.
    assert float(done.stdout.split("RMSE ")[1].split()[0]) < 1


def test_sphere_map(tmp_path):
    done = run_script(PIPELINES / "sphere_map.py", "--bandwidth", "16", "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"conformal.png", "balanced.png"}
    conformal, balanced = (line.split() for line in done.stdout.splitlines()[1:3])
    # A conformal map shears nothing and starves the fingers; a balanced one is the other way round.
    assert float(conformal[1]) < 1.5 < float(balanced[1])
    assert float(balanced[4]) < 0.2 * float(conformal[4])


def test_reconstruct_library(tmp_path):
    models, table = tmp_path / "models", tmp_path / "out" / "table.csv"
    models.mkdir()
    for name in ("gem.stl", "horn.off"):
        shutil.copy(PIPELINES.parent / "samples" / name, models)
    arguments = (models, "--output", table, "--bandwidth", "16")
    done = run_script(PIPELINES / "reconstruct_library.py", *arguments)
    assert done.returncode == 0, done.stderr
    assert "2 of 2 models reconstructed, 2 closed" in done.stdout
    assert "| radial | 1 |" in done.stdout
    rows = table.read_text()
    (models / "broken.off").write_text("OFF\n3 1 0\n0 0 0\n")
    again = run_script(PIPELINES / "reconstruct_library.py", *arguments)
    assert again.returncode == 1
    assert "2 of 3 models" in again.stdout
    assert "not reconstructed: broken.off" in again.stdout
    assert table.read_text().startswith(rows)  # what was done is not done again


def test_every_script_is_tested_here():
    tests = Path(__file__).parent.rglob("test_*.py")
    tested = "".join(path.read_text(encoding="utf-8") for path in tests)
    for script in PIPELINES.rglob("[!_]*.py"):
        assert f'"{script.name}"' in tested, f"{script} is run by no test"
