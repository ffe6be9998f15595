"""Ending the process that reads or indexes ends those that it has started, and removes what it had begun."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fsh3d_o3d.files.reading import read_geometry_arrays
from tests.files.mutations import valid_files
from tests.processes import children_of, is_alive, wait_until

ROOT = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
SIGNALS = [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]
COMMAND = "import sys; from fsh3d_o3d.cli import main; sys.exit(main())"
# A regular expression that takes for ever, in native code that does not let go of the interpreter.
ENDLESS = "import re; re.match(r'(a+)+$', 'a' * 60 + 'b')"
READING = """
from fsh3d_o3d.files import reader_process as p
import fsh3d_o3d.cli.process as c, sys
reader = p.ReaderProcess("tests.test_orphans:endless")
try:
    with c.terminable():
        reader.read("/a.off", timeout=3000, memory_limit=2**30)
except c.TerminatedError as end:
    reader.close()
    sys.exit(end.code)
"""


def endless(_: object) -> bytes:
    """Stands in for a parser or a thumbnail."""
    exec(ENDLESS)
    return b""


def end(process: subprocess.Popen, number: int) -> None:
    """Send a signal once there is a child, and check that it is gone with its parent."""
    try:
        assert wait_until(lambda: children_of(process.pid))
        children = children_of(process.pid)
        assert wait_until(lambda: all(os.getsid(child) == child for child in children))
        process.send_signal(number)
        expected = -number if number == signal.SIGKILL else 128 + number
        assert process.wait(60) == expected
        assert wait_until(lambda: not any(map(is_alive, children)))
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("number", SIGNALS)
def test_reading(number):
    end(subprocess.Popen([sys.executable, "-c", READING], env=ENVIRONMENT, cwd=ROOT), number)


@pytest.mark.parametrize("number", SIGNALS)
def test_indexing(tmp_path, number):
    """The worker hangs in a pipe's place: a file whose reading never ends."""
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "box.off").write_bytes(valid_files()["plain.off"].data)
    program = COMMAND.replace(
        "sys.exit",
        "import fsh3d_o3d.cli.index as i, tests.test_orphans as t; i._thumbnail = lambda: t.endless; sys.exit",
    )
    arguments = ["index", tmp_path / "library", tmp_path / "index", "--workers", "1", "--option", "energies"]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        env={**ENVIRONMENT, "TMPDIR": str(tmp_path)},
        cwd=ROOT,
        stderr=subprocess.PIPE,
    )
    end(process, number)
    with process.stderr:
        message = process.stderr.read()
    assert message == (b"" if number == signal.SIGKILL else f"fsh3d: ended by {signal.Signals(number).name}\n".encode())
    assert {path.name for path in tmp_path.iterdir()} == {"library", "index"}


def test_nothing_half_written_is_left(tmp_path):
    """Ended in the middle of writing: the temporary file goes, what was there stays."""
    target = tmp_path / "out.ply"
    target.write_text("before")
    program = (
        "import os, signal, pathlib, sys; from fsh3d_o3d.cli import main\n"
        "pathlib.Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    sample = ROOT / "samples" / "gem.stl"
    done = subprocess.run(
        [sys.executable, "-c", program, "reconstruct", str(sample), str(target), "--bandwidth", "4"],
        env=ENVIRONMENT,
        cwd=ROOT,
        capture_output=True,
    )
    assert (done.returncode, done.stderr) == (143, b"fsh3d: ended by SIGTERM\n")
    assert [path.name for path in tmp_path.iterdir()] == ["out.ply"]
    assert target.read_text() == "before"


def test_the_reader_outlives_the_thread_that_started_it(tmp_path):
    from fsh3d_o3d.files import reading

    path = tmp_path / "a.off"
    path.write_bytes(valid_files()["plain.off"].data)
    reading._reader.close()
    thread = threading.Thread(target=read_geometry_arrays, args=(path,))
    thread.start()
    thread.join()
    first = reading._reader._process.pid
    assert is_alive(first)
    read_geometry_arrays(path)
    assert reading._reader._process.pid == first


def test_a_forked_process_does_not_keep_the_reader_of_its_parent_alive(tmp_path):
    path = tmp_path / "a.off"
    path.write_bytes(valid_files()["plain.off"].data)
    program = (
        "import os, sys, signal; from fsh3d_o3d.files import reading\n"
        "reading.read_geometry_arrays(sys.argv[1]); reader = reading._reader._process.pid\n"
        "read, write = os.pipe()\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    os.write(write, b'+'); signal.pause()\n"
        "os.read(read, 1); print(child, reader, flush=True); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], env=ENVIRONMENT, cwd=ROOT, stdout=subprocess.PIPE
    ) as process:
        child, reader = map(int, process.stdout.readline().split())
        try:
            assert wait_until(lambda: not is_alive(reader))
            assert is_alive(child)
        finally:
            os.kill(child, signal.SIGKILL)


def test_signals_that_the_caller_ignores_stay_ignored(tmp_path):
    """As under ``nohup``."""
    program = (
        "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "import fsh3d_o3d.cli.cache as cache; from fsh3d_o3d.cli import main\n"
        "cache.run = lambda _: os.kill(os.getpid(), signal.SIGHUP) or 0\n"
        "sys.exit(main(['cache']))"
    )
    done = subprocess.run([sys.executable, "-c", program], env=ENVIRONMENT, cwd=ROOT, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
