"""What is reported done is on the disk: files first, then the folders that hold their names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fsh3d_o3d.index.shape_index import ShapeIndex
from tests.index.index_cases import QUICK, write_library


@pytest.fixture
def synced(monkeypatch) -> list[Path]:
    """What is asked onto the disk, in order."""
    noted: list[Path] = []
    sync = os.fsync

    def note(descriptor: int) -> None:
        noted.append(Path(f"/proc/self/fd/{descriptor}").readlink())
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    return noted


def files_of(index: Path) -> set[Path]:
    return {path for path in index.rglob("*") if path.is_file()}


def require_on_disk(index: Path, synced: list[Path], new: set[Path]) -> None:
    """All new files were, and after each the folder that holds it."""
    for path in new:
        if path.parent.name == "checksums":  # under another name then
            assert index / "checksums" in synced
            continue
        assert path in synced, path
        assert path.parent in synced[synced.index(path) :], path
    manifests = [place for place, path in enumerate(synced) if path.suffix == ".manifest" and path in new]
    data = [place for place, path in enumerate(synced) if path.parent.name == "data" and path in new]
    assert not data or max(data) < max(manifests)


def test_a_new_index_and_each_commit_are_on_the_disk(tmp_path, synced):
    paths = write_library(tmp_path / "library", range(3))
    folder = tmp_path / "index"
    index = ShapeIndex.open(folder, create=True, option=QUICK)
    require_on_disk(folder, synced, files_of(folder))
    assert folder in synced
    assert tmp_path in synced  # which holds the index's name
    before = files_of(folder)
    synced.clear()
    index.add_files(paths, workers=1)
    require_on_disk(folder, synced, files_of(folder) - before)
    before = files_of(folder)
    synced.clear()
    Path(paths[0]).unlink()
    index.prune()
    new = files_of(folder) - before
    assert any(path.parent.name == "_deletions" for path in new)
    require_on_disk(folder, synced, new)
    assert not before & set(synced) - {path for path in before if path.suffix == ".json"}  # each file once
    synced.clear()
    assert len(index) == 2
    index.query(paths[1])
    assert synced == []


def test_what_a_killed_writer_left_is_on_the_disk_with_the_next_commit(tmp_path, synced):
    paths = write_library(tmp_path / "library", range(2))
    folder = tmp_path / "index"
    ShapeIndex.open(folder, create=True, option=QUICK).add_files(paths[:1], workers=1)
    synced.clear()
    ShapeIndex.open(folder, option=QUICK).add_files(paths, workers=1)
    models = {path for path in files_of(folder) if "models.lance" in path.parts}
    require_on_disk(folder, synced, models)
