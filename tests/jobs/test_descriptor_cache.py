"""The descriptor cache: what is put in comes out, damage and bad places are survived."""

from __future__ import annotations

import multiprocessing
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.jobs import descriptor_cache
from fsh3d_o3d.jobs.descriptor_cache import (
    CachedDescriptor,
    DescriptorCache,
    clear_descriptor_cache,
    descriptor_cache_path,
    descriptor_key,
)


def entry(seed, size=544):
    values = np.random.default_rng(seed).standard_normal(size).astype(np.float32)
    return CachedDescriptor(values, seed / 7)


def key(number):
    return number.to_bytes(32, "big")


def fill(path, numbers):
    with DescriptorCache(path) as cache:
        for number in numbers:
            cache.keep(key(number), entry(number))


def check_all(path, numbers):
    with DescriptorCache(path) as cache:
        found = cache.find(map(key, numbers))
    assert set(found) == set(map(key, numbers))
    for number in numbers:
        assert found[key(number)].values.tobytes() == entry(number).values.tobytes()
        assert found[key(number)].seconds == entry(number).seconds


def test_round_trip_of_more_than_one_query_holds(tmp_path):
    fill(tmp_path / "c.sqlite", range(1200))
    check_all(tmp_path / "c.sqlite", range(1200))
    with DescriptorCache(tmp_path / "c.sqlite") as cache:
        assert cache.find([key(5000)]) == {}


def test_a_later_entry_replaces_the_earlier(tmp_path):
    with DescriptorCache(tmp_path / "c.sqlite") as cache:
        cache.keep(key(1), entry(2))
        cache.keep(key(1), entry(1))
    check_all(tmp_path / "c.sqlite", [1])


def test_several_processes_at_once(tmp_path):
    path = tmp_path / "c.sqlite"
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=fill, args=(path, range(i * 200, i * 200 + 300))) for i in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    check_all(path, range(500))


@pytest.mark.parametrize("column", ["value", "digest", "seconds", "key"])
def test_damaged_entries_are_ignored(tmp_path, column, caplog):
    path = tmp_path / "c.sqlite"
    fill(path, [1, 2])
    damage = {"value": b"\0" * 2176, "digest": None, "seconds": 9.5, "key": key(3)}[column]
    with sqlite3.connect(path) as connection:
        connection.execute(f"UPDATE descriptors SET {column} = ? WHERE key = ?", (damage, key(1)))
    connection.close()
    with DescriptorCache(path) as cache:
        assert set(cache.find([key(1), key(2), key(3)])) == {key(2)}
    assert "damaged entry" in caplog.text
    fill(path, [1])
    check_all(path, [1, 2])


@pytest.mark.parametrize("content", [b"this is no database" * 500, b"SQLite format 3\0" + b"\xff" * 5000])
def test_damaged_file_is_started_anew(tmp_path, content, caplog):
    path = tmp_path / "c.sqlite"
    path.write_bytes(content)
    fill(path, range(3))
    check_all(path, range(3))
    assert "damaged cache file" in caplog.text


def test_file_damaged_in_the_middle(tmp_path):
    path = tmp_path / "c.sqlite"
    fill(path, range(300))
    data = bytearray(path.read_bytes())
    data[4096 : len(data) // 2] = b"\xa5" * (len(data) // 2 - 4096)
    path.write_bytes(data)
    with DescriptorCache(path) as cache:
        for found, value in cache.find(map(key, range(300))).items():  # few or none, but none that is wrong
            assert value.values.tobytes() == entry(int.from_bytes(found, "big")).values.tobytes()
        cache.keep(key(1), entry(1))


def test_no_place_for_a_cache(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with DescriptorCache(tmp_path / "file" / "c.sqlite") as cache:
        cache.keep(key(1), entry(1))
        assert cache.find([key(1)]) == {}
    (tmp_path / "folder.sqlite").mkdir()
    with DescriptorCache(tmp_path / "folder.sqlite") as cache:
        cache.keep(key(1), entry(1))
        assert cache.find([key(1)]) == {}


def test_path_and_clearing(tmp_path, monkeypatch):
    monkeypatch.setenv("FSH3D_CACHE_DIR", str(tmp_path))
    assert tmp_path in descriptor_cache_path().parents
    assert clear_descriptor_cache() == 0
    fill(None, [1])
    assert descriptor_cache_path().is_file()
    assert clear_descriptor_cache() == 1
    assert not descriptor_cache_path().exists()


def test_keys(tmp_path, monkeypatch):
    for name, content in (("a.off", "1"), ("b.off", "1"), ("A.OFF", "1"), ("a.ply", "1"), ("c.off", "2")):
        (tmp_path / name).write_text(content)
    same = {descriptor_key(tmp_path / name, "x") for name in ("a.off", "b.off", "A.OFF")}
    assert len(same) == 1
    keys = [*same, descriptor_key(tmp_path / "a.ply", "x"), descriptor_key(tmp_path / "c.off", "x")]
    keys.append(descriptor_key(tmp_path / "a.off", "y"))
    # Another version of the code must not answer for this one.
    folders = {path.parent.name for path in Path(descriptor_cache.__file__).parents[1].glob("*/__init__.py")}
    assert folders > descriptor_cache._WITHOUT_INFLUENCE  # a folder that is not there would leave nothing out
    monkeypatch.setattr(descriptor_cache, "_code_digest", lambda: b"another")
    keys.append(descriptor_key(tmp_path / "a.off", "x"))
    assert len(set(keys)) == 5
    assert {len(k) for k in keys} == {32}
    assert descriptor_key(tmp_path, "x") is None
    assert descriptor_key(tmp_path / "none.off", "x") is None
