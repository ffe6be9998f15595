"""Writers that are killed, that run side by side, that have no room or no right to write."""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path

import pytest

from fsh3d_o3d.index.shape_index import ShapeIndex
from tests.index.index_cases import QUICK, blob, fill, fill_slowly, write_library

SPAWN = multiprocessing.get_context("spawn")


def contents(index):
    store = ShapeIndex.open(index, option=QUICK)._store
    return Counter(map(os.fsdecode, store.columns(store.models, ["path"])["path"].to_pylist()))


def test_killed_writers_lose_and_repeat_nothing(tmp_path):
    paths = write_library(tmp_path / "library", range(30))
    index = os.fspath(tmp_path / "index")
    seen = []
    for _ in range(2):
        # Killed once it has written something new, wherever it then is; it does not end before, however late that is.
        writer = SPAWN.Process(target=fill_slowly, args=(index, paths, 8))
        writer.start()
        before = len(list(Path(index).glob("models.lance/_versions/*.manifest")))
        while len(list(Path(index).glob("models.lance/_versions/*.manifest"))) < before + 3:
            assert writer.is_alive()
            time.sleep(0.01)
        os.kill(writer.pid, signal.SIGKILL)
        writer.join()
        found = contents(index)
        assert set(found.values()) <= {1}
        assert set(seen) <= set(found)
        seen = list(found)
    assert 0 < len(seen) < 30
    update = ShapeIndex.open(index, option=QUICK).add_files(paths, workers=1)
    assert update.unchanged == len(seen)
    assert contents(index) == Counter(paths)


def test_two_writers_at_once(tmp_path):
    paths = write_library(tmp_path / "library", range(24))
    index = os.fspath(tmp_path / "index")
    writers = [SPAWN.Process(target=fill_slowly, args=(index, part)) for part in (paths[:18], paths[6:])]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0, 0]
    assert contents(index) == Counter(paths)


def _fill_without_room(index, paths, result):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
    try:
        fill(index, paths)
    except OSError as error:
        result.send((error.errno, str(error)))


def test_no_room_leaves_the_index_as_it_was(tmp_path):
    paths = write_library(tmp_path / "library", range(6))
    index = os.fspath(tmp_path / "index")
    fill(index, paths[:2])
    ours, theirs = SPAWN.Pipe()
    writer = SPAWN.Process(target=_fill_without_room, args=(index, paths, theirs))
    writer.start()
    theirs.close()
    number, text = ours.recv()
    writer.join()
    assert number == 27  # EFBIG, which a limit on the size of files gives; a full disk's is ENOSPC, by the same way
    assert "the index is as it was" in text
    assert contents(index) == Counter(paths[:2])
    fill(index, paths)
    assert contents(index) == Counter(paths)


@pytest.fixture
def public_folder():
    """A folder that other users may enter, unlike pytest's."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def test_read_only_index_is_searched_but_not_written(public_folder):
    paths = write_library(public_folder / "library", range(3))
    index = public_folder / "index"
    fill(os.fspath(index), paths[:2])
    for folder, _, _ in os.walk(index):
        Path(folder).chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)  # root may write anywhere
    try:
        found = ShapeIndex.open(index, option=QUICK)
        assert found.query(blob(1), top=1)[0].path == paths[1]
        with pytest.raises(PermissionError, match="read-only"):
            found.add_files(paths, workers=1)
        assert len(found) == 2
    finally:
        if root:
            os.seteuid(0)
        for folder, _, _ in os.walk(index):
            Path(folder).chmod(0o755)
