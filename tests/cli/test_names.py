"""Names that would steer a terminal, split a message, or reverse a page: every sub-command shows them escaped."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fsh3d_o3d._printable import encodable, printable
from fsh3d_o3d.cli import main

SAMPLES = Path(__file__).parents[2] / "samples"
ROOT = Path(__file__).parents[2]
NAME = os.fsdecode(b"e\x1b[31m\nn\xe2\x80\xaer\xff")
INDEX = "n\u202er"  # what an index may be called
SHOWN = r"e\x1b[31m\nn\u202er\xff"


def test_printable():
    assert printable(NAME) == SHOWN
    assert printable("\ud800\u2028\u200f\x85\u0085") == r"\ud800\u2028\u200f\x85\x85"
    assert printable("Größe – 大きさ 🪨 \\") == "Größe – 大きさ 🪨 \\"
    assert encodable("a\n\udcff\ud800") == "a\n\\xff\\ud800"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of that name, with a model, a broken one, a classification, and an index."""
    folder = tmp_path_factory.mktemp("names")
    (folder / "library" / NAME).mkdir(parents=True)
    shutil.copy(SAMPLES / "gem.stl", folder / f"{NAME}.stl")
    shutil.copy(SAMPLES / "gem.stl", folder / "library" / NAME / f"{NAME}.stl")
    (folder / "library" / f"{NAME}.off").write_text("OFF\n")
    (folder / f"{NAME}.cla").write_text("PSB 1\n1 1\n\ngem 0 1\nnone\n")
    return folder


COMMANDS = [
    (["info", "{0}.stl"], 0),
    (["info", "{0}.off"], 2),
    (["info", "library/{0}.off"], 2),
    (["info", "{0}.stl", "--{0}"], 2),
    (["{0}"], 2),
    (["reconstruct", "{0}.stl", "{0}.ply", "--bandwidth", "4"], 0),
    (["reconstruct", "{0}.stl", "{0}", "--bandwidth", "4"], 2),
    (["reconstruct", "{0}.stl", "{0}.ply", "--center", "{0},1,2"], 2),
    (["describe", "{0}.stl", "library/{0}.off", "-o", "{0}.npz", "--option", "energies"], 1),
    (["describe", "{0}.stl", "-o", "{0}"], 2),
    (["align", "{0}.stl", "{0}.stl", "-o", "{0}.ply"], 1),  # a gem fits in several poses
    (["align", "{0}.stl", "{0}.stl", "-o", "{0}.xyz"], 2),
    (["evaluate", "--models", "library", "--classification", "{0}.cla", "--no-cache"], 2),
    (["evaluate", "--models", "{0}", "--classification", "{0}"], 2),
    (["index", "library", "{1}.fsh", "--option", "energies", "--workers", "1"], 1),
    (["index", "{0}", "{1}.fsh"], 2),
    (["index", "library", "{0}.fsh"], 2),
    (["query", "{1}.fsh", "{0}.stl", "--report", "{0}.html"], 0),
    (["query", "{1}.fsh", "library"], 1),
    (["query", "{1}.fsh", "--near-duplicates"], 0),
    (["query", "{0}", "{0}.stl"], 2),
    (["cache"], 0),
    (["cache", "--clear"], 0),
]


def test_every_sub_command(place, capfd, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.setenv("FSH3D_CACHE_DIR", os.path.join(place, NAME))  # noqa: PTH118 - any bytes
    shown = 0
    for arguments, expected in COMMANDS:
        code = main([argument.format(NAME, INDEX) for argument in arguments])
        out, err = capfd.readouterr()
        assert code == expected, (arguments, err)
        for text in (out, err):
            assert all(line.isprintable() for line in text.split("\n")), (arguments, text)
            assert not text.startswith("n\u202e"), arguments
        shown += r"n\u202er" in out + err
    assert shown >= len(COMMANDS) - 3  # some say nothing of a file
    page = (place / f"{NAME}.html").read_text(encoding="utf-8")
    assert SHOWN in page
    body = page[page.index("<body>") : page.index('<script type="application/json"')]
    assert not set(body) & set("\x1b\u202e\udcff")


def test_closed_streams(tmp_path):
    """As cron and daemons leave them: no file that is opened becomes a standard stream, and nothing is refused."""
    program = tmp_path / "program.py"
    program.write_text(
        "import os, sys\n"
        "closed = os.environ['CLOSED'].split()\n"
        "from fsh3d_o3d.cli import main\n"
        "commands = [['cache'], ['info', sys.argv[1]], ['--version'], ['describe', 'none.off', '-o', 'f.npz'],\n"
        "    ['reconstruct', 'none.off', 'o.ply'], ['align', 'none.off', 'none.off', '-o', 'o.ply'],\n"
        "    ['index', 'none', 'i'], ['query', 'none', 'none.off'], ['nonsense'],\n"
        "    ['evaluate', '--models', 'none', '--classification', 'none.cla']]\n"
        "codes = [main(command) for command in commands]\n"
        "devices = [os.readlink(f'/proc/self/fd/{number}') for number in closed]\n"
        "open('codes', 'w').write(repr((codes, devices)))\n"
    )
    for closed in ("0", "1", "2", "0 1 2"):
        redirected = " ".join({"0": "<&-", "1": ">&-", "2": "2>&-"}[number] for number in closed.split())
        done = subprocess.run(
            ["sh", "-c", f'exec "$@" {redirected}', "sh", sys.executable, program, SAMPLES / "gem.stl"],
            env={**os.environ, "PYTHONPATH": str(ROOT), "CLOSED": closed},
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, (closed, done.stderr)
        codes, devices = eval((tmp_path / "codes").read_text())
        assert codes == [0, 0, 0, *[2] * 7], closed
        assert set(devices) == {os.devnull}
        assert "NoneType" not in done.stderr and "internal" not in done.stderr
