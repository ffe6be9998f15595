"""Threads share an index, and what one query returns is of one moment, whatever others write meanwhile."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from fsh3d_o3d.index import search
from fsh3d_o3d.index import store as _index_store
from fsh3d_o3d.index.shape_index import Hit, ShapeIndex, ShapeIndexError
from tests.index.index_cases import NOT_AT_ALL, QUICK, blob, write_library

SPAWN = multiprocessing.get_context("spawn")
THREADS = 6


def picture(geometry) -> bytes:
    """Tells which file it is of, and is long enough to be stored on its own."""
    return repr(geometry.vertices[:8].tolist()).encode()


def rewrite(index: str, paths: list[str], begin, rounds: int) -> None:
    """Write, delete, put together and remove old versions, over and over."""
    _index_store._SMALL_FRAGMENTS = 2
    _index_store._SPACE_ALWAYS_LEFT = 0
    _index_store._KEPT_SECONDS = NOT_AT_ALL
    found = ShapeIndex.open(index, option=QUICK)
    store = found._store
    begin.wait()
    for _ in range(rounds):
        for path in paths:
            rows = store.where("path", [os.fsencode(path)], store.models.schema.names)
            store.remove(store.models, [os.fsencode(path)])
            store.put(store.models, {name: rows[name] for name in rows.column_names})
        found._search.index(moved=store.tidy())


def facts(hit: Hit) -> tuple[object, ...]:
    return hit.path, hit.vertices, hit.thumbnail, round(hit.feature_distance, 6), hit.transformation.tobytes()


@pytest.mark.parametrize("exact_below", [5000, 4])
def test_threads_query_while_a_process_rewrites(tmp_path, monkeypatch, exact_below):
    monkeypatch.setitem(search.IndexSearch.__init__.__kwdefaults__, "exact_below", exact_below)
    paths = write_library(tmp_path / "library", range(12))
    name = os.fspath(tmp_path / "index")
    index = ShapeIndex.open(name, create=True, option=QUICK)
    index.add_files(paths, workers=1, thumbnail=picture)
    geometries = [blob(number) for number in range(4)]
    expected = [{hit.path: facts(hit) for hit in index.query(one, top=12)} for one in geometries]
    pairs = {(pair.first, pair.second): pair.distance for pair in index.near_duplicates(2)}
    begin = SPAWN.Event()
    # Half of the models come and go; the others must be among the hits of every query. Old versions are removed once a
    # round, fewer times than a query begins anew: it is answered however slow the machine.
    writer = SPAWN.Process(target=rewrite, args=(name, paths[6:], begin, _index_store._READ_ATTEMPTS - 1))
    writer.start()
    ready = threading.Barrier(THREADS)

    def ask(thread: int) -> int:
        ready.wait()
        begin.set()
        queries = 0
        while queries < 4 or writer.is_alive():
            which = (thread + queries) % len(geometries)
            hits = index.query(geometries[which], top=12, rerank=12 if queries % 2 else 0)
            assert {hit.path for hit in hits} >= set(paths[:6])
            assert len({hit.path for hit in hits}) == len(hits) == hits[-1].rank
            assert all(expected[which][hit.path] == facts(hit) for hit in hits)
            assert [hit.distance for hit in hits] == sorted(hit.distance for hit in hits)
            if queries % 8 == 0:
                found = index.near_duplicates(2)
                assert all(pairs[pair.first, pair.second] == pytest.approx(pair.distance) for pair in found)
                assert len(index) in (11, 12)
            queries += 1
        return queries

    try:
        with ThreadPoolExecutor(THREADS) as threads:
            counts = list(threads.map(ask, range(THREADS)))
    finally:
        begin.set()
        writer.join()
    assert writer.exitcode == 0
    assert min(counts) >= 4


def superseded(index: ShapeIndex, times: int, monkeypatch) -> Callable[[], int]:
    """Let a version be replaced and removed in the middle of a query, so many times; returns how often it was."""
    store, count = index._store, 0
    nearest = index._search.nearest

    def nearest_then_gone(models, query, number):
        nonlocal count
        found = nearest(models, query, number)
        if count < times:
            count += 1
            for path in store.columns(store.models, ["path"])["path"].to_pylist()[:2]:
                rows = store.where("path", [path], store.models.schema.names)
                store.put(store.models, {name: rows[name] for name in rows.column_names})
            monkeypatch.setattr(_index_store, "_KEPT_SECONDS", NOT_AT_ALL)
            monkeypatch.setattr(_index_store, "_SMALL_FRAGMENTS", 0)
            assert store.tidy()
        return found

    monkeypatch.setattr(index._search, "nearest", nearest_then_gone)
    return lambda: count


def filled(tmp_path: Path) -> tuple[ShapeIndex, list[str]]:
    paths = write_library(tmp_path / "library", range(4))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    for path in paths:
        index.add_files([path], workers=1)
    return index, paths


@pytest.mark.filterwarnings(
    "ignore:optimize.cleanup_older_than=0:UserWarning"
)  # a version that is read is what is wanted
def test_a_version_that_is_removed_while_it_is_read_is_replaced_by_a_newer_one(tmp_path, monkeypatch):
    index, paths = filled(tmp_path)
    removed = superseded(index, 2, monkeypatch)
    assert index.query(blob(1), top=1)[0].path == paths[1]
    assert removed() == 2


@pytest.mark.filterwarnings(
    "ignore:optimize.cleanup_older_than=0:UserWarning"
)  # a version that is read is what is wanted
def test_a_version_that_is_removed_before_it_is_opened_is_replaced_by_a_newer_one(tmp_path, monkeypatch):
    index, paths = filled(tmp_path)
    other = ShapeIndex.open(index.path, option=QUICK)
    store = index._store
    newest, asked = store._newest, []

    def newest_then_gone(table: str) -> int:
        number = newest(table)
        asked.append(number)
        if len(asked) == 1:  # the version that is opened next
            rows = other._store.where("path", [os.fsencode(paths[0])], other._store.models.schema.names)
            other._store.put(other._store.models, {name: rows[name] for name in rows.column_names})
            monkeypatch.setattr(_index_store, "_KEPT_SECONDS", NOT_AT_ALL)
            monkeypatch.setattr(_index_store, "_SMALL_FRAGMENTS", 0)
            assert other._store.tidy()
        return number

    monkeypatch.setattr(store, "_newest", newest_then_gone)
    assert index.query(blob(1), top=1)[0].path == paths[1]
    assert asked[1] > asked[0]


@pytest.mark.filterwarnings(
    "ignore:optimize.cleanup_older_than=0:UserWarning"
)  # a version that is read is what is wanted
def test_an_index_that_never_rests_is_an_error_in_the_end(tmp_path, monkeypatch):
    index, _ = filled(tmp_path)
    removed = superseded(index, 100, monkeypatch)
    with pytest.raises(ShapeIndexError):
        index.query(blob(1), top=1)
    assert removed() == _index_store._READ_ATTEMPTS


def test_threads_write_one_index(tmp_path):
    paths = write_library(tmp_path / "library", range(6))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with ThreadPoolExecutor(2) as threads:
        updates = list(threads.map(lambda part: index.add_files(part, workers=1), (paths[:4], paths[2:])))
    assert len(index) == 6
    assert sum(update.added + update.moved + update.unchanged for update in updates) == 8
