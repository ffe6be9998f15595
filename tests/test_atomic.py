"""Files are whole or not there, and asked onto the disk before they get their names."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d import RadialShape, fibonacci_grid
from fsh3d_o3d._atomic import atomic_write_bytes, replacement, sync_file, sync_folder
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.sphere import weight_cache
from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere.weight_solver import analytic_weights


@pytest.fixture
def calls(monkeypatch) -> list[tuple[str, str]]:
    """What is asked onto the disk and what is renamed, in order."""
    noted: list[tuple[str, str]] = []
    sync, replace = os.fsync, Path.replace

    def note_sync(descriptor: int) -> None:
        name = os.fspath(Path(f"/proc/self/fd/{descriptor}").readlink())
        noted.append(("folder" if Path(name).is_dir() else "file", name))
        sync(descriptor)

    def note_replace(path: Path, target: Path) -> Path:
        noted.append(("name", os.fspath(target)))
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    return noted


def write_mesh(folder: Path) -> Path:
    write_geometry(folder / "mesh.ply", MeshArrays(*icosphere(1)))
    return folder / "mesh.ply"


def write_shape(folder: Path) -> Path:
    RadialShape.from_geometry(MeshArrays(*icosphere(2)), bandwidth=4).save(folder / "shape.npz")
    return folder / "shape.npz"


def write_weights(folder: Path) -> Path:
    solution = analytic_weights(fibonacci_grid(96), 4, cache=False)
    weight_cache.keep("key", solution)
    return folder / "weights" / "key.npz"


def write_bytes(folder: Path) -> Path:
    atomic_write_bytes(folder / "page.html", b"text")
    return folder / "page.html"


@pytest.mark.parametrize("write", [write_mesh, write_shape, write_weights, write_bytes])
def test_the_file_then_its_name_then_the_folder(write, calls, tmp_path, monkeypatch):
    monkeypatch.setenv("FSH3D_CACHE_DIR", os.fspath(tmp_path))
    path = write(tmp_path)
    own = [(kind, name) for kind, name in calls if Path(name) in (path, path.parent) or kind == "file"][-3:]
    assert [kind for kind, _ in own] == ["file", "name", "folder"]
    assert Path(own[0][1]).name.startswith(".fsh3d-")
    assert own[1:] == [("name", os.fspath(path)), ("folder", os.fspath(path.parent))]
    assert path.stat().st_size > 0


def test_a_disk_that_fails_before_the_name_is_given_changes_nothing(tmp_path, monkeypatch):
    path = tmp_path / "kept"
    path.write_bytes(b"old")

    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="error") as caught:
        atomic_write_bytes(path, b"new")
    assert (caught.value.errno, caught.value.filename) == (errno.EIO, os.fspath(path))
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(OSError, match="error"):
        sync_folder(tmp_path)


def test_a_file_that_is_written_bit_by_bit_is_there_in_the_end_or_not_at_all(tmp_path):
    path = tmp_path / "rows"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), replacement(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    with replacement(path) as file:
        file.write(b"first, ")
        file.write(b"second")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"first, second"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_system_that_cannot_sync_folders_is_no_error(tmp_path, monkeypatch):
    sync = os.fsync

    def refuse_folders(descriptor: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").is_dir():
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", refuse_folders)
    atomic_write_bytes(tmp_path / "new", b"new")
    assert (tmp_path / "new").read_bytes() == b"new"


def test_what_is_not_there_is_an_error(tmp_path):
    for sync in (sync_file, sync_folder):
        with pytest.raises(FileNotFoundError):
            sync(tmp_path / "missing")


def test_weights_of_the_cache_come_back(tmp_path, monkeypatch):
    monkeypatch.setenv("FSH3D_CACHE_DIR", os.fspath(tmp_path))
    solution = analytic_weights(fibonacci_grid(96), 4, cache=False)
    weight_cache.keep("key", solution)
    weight_cache._memory.clear()
    found = weight_cache.find("key", 96)
    assert found is not None
    np.testing.assert_array_equal(found.weights, solution.weights)
