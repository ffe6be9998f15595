"""What many small writes leave behind is put together, and what nobody reads any more is removed."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.index import store
from fsh3d_o3d.index.search import IndexSearch
from fsh3d_o3d.index.shape_index import ShapeIndex
from tests.index.index_cases import NOT_AT_ALL, QUICK, write_library


def data_files(index: Path) -> list[Path]:
    return list((index / "models.lance" / "data").iterdir())


@pytest.fixture
def filled(tmp_path):
    """An index whose rows were written one by one, without tidying up, and its files."""
    paths = write_library(tmp_path / "library", range(8))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    for path in paths:
        index.add_files([path], workers=1)
    return index, paths


def test_small_writes_are_put_together(filled, monkeypatch):
    index, paths = filled
    before = [index.query(path)[0].path for path in paths]
    monkeypatch.setattr(store, "_SMALL_FRAGMENTS", 4)
    assert index._store.tidy()
    assert index._store.models.stats()["fragment_stats"]["num_fragments"] == 1
    assert [index.query(path)[0].path for path in paths] == before == paths
    assert not index._store.tidy()


@pytest.mark.filterwarnings("ignore:optimize.cleanup_older_than=0:UserWarning")  # nobody else reads this index
def test_old_versions_go_after_an_hour(filled, monkeypatch, tmp_path):
    index, paths = filled
    monkeypatch.setattr(store, "_SPACE_ALWAYS_LEFT", 0)
    monkeypatch.setattr(store, "_SMALL_FRAGMENTS", 4)
    assert index._store.tidy()
    monkeypatch.undo()
    monkeypatch.setattr(store, "_SPACE_ALWAYS_LEFT", 0)
    together = data_files(tmp_path / "index")
    assert len(together) == 9  # eight of one row, and one of all
    assert not index._store.tidy()  # somebody may still be reading them
    monkeypatch.setattr(store, "_KEPT_SECONDS", NOT_AT_ALL)
    assert index._store.tidy()
    assert len(data_files(tmp_path / "index")) < 9
    assert [index.query(path)[0].path for path in paths] == paths


def test_an_inverted_file_is_made_anew_for_moved_rows(filled, monkeypatch):
    index, _ = filled
    search = IndexSearch(index._store, QUICK, exact_below=4)
    search.index()
    version = index._store.refresh()
    search.index()
    assert index._store.refresh() == version
    search.index(moved=True)
    assert index._store.refresh() > version
    statistics = index._store.models.index_stats("sketch_idx")
    assert (statistics.num_indexed_rows, statistics.num_unindexed_rows) == (8, 0)


def test_sizes_of_what_is_old(filled, tmp_path):
    index, _ = filled
    assert index._store._old_bytes("models") == 0
    files = data_files(tmp_path / "index")
    os.utime(files[0], (0, 0))
    assert index._store._old_bytes("models") == files[0].stat().st_size
    assert index._store._old_bytes("nothing") == 0
    assert np.isfinite(index.query(index.query(filled[1][0])[0].path)[0].distance)
