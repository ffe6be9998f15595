"""Every script under pipelines/ runs on a small input."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PIPELINES = Path(__file__).parents[1] / "pipelines"


def test_demo(tmp_path):
    done = subprocess.run(
        [sys.executable, str(PIPELINES / "demo.py"), "--output", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert {"bennu_like.ply", "bennu_like.html", "bennu_like.png", "bennu_cloud.npz"} <= {
        p.name for p in tmp_path.iterdir()
    }
    assert "RMSE" in done.stdout
    assert "trefoil_knot.ply" in done.stdout
    assert "Distances between features" in done.stdout


def test_every_script_is_tested_here():
    tested = Path(__file__).read_text(encoding="utf-8")
    for script in PIPELINES.rglob("*.py"):
        assert f'"{script.name}"' in tested, f"{script} is run by no test"
