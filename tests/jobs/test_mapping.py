"""Functions over many files: in order, each file at its own risk, and why processes do not start, in one line."""

from __future__ import annotations

import functools
import subprocess
import sys
import textwrap
import types

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import _progress
from tests.jobs.mesh_files import write_box
from tests.scripts import run_script


def test_results_stand_where_their_files_do(tmp_path):
    boxes = [write_box(tmp_path / f"{number}.off") for number in range(3)]
    encode = functools.partial(fsh.ShellShape.from_geometry, bandwidth=4, shells=6)
    found = fsh.map_files(encode, [boxes[0], tmp_path / "none.off", boxes[1]], workers=2)
    assert [type(one) for one in found] == [fsh.ShellShape, fsh.FailedInput, fsh.ShellShape]
    assert (found[1].path, found[1].reason) == (str(tmp_path / "none.off"), "No such file")
    assert found[0] == encode(boxes[0])
    assert fsh.map_files(encode, [], workers=2) == ()


def test_notes_on_files_are_warned_of(tmp_path):
    (tmp_path / "odd.off").write_text("3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.warns(fsh.GeometryReadWarning, match=r"odd\.off: the keyword OFF is missing"):
        fsh.map_files(fsh.from_any, [tmp_path / "odd.off"], workers=1)


def test_wrong_use(tmp_path):
    with pytest.raises(TypeError, match="function must be one of a module"):
        fsh.map_files(lambda geometry: geometry, [tmp_path / "a.off"], workers=1)
    with pytest.raises(ValueError, match="workers must be"):
        fsh.map_files(fsh.from_any, [tmp_path / "a.off"], workers=0)


SCRIPT = """
import fsh3d_o3d as fsh

def count(geometry):
    return len(geometry.vertices)

{guard}
    print(fsh.map_files(count, ["box.off"], workers=2))
"""


def test_a_script_without_a_guard_is_told_so_in_one_line(tmp_path):
    write_box(tmp_path / "box.off")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(guard="if True:"))
    done = run_script(script, folder=tmp_path)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("RuntimeError: ") and 'if __name__ == "__main__":' in last
    assert done.stderr.count("Traceback") == 1  # the script's own
    script.write_text(SCRIPT.format(guard='if __name__ == "__main__":'))
    done = run_script(script, folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "(8,)\n"), done.stderr


def test_a_function_of_no_file_is_told_so(tmp_path):
    write_box(tmp_path / "box.off")
    code = textwrap.dedent(SCRIPT.format(guard="if True:"))
    command = [sys.executable, *(["-P"] if sys.version_info >= (3, 11) else []), "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert "write it into a file and import it from there" in done.stderr.splitlines()[-1]


def test_bars_are_seen_in_notebooks_and_on_terminals_alone(monkeypatch, capsys):
    def shown():
        bar = _progress.progress_bar(3, wanted=True, mininterval=0)
        bar.update()
        seen = not bar.disable
        bar.close()
        return seen

    assert not shown()
    assert capsys.readouterr().err == ""

    class Stream(types.SimpleNamespace):
        """As a kernel has it."""

    Stream.__module__ = "ipykernel.iostream"
    written = []
    monkeypatch.setattr(sys, "stderr", Stream(write=written.append, flush=lambda: None, isatty=lambda: False))
    monkeypatch.setattr(_progress.importlib.util, "find_spec", lambda name: None)  # without widgets
    assert shown()
    assert "1/3" in "".join(written)


def test_a_bar_that_is_not_wanted_is_not_there():
    assert _progress.progress_bar(3, wanted=False).disable
    assert np.isfinite(_progress.progress_bar(1.0, wanted=False).total)
