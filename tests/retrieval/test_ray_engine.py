"""The Ray engine: the same rows as the local one, the same isolation, and what it says where it cannot run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

import pytest

from fsh3d_o3d.cli import main
from fsh3d_o3d.retrieval.shape_index import ShapeIndex
from tests.retrieval.index_cases import QUICK, write_library

COLUMNS = ("path", "content", "identity", "size", "mtime", "vertices", "triangles", "watertight", "option")
COLUMNS += ("signature", "sketch", "thumbnail")


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


def test_an_address_without_a_cluster(tmp_path):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(ConnectionError, match="no Ray at nonsense"):
        index.add_files(write_library(tmp_path / "library", [0]), engine="ray", address="nonsense")


def test_arguments(tmp_path):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(ValueError, match="engine must be 'local' or 'ray', got 'spark'"):
        index.add_files([], engine="spark")
    with pytest.raises(ValueError, match="engine='ray'"):
        index.add_files([], address="auto")
