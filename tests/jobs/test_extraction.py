"""Descriptors of many files: order, failures of every kind, the cache, interruption."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.jobs.descriptor_cache import DescriptorCache
from fsh3d_o3d.jobs.extraction import extract_descriptors
from tests.jobs import toys
from tests.jobs.mesh_files import write_box
from tests.jobs.toys import NotAVector, ToyDescriptor
from tests.processes import own_children, wait_until

ROOT = Path(__file__).parents[2]


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FSH3D_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_order_and_workers(tmp_path):
    paths = [write_box(tmp_path / f"{i}.off", (1, 2, 4 + i)) for i in range(7)]
    one, three = (extract_descriptors(paths, ToyDescriptor(), workers=n, cache=False) for n in (1, 3))
    assert one.descriptors.dtype == np.float32
    assert one.descriptors.tolist() == [[1, 2, 4 + i] for i in range(7)]
    assert one.descriptors.tobytes() == three.descriptors.tobytes()
    assert one.indices.tolist() == three.indices.tolist() == list(range(7))
    assert one.failed == three.failed == ()
    assert one.cached == 0
    assert (one.seconds > 0).all()


def test_each_failure_costs_its_file_only(tmp_path):
    kinds = {
        "raise": (toys.RAISE, "ZeroDivisionError: cannot describe this"),
        "nan": (toys.NAN, "its descriptor is not finite"),
        "crash": (toys.CRASH, "the process describing it was killed by SIGSEGV"),
        "exit": (toys.EXIT, "the process describing it ended with exit code 7"),
    }
    paths = [write_box(tmp_path / "first.off")]
    for name, (vertices, _) in kinds.items():
        paths += [write_box(tmp_path / f"{name}.off", vertices=vertices), write_box(tmp_path / f"after_{name}.off")]
    (tmp_path / "broken.off").write_text("OFF\n4 1 0\n0 0 0\n")
    (tmp_path / "folder.off").mkdir()
    os.mkfifo(tmp_path / "pipe.off")
    paths += [tmp_path / name for name in ("broken.off", "folder.off", "pipe.off", "none.off", "unknown.xxx")]
    result = extract_descriptors(paths, ToyDescriptor(), workers=2, cache=True)
    assert [paths[i].name for i in result.indices] == ["first.off", *(f"after_{name}.off" for name in kinds)]
    assert result.descriptors.tolist() == [[1, 2, 3]] * 5
    reasons = {Path(failed.path).name: failed.reason for failed in result.failed}
    assert list(reasons) == [path.name for path in paths if not path.name.startswith(("first", "after"))]
    for name, (_, reason) in kinds.items():
        assert reasons[f"{name}.off"] == reason
    assert reasons["none.off"] == "No such file"
    for reason in reasons.values():
        assert str(tmp_path) not in reason  # the path stands beside it
        assert "\n" not in reason


def test_endless_work_is_stopped(tmp_path, monkeypatch):
    toys.let_an_hour_pass(monkeypatch, tmp_path / "hanging")
    paths = [write_box(tmp_path / "hangs.off", vertices=toys.HANG), write_box(tmp_path / "fine.off")]
    descriptor = ToyDescriptor(hanging=tmp_path / "hanging")
    result = extract_descriptors(paths, descriptor, workers=1, cache=False, timeout=3600)
    assert result.indices.tolist() == [1]
    assert result.failed[0].reason == "took longer than 3600 s"


def test_worker_processes_are_single_threaded_and_without_open3d(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    paths = [write_box(tmp_path / f"{n}.off", vertices=n) for n in (toys.THREADS, toys.OPEN3D)]
    result = extract_descriptors(paths, ToyDescriptor(), workers=1, cache=False)
    assert result.descriptors.tolist() == [[1, 1, 1], [0, 0, 0]]
    assert os.environ["OMP_NUM_THREADS"] == "5"


def test_cache(tmp_path, own_cache):
    paths = [write_box(tmp_path / f"{i}.off", (1, 2, 4 + i)) for i in range(4)]
    first = extract_descriptors(paths, ToyDescriptor(), workers=2)
    again = extract_descriptors(paths, ToyDescriptor(), workers=2)
    assert (first.cached, again.cached) == (0, 4)
    assert first.descriptors.tobytes() == again.descriptors.tobytes()
    assert first.seconds.tolist() == again.seconds.tolist()
    # By content, not by name: a copy is known, a changed file is not.
    (tmp_path / "copy.off").write_bytes(paths[2].read_bytes())
    write_box(paths[0], (1, 2, 100))
    changed = extract_descriptors([*paths, tmp_path / "copy.off"], ToyDescriptor(), workers=1)
    assert changed.cached == 4
    assert changed.descriptors[:, 2].tolist() == [100, 5, 6, 7, 6]
    assert extract_descriptors(paths[:1], ToyDescriptor("other options"), workers=1).cached == 0
    before = {path: path.read_bytes() for path in own_cache.rglob("*") if path.is_file()}
    assert extract_descriptors(paths, ToyDescriptor(), workers=1, cache=False).cached == 0
    extract_descriptors([write_box(tmp_path / "new.off", (3, 3, 3))], ToyDescriptor(), workers=1, cache=False)
    assert {path: path.read_bytes() for path in own_cache.rglob("*") if path.is_file()} == before


def test_wrong_use(tmp_path):
    path = write_box(tmp_path / "a.off")
    with pytest.raises(ValueError, match="workers must be"):
        extract_descriptors([path], ToyDescriptor(), workers=0)
    with pytest.raises(ValueError, match="timeout must be > 0"):
        extract_descriptors([path], ToyDescriptor(), timeout=0)
    result = extract_descriptors([path], NotAVector(), workers=1, cache=False)
    assert result.failed[0].reason == "its descriptor should have shape (d,), got (8, 3)"
    assert result.descriptors.shape == (0, 0)
    assert len(extract_descriptors([], ToyDescriptor()).indices) == 0


def test_processes_that_do_not_start(tmp_path, capfd):
    with pytest.raises(RuntimeError, match="cannot load the function: ValueError: invalid literal"):
        extract_descriptors([write_box(tmp_path / "a.off")], toys.DoesNotArrive(), workers=1, cache=False)
    assert capfd.readouterr().err == ""


def test_processes_end_before_the_error_is_handled(tmp_path, own_cache, monkeypatch):
    before = set(own_children())

    def interrupted(*_):
        assert set(own_children()) > before
        raise KeyboardInterrupt

    monkeypatch.setattr(DescriptorCache, "keep", interrupted)
    paths = [write_box(tmp_path / "hangs.off", vertices=toys.HANG), write_box(tmp_path / "fine.off")]
    try:
        extract_descriptors(paths, ToyDescriptor(), workers=2)
    except KeyboardInterrupt:
        left = set(own_children()) - before
    assert left == set()


def test_interrupt_leaves_no_process_behind(tmp_path):
    path = write_box(tmp_path / "hangs.off", vertices=toys.HANG)
    script = tmp_path / "script.py"
    script.write_text(
        "import threading, time\n"
        "from pathlib import Path\n"
        "from fsh3d_o3d.jobs import extract_descriptors\n"
        "from tests.processes import own_children\n"
        "from tests.jobs.toys import ToyDescriptor\n"
        "def tell():\n"
        "    while not own_children():\n"
        "        time.sleep(0.01)\n"
        "    print(*own_children(), flush=True)\n"
        "if __name__ == '__main__':\n"
        "    threading.Thread(target=tell, daemon=True).start()\n"
        "    descriptor = ToyDescriptor(hanging=Path('hanging'))\n"
        f"    extract_descriptors([{str(path)!r}], descriptor, workers=1, cache=False)\n"
    )
    with subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=tmp_path,
    ) as process:
        children = [int(word) for word in process.stdout.readline().split()]
        assert len(children) == 1
        assert os.getsid(children[0]) == children[0]  # deaf to the terminal from its first instant
        assert wait_until((tmp_path / "hanging").exists)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: all processes of the group
        errors = process.communicate(timeout=60)[1]
    assert process.returncode != 0
    assert errors.count("Traceback") == 1  # of the script; none of the worker
    assert "KeyboardInterrupt" in errors
    assert not Path(f"/proc/{children[0]}").exists()
