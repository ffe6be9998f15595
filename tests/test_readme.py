"""What the README shows works."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.cli import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("number", range(len(re.findall(r"```python\n", README))))
def test_code_runs(number, tmp_path, monkeypatch):
    code = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)[number]
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    monkeypatch.chdir(tmp_path)
    import fsh3d_o3d as fsh

    directions = np.eye(3)
    names = {"fsh": fsh, "values": np.ones((2, 6144)), "directions": directions}
    names |= {"mesh": fsh.read_geometry("samples/gem.stl"), "knot": fsh.read_geometry("samples/trefoil_knot.ply")}
    exec(code, names)


def test_commands_exist(capsys):
    for name in set(re.findall(r"^    fsh3d (\w+)", README, flags=re.MULTILINE)):
        assert main([name, "--help"]) == 0
        assert name in capsys.readouterr().out


@pytest.mark.parametrize("page", sorted(ROOT.glob("*.md")) + sorted((ROOT / "docs").glob("*.md")), ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https://") or (page.parent / target).exists(), target
