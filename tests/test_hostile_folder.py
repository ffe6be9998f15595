"""Working in a folder of files from elsewhere runs none of the modules that lie among them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fsh3d_o3d import _imports
from tests.jobs.mesh_files import write_box

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "samples"
NAMES = (
    "numpy",
    "resource",
    "json",
    "open3d",
    "PIL",
    "lancedb",
    "pyarrow",
    "skimage",
    "DracoPy",
    "jinja2",
    "markupsafe",
    "pickle",
    "multiprocessing",
    "ray",
)
# Imports the package where Python looks for it, and only then works in the library, as a notebook does.
PROGRAM = """
import os, sys
start, before = os.getcwd(), list(sys.path)
sys.path[:] = [entry for entry in before if entry and os.path.realpath(entry) != start]
from fsh3d_o3d import evaluation
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.jobs import extract_descriptors
from tests.jobs.toys import ToyDescriptor
sys.path[:] = before
if __name__ == "__main__":
    assert len(read_geometry_arrays("box.off").vertices) == 8
    for name in ("pyarrow.fs", "lancedb", "skimage.measure", "plotly.offline", "jinja2", "DracoPy"):
        import_installed(name)
    assert len(extract_descriptors(["box.off"], ToyDescriptor(), workers=1, cache=False).indices) == 1
    assert evaluation.precision_recall_png(evaluation.RECALL_LEVELS, "curve")[1:4] == b"PNG"  # loads its file only now
    assert sys.path == before
    print("done")
"""


@pytest.fixture
def library(tmp_path):
    """A box among modules that leave a mark when they are imported."""
    folder = tmp_path / "library"
    folder.mkdir()
    write_box(folder / "box.off")
    for name in NAMES:
        (folder / f"{name}.py").write_text(
            "import os\nopen(os.path.join(os.path.dirname(__file__), 'mark'), 'a').close()\n"
        )
    return folder


@pytest.mark.parametrize("how", ["-c", "-", "-m", "prompt"])
def test_nothing_beside_the_files_is_run(library, tmp_path, how):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "program.py").write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{tmp_path / 'elsewhere'}"}
    # A prompt imports some modules before anything is typed at it: it gets them before the folder becomes hostile.
    given = {"-c": PROGRAM, "-m": "program"}.get(how)
    started = [sys.executable, *(["-i"] if how == "prompt" else [how] if given is None else [how, given])]
    if how == "prompt":
        environment["PYTHONSTARTUP"] = str(tmp_path / "elsewhere" / "program.py")
    done = subprocess.run(
        started, cwd=library, env=environment, input=PROGRAM if how == "-" else "", capture_output=True, text=True
    )
    assert "done" in done.stdout, done.stderr
    assert {path.name for path in library.iterdir()} == {"box.off", *(f"{name}.py" for name in NAMES)}


def test_the_command_runs_nothing_beside_the_files(library, tmp_path):
    program = (
        "import sys; sys.path = [p for p in sys.path if p]\n"
        "from fsh3d_o3d.cli import main; sys.path.insert(0, ''); sys.exit(main())"
    )
    for arguments in (
        ["info", "box.off"],
        ["reconstruct", SAMPLES / "gem.stl", tmp_path / "o.ply", "--bandwidth", "4", "--report", tmp_path / "o.html"],
        ["index", ".", tmp_path / "index", "--option", "energies", "--workers", "1"],
        ["query", tmp_path / "index", "box.off"],
        [
            "index",
            ".",
            tmp_path / "other",
            "--option",
            "energies",
            "--workers",
            "1",
            "--engine",
            "ray",
            "--no-thumbnails",
        ],
    ):
        done = subprocess.run(
            [sys.executable, "-c", program, *map(str, arguments)],
            cwd=library,
            env={**os.environ, "PYTHONPATH": str(ROOT), "RAY_USAGE_STATS_ENABLED": "0"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    assert not (library / "mark").exists()


def test_what_stays_on_the_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(_imports, "_STARTED_IN", str(tmp_path / "start"))
    (tmp_path / "link").symlink_to(tmp_path)
    kept = [str(ROOT), str(tmp_path / "sub"), str(Path(os.__file__).parent)]
    names = ["", ".", "sub", str(tmp_path), str(tmp_path / "link"), str(tmp_path / "start")]
    before = [*names[:3], *kept, *names[3:]]
    monkeypatch.setattr(sys, "path", list(before))
    assert _imports.installed_path() == kept
    with _imports.only_installed():
        assert sys.path == kept
        sys.path.append("/added")
    assert [entry for entry in sys.path if entry != "/added"] == before and "/added" in sys.path
    monkeypatch.chdir(ROOT)  # a checkout, for those who work on it
    monkeypatch.setattr(sys, "path", [str(ROOT)])
    assert _imports.installed_path() == [str(ROOT)]


def test_a_removed_working_folder(tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    monkeypatch.setattr(sys, "path", ["", str(ROOT)])
    assert _imports.installed_path() == [str(ROOT)]
    monkeypatch.chdir(tmp_path)


def test_a_users_own_module_is_found_by_the_workers_but_stands_in_for_none(library, tmp_path):
    """A descriptor in a file beside the notebook: its folder comes last."""
    (library / "mine.py").write_text(
        "from tests.jobs.toys import ToyDescriptor\nclass Mine(ToyDescriptor):\n    pass\n"
    )
    program = PROGRAM.replace('if __name__ == "__main__":', "import mine; ToyDescriptor = mine.Mine\nif True:")
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=library,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert "done" in done.stdout, done.stderr
    assert not (library / "mark").exists()
