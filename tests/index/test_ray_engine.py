"""The Ray engine: the same rows as the local one, the same isolation, and what it says where it cannot run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import sys
import threading
import time
from pathlib import Path

import pytest

from fsh3d_o3d.cli import main
from fsh3d_o3d.index.shape_index import ShapeIndex
from fsh3d_o3d.jobs.ray_tasks import _require_server, run_tasks_on_ray
from tests.index.index_cases import QUICK, write_library

COLUMNS = ("path", "content", "identity", "size", "mtime", "vertices", "triangles", "watertight", "option")
COLUMNS += ("signature", "sketch", "thumbnail", "checksum")


@pytest.fixture(autouse=True)
def quiet(monkeypatch):
    """Nothing is reported to anyone, whichever side starts Ray."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")


@pytest.fixture
def ray():
    """A Ray of two processors."""
    import ray

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


def picture(geometry) -> bytes:
    """A thumbnail; kills the process that draws a tetrahedron."""
    if len(geometry.vertices) == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    return str(len(geometry.vertices)).encode()


def endless(_) -> bytes:
    time.sleep(3600)
    return b""


def library(folder: Path) -> list[str]:
    """Nine blobs, of which two are equal, one file that cannot be read and one that kills its process."""
    paths = write_library(folder, range(8))
    shutil.copy(paths[0], folder / "copy.off")
    (folder / "broken.off").write_text("OFF\n4 1 0\n0 0 0\n")
    corners = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    (folder / "deadly.off").write_text(f"OFF\n4 4 0\n{corners}3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
    return [*paths, *(os.fspath(folder / name) for name in ("copy.off", "broken.off", "deadly.off"))]


def rows(index: ShapeIndex, names=COLUMNS):
    table = index._store.columns(index._store.models, names).select(list(names))
    return sorted(table.to_pylist(), key=lambda row: row["path"])


def test_rows_are_those_of_the_local_engine(ray, tmp_path):
    paths = library(tmp_path / "library")
    indices, updates = [], []
    for engine in ("local", "ray"):
        index = ShapeIndex.open(tmp_path / engine, create=True, option=QUICK)
        updates.append(index.add_files(paths, workers=2, thumbnail=picture, engine=engine))
        indices.append(index)
    local, remote = indices
    assert len(rows(remote)) == 9
    assert set(COLUMNS) == set(remote._store.models.schema.names)
    assert rows(remote) == rows(local)
    assert updates[1] == updates[0]
    assert remote.failures() == local.failures()
    reasons = {Path(failed.path).name: failed.reason for failed in remote.failures()}
    assert set(reasons) == {"broken.off", "deadly.off"}
    assert "SIGKILL" in reasons["deadly.off"]
    again = remote.add_files(paths, engine="ray")
    assert (again.added, again.unchanged, len(again.failed)) == (0, 9, 2)
    # A file that hangs ends as one that does on this machine.
    late = remote.add_files(write_library(tmp_path / "late", [8]), thumbnail=endless, timeout=1, engine="ray")
    assert [failed.reason for failed in late.failed] == ["took longer than 1 s"]
    assert ray.is_initialized()  # a Ray that was there is left
    _require_server(ray.get_runtime_context().gcs_address)  # what is asked of an address before Ray is, holds for Ray


def test_the_command_starts_and_ends_its_own_ray(tmp_path, capsys):
    import ray

    write_library(tmp_path / "library", range(2))
    arguments = ["index", tmp_path / "library", tmp_path / "index", "--engine", "ray", "--workers", 2]
    assert main([*map(str, arguments), "--option", "energies", "--no-thumbnails", "--quiet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["added"] == 2
    assert not ray.is_initialized()


def test_without_ray_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(ModuleNotFoundError, match=r"fsh3d-o3d\[ray\]"):
        index.add_files(write_library(tmp_path / "library", [0]), engine="ray")
    assert len(index) == 0


@pytest.fixture
def no_start(monkeypatch):
    """Ray must not be asked: it goes on trying for minutes."""
    import ray

    def init(**_):
        raise AssertionError("ray.init was called")

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)


@pytest.fixture
def free_port():
    """Where nothing listens: the port is taken, but not listened on."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


BAD = ["nonsense", "host:notaport", "host:70000", "host:0", "host", ":6379", "ray://", "ray://host", "[::1:6379", ""]


@pytest.mark.parametrize("address", BAD)
def test_what_is_no_address(tmp_path, no_start, address):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(ConnectionError) as caught:
        index.add_files(write_library(tmp_path / "library", [0]), engine="ray", address=address)
    assert str(caught.value) == f"no Ray at {address}: expected HOST:PORT, ray://HOST:PORT, 'auto' or 'local'"


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "ray://127.0.0.1:{}", "auto"])
def test_an_address_without_a_cluster(tmp_path, capsys, monkeypatch, no_start, free_port, form):
    if form == "auto":
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{free_port}")
    write_library(tmp_path / "library", [0])
    arguments = ["index", tmp_path / "library", tmp_path / "index", "--engine", "ray", "--address"]
    assert main([*map(str, arguments), form.format(free_port), "--option", "energies", "--no-thumbnails"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    shown = form.format(free_port).replace("auto", f"127.0.0.1:{free_port}")
    assert err == f"fsh3d: error: no Ray at {shown}: Connection refused\n"


@pytest.mark.parametrize("name", ["x..y", "x" * 70 + ".example", "\ud800"])
def test_a_name_that_no_host_can_have(no_start, name):
    with pytest.raises(ConnectionError, match=r"no Ray at .*idna"):
        next(run_tasks_on_ray(len, ["task"], workers=1, timeout=1, address=f"{name}:6379"))


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"", None])
def test_an_address_where_something_else_listens(no_start, monkeypatch, answer):
    monkeypatch.setattr("fsh3d_o3d.jobs.ray_tasks._ANSWER_TIMEOUT", 0.5)
    hold = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            with server.accept()[0] as connection:
                if answer is None:  # silent
                    hold.wait(60)
                else:
                    connection.recv(100)
                    connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with pytest.raises(ConnectionError, match="something else listens there"):
                next(
                    run_tasks_on_ray(
                        len, ["task"], workers=1, timeout=1, address=f"127.0.0.1:{server.getsockname()[1]}"
                    )
                )
        finally:
            hold.set()
            thread.join()


def test_arguments(tmp_path):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(ValueError, match="engine must be 'local' or 'ray', got 'spark'"):
        index.add_files([], engine="spark")
    with pytest.raises(ValueError, match="engine='ray'"):
        index.add_files([], address="auto")
