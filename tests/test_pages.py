"""What the README and the pages of docs show works."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main
from tests.optional import skip_without_torch

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "samples"
PAGES = {page.stem: page.read_text("utf-8") for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
CODE = {page: re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) for page, text in PAGES.items()}
COMMANDS = {page: re.findall(r"^ {4}(fsh3d \w+[^#\n]*)", text, flags=re.MULTILINE) for page, text in PAGES.items()}


def is_whole(command: str) -> bool:
    """Whether a command can be typed as it stands: nothing is to be filled in, no object storage is needed."""
    return not re.search(r"\[|s3://|\b[A-Z][A-Z_]+\b", command)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with the samples and the files that the pages name, all of them small."""
    (tmp_path / "samples").symlink_to(SAMPLES)
    for copy, sample in (
        ("parts/bracket.stl", "gem.stl"),
        ("parts/plate.stl", "gem_rotated.stl"),
        ("bracket.stl", "gem.stl"),
        ("psb/models/1.stl", "gem.stl"),
        ("psb/models/2.stl", "gem_rotated.stl"),
        ("psb/models/3.glb", "spiky_star.glb"),
    ):
        (tmp_path / copy).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(SAMPLES / sample, tmp_path / copy)
    (tmp_path / "psb/train.cla").write_text("PSB 1  1 3  solid 0 3  1 2 3", "utf-8")
    fsh.write_geometry(tmp_path / "hand.ply", fsh.read_geometry(SAMPLES / "spiky_star.glb"))
    for copy in ("model.stl", "scan.ply"):  # fits in one pose only
        fsh.write_geometry(tmp_path / copy, fsh.read_geometry(SAMPLES / "horn.off"))
    fsh.RadialShape.from_geometry(fsh.read_geometry(SAMPLES / "gem.stl"), bandwidth=8).save(tmp_path / "shape.npz")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", [page for page in PAGES if CODE[page]])
def test_code_runs(page, folder):
    skip_without_torch(needed=any("import torch" in block for block in CODE[page]))
    given = {"__name__": "__main__", "values": np.ones((2, 6144)), "directions": np.eye(3)}
    names = dict(given)
    for block in CODE[page]:
        exec(block, names)
    assert names.keys() > given.keys() | {"fsh"}  # it ran, and made something


@pytest.mark.parametrize("page", [page for page in PAGES if any(map(is_whole, COMMANDS[page]))])
def test_commands_run(page, folder, capsys):
    for command in filter(is_whole, COMMANDS[page]):
        assert main(shlex.split(command)[1:]) == 0, f"{command}\n{capsys.readouterr().err}"


@pytest.mark.parametrize("page", [page for page in PAGES if COMMANDS[page]])
def test_commands_have_these_options(page, capsys):
    for command in COMMANDS[page]:
        name = command.split()[1]
        assert main([name, "--help"]) == 0
        offered = capsys.readouterr().out
        assert name in offered
        for option in re.findall(r"(?<=[\s\[])--[a-z-]+", command):
            assert re.search(rf"{option}\b", offered), command


@pytest.mark.parametrize("page", sorted(ROOT.glob("*.md")) + sorted((ROOT / "docs").glob("*.md")), ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https://") or (page.parent / target).exists(), target
