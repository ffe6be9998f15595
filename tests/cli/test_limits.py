"""Values and surroundings beyond what the system can do: one sentence, before any work."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.index.shape_index import ShapeIndex
from fsh3d_o3d.jobs.descriptor_cache import descriptor_cache_path
from fsh3d_o3d.jobs.extraction import extract_descriptors
from tests.index.index_cases import QUICK
from tests.jobs.toys import ToyDescriptor

ROOT = Path(__file__).parents[2]
GEM = ROOT / "samples" / "gem.stl"


def test_the_longest_time_and_the_most_memory_that_are_taken():
    """More milliseconds than an int of C holds, and nearly all the address space there is."""
    assert len(read_geometry_arrays(GEM, timeout=1e7, memory_limit=2**60).triangles) > 0


@pytest.mark.parametrize("timeout", [2e7, 1e300, float("inf"), float("nan"), -1])
def test_times_that_are_refused(tmp_path, timeout):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    for ask in (
        lambda: read_geometry_arrays(GEM, timeout=timeout),
        lambda: extract_descriptors([GEM], ToyDescriptor(), timeout=timeout),
        lambda: index.add_files([GEM], timeout=timeout),
    ):
        with pytest.raises(ValueError, match="timeout must be"):
            ask()


@pytest.mark.parametrize("limit", [2**61, 2**63, 10**400])
def test_memory_that_is_refused(tmp_path, limit):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    for ask in (
        lambda: read_geometry_arrays(GEM, memory_limit=limit),
        lambda: index.add_files([GEM], memory_limit=limit),
    ):
        with pytest.raises(ValueError, match="memory_limit must be between"):
            ask()


@pytest.mark.parametrize(
    "arguments",
    [
        ["reconstruct", "GEM", "o.ply", "--threads", 10**12],
        ["reconstruct", "GEM", "o.ply", "--bandwidth", 10**12],
        ["reconstruct", "GEM", "o.ply", "--method", "shells", "--shells", 10**12],
        ["reconstruct", "GEM", "o.ply", "--bandwidth", "4", "--resolution", 10**20],
        ["describe", "GEM", "-o", "f.npz", "--bandwidth", 2**63],
        ["describe", "GEM", "-o", "f.npz", "--shells", 2**63],
        ["index", "LIBRARY", "i", "--workers", 10**12],
        ["index", "LIBRARY", "i", "--timeout", "1e300"],
        ["index", "LIBRARY", "i", "--timeout", "inf"],
        ["query", "INDEX", "GEM", "--top", 2**63],
        ["query", "INDEX", "GEM", "--rerank", 2**63],
        ["evaluate", "--models", "LIBRARY", "--classification", "CLA", "--workers", 10**12],
        ["evaluate", "--models", "LIBRARY", "--classification", "CLA", "--neighbors", 2**63],
        # Outputs.
        ["query", "INDEX", "GEM", "--report", "FOLDER.html"],
        ["query", "INDEX", "GEM", "--report", "FIFO.html"],
        ["describe", "GEM", "-o", "FOLDER.npz"],
        ["reconstruct", "GEM", "o.ply", "--bandwidth", "4", "--report", "FOLDER.html"],
        ["reconstruct", "GEM", "s3://bucket/o.ply"],
        ["align", "GEM", "GEM", "-o", "o.ply", "--picture", "FOLDER.png"],
        ["evaluate", "--models", "LIBRARY", "--classification", "CLA", "--json", "FOLDER.json"],
        ["evaluate", "--models", "LIBRARY", "--classification", "CLA", "--plot", "FOLDER.png"],
        ["evaluate", "--models", "LIBRARY", "--classification", "CLA", "--json", "CLA"],
    ],
    ids=lambda arguments: " ".join(map(str, arguments))[-60:],
)
def test_refused_in_one_sentence(tmp_path, capsys, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    ShapeIndex.open("INDEX", create=True, option=QUICK)
    for name in ("html", "npz", "png", "json"):
        Path(f"FOLDER.{name}").mkdir()
    os.mkfifo("FIFO.html")
    Path("LIBRARY").symlink_to(ROOT / "samples")
    Path("CLA").write_text("PSB 1\n1 1\n\nstone 0 1\ngem\n")
    before = sorted(path.name for path in tmp_path.iterdir())
    assert main([str(GEM) if argument == "GEM" else str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "error: " in err and "Traceback" not in err and "internal" not in err
    assert len([line for line in err.splitlines() if "error: " in line]) == 1
    assert {path.name for path in tmp_path.iterdir()} - {*before, "i"} == set()


def test_homes_that_are_not_there(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("FSH3D_CACHE_DIR", "~nobody-of-this-name/cache")
    for ask in (fsh.weight_cache_directory, descriptor_cache_path):
        with pytest.raises(ValueError, match="no such user"):
            ask()
    assert main(["cache"]) == 2
    assert "FSH3D_CACHE_DIR is" in capsys.readouterr().err
    monkeypatch.delenv("FSH3D_CACHE_DIR")
    monkeypatch.chdir(tmp_path)
    for value in ("~nobody-of-this-name", "relative"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert fsh.weight_cache_directory().is_absolute()
        assert main(["cache"]) == 0
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", lambda number: {}[number])  # as in containers whose user has no name
    assert fsh.weight_cache_directory() == Path(os.devnull) / "weights"
    assert fsh.analytic_weights(fsh.fibonacci_grid(54), 3).converged
    assert main(["cache", "--clear"]) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_working_folder_that_is_gone(tmp_path):
    """Full names do; others are refused with the reason."""
    program = tmp_path / "program.py"
    program.write_text(
        "import os, sys\n"
        "from fsh3d_o3d.cli import main\n"
        "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')\n"
        "root, gem = sys.argv[1:]\n"
        "full = [['info', gem], ['reconstruct', gem, f'{root}/o.ply', '--bandwidth', '4'], ['cache'],\n"
        "    ['describe', gem, '-o', f'{root}/f.npz', '--option', 'energies'],\n"
        "    ['index', f'{root}/library', f'{root}/i', '--option', 'energies', '--workers', '1'],\n"
        "    ['query', f'{root}/i', gem]]\n"
        "codes = [main(command) for command in full]; print(file=sys.stderr)\n"
        "other = [['info', 'a.off'], ['reconstruct', gem, 'o.ply'], ['describe', 'a.off', '-o', f'{root}/g.npz'],\n"
        "    ['align', 'a.off', gem, '-o', f'{root}/o.ply'], ['index', 'l', f'{root}/i'], ['query', 'i', gem]]\n"
        "print(codes, [main(command) for command in other])\n"
    )
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "gem.stl").write_bytes(GEM.read_bytes())
    done = subprocess.run(
        [sys.executable, program, tmp_path, GEM],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    # What needs Open3D says so.
    full, relative = (part.splitlines() for part in done.stderr.split("\n\n"))
    assert all("Open3D needs one" in line for line in full), done.stderr
    codes = re.findall(r"\[.*?\]", done.stdout.splitlines()[-1])
    assert codes == [str([2, 2, 0, 0, 0, 0]), str([2] * 6)], (done.stdout, done.stderr)
    assert len(relative) == 6
    assert all("folder" in line and "internal" not in line for line in relative), relative
