"""Whatever happens to the names of files, each is in the index exactly once, with its own content."""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.retrieval import _index_filling as filling
from fsh3d_o3d.retrieval._index_extraction import Described, FileState, describe
from fsh3d_o3d.retrieval._index_rows import model_columns
from fsh3d_o3d.retrieval.shape_index import ShapeIndex
from fsh3d_o3d.retrieval.worker_pool import Outcome
from tests.retrieval.index_cases import QUICK, blob, write_library

SHAPES = 7


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Files are described here, one after the other: a run takes milliseconds."""

    def run_tasks(function, tasks, **_):
        for place, task in enumerate(tasks):
            try:
                yield Outcome(place, function(task), None)
            except (ValueError, OSError) as error:  # noqa: PERF203 - each file at its own risk
                yield Outcome(place, None, str(error))

    monkeypatch.setattr(filling, "run_tasks", run_tasks)


@pytest.fixture(scope="module")
def shapes(tmp_path_factory):
    """Contents of files, by what their rows must hold: SHA-256 and signature."""
    paths = write_library(tmp_path_factory.mktemp("shapes"), range(SHAPES))
    found = [Described(FileState(0, 0), bytes(32), describe(blob(n), QUICK)) for n in range(SHAPES)]
    columns = model_columns(paths, found, QUICK, np.zeros((np.prod(QUICK.feature_shape), 128), np.float16))
    contents = [Path(path).read_bytes() for path in paths]
    return {(hashlib.sha256(c).digest(), s): c for c, s in zip(contents, columns["signature"], strict=True)}


class Library:
    """A folder of files whose times of change are all different, whatever the clock's resolution."""

    def __init__(self, folder: Path, shapes) -> None:
        self.folder = folder
        self.contents = list(shapes.values())
        self.expected = {content: row for row, content in shapes.items()}
        self.moment = 10**9
        folder.mkdir()

    def write(self, name: str, content: bytes) -> None:
        (self.folder / name).write_bytes(content)
        self.moment += 10**9
        os.utime(self.folder / name, ns=(self.moment, self.moment))

    def turn(self, *names: str) -> None:
        """Each file takes the name of the next, the last that of the first."""
        (self.folder / names[-1]).rename(self.folder / "aside")
        for name, after in reversed(list(itertools.pairwise(names))):
            (self.folder / name).rename(self.folder / after)
        (self.folder / "aside").rename(self.folder / names[0])

    def paths(self) -> list[str]:
        return sorted(os.fspath(path) for path in self.folder.iterdir())

    def truth(self):
        """What must be in the index of each readable file."""
        found = {path: self.expected.get(Path(path).read_bytes()) for path in self.paths()}
        return {path: row for path, row in found.items() if row is not None}


def rows(index):
    """What is in the index of each path; fails where a path is in two rows."""
    store = index._store
    store.refresh()
    table = store.columns(store.models, ["path", "content", "signature"]).to_pydict()
    names = list(map(os.fsdecode, table["path"]))
    assert len(set(names)) == len(names)
    return dict(zip(names, zip(table["content"], table["signature"], strict=True), strict=True))


@pytest.fixture
def library(tmp_path, shapes):
    library = Library(tmp_path / "library", shapes)
    for place, name in enumerate("abcde"):
        library.write(f"{name}.off", library.contents[place])
    return library


@pytest.fixture
def index(tmp_path, library):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    index.add_files(library.paths(), workers=1)
    assert rows(index) == library.truth()
    return index


def test_a_new_file_under_the_old_name_of_a_renamed_one(index, library):
    (library.folder / "a.off").rename(library.folder / "a_v1.off")
    library.write("a.off", library.contents[6])
    update = index.add_files(library.paths(), workers=1)
    assert (update.added, update.moved, update.unchanged, update.failed) == (1, 1, 4, ())
    assert rows(index) == library.truth()


@pytest.mark.parametrize("rows_a_commit", [1, 2, 512])
@pytest.mark.parametrize("names", ["ab", "ba", "abc", "cba", "abcde", "edcba"])
def test_files_that_trade_names(index, library, monkeypatch, names, rows_a_commit):
    monkeypatch.setattr(filling, "_ROWS_A_COMMIT", rows_a_commit)
    library.turn(*(f"{name}.off" for name in names))
    update = index.add_files(library.paths(), workers=1)
    assert (update.added + update.moved, update.unchanged, update.failed) == (len(names), 5 - len(names), ())
    assert rows_a_commit < 512 or update.added == 0
    assert rows(index) == library.truth()
    assert index.add_files(library.paths(), workers=1).unchanged == 5


@pytest.mark.parametrize("rows_a_commit", [1, 512])
def test_a_file_that_moves_away_from_one_that_breaks(index, library, monkeypatch, rows_a_commit):
    monkeypatch.setattr(filling, "_ROWS_A_COMMIT", rows_a_commit)
    (library.folder / "a.off").rename(library.folder / "z.off")
    library.write("a.off", b"not a mesh")
    update = index.add_files(library.paths(), workers=1)
    assert [Path(failed.path).name for failed in update.failed] == ["a.off"]
    assert rows(index) == library.truth()


@pytest.mark.parametrize("seed", range(4))
def test_any_sequence_of_changes(index, library, monkeypatch, seed):
    random = np.random.default_rng(seed)
    names = [f"{name}.off" for name in "abcdefgh"]

    def change():
        there = [Path(path).name for path in library.paths()]
        some = random.permutation(there).tolist()
        kind = random.integers(7)
        if kind == 0 and some:
            (library.folder / some[0]).rename(library.folder / random.choice(names))
        elif kind == 1:
            library.write(random.choice(names), library.contents[random.integers(SHAPES)])
        elif kind == 2 and some:
            library.write(random.choice(names), (library.folder / some[0]).read_bytes())
        elif kind == 3 and len(some) > 3:
            (library.folder / some[0]).unlink()
        elif kind == 4:
            library.write(random.choice(names), b"not a mesh")
        elif kind == 5 and some:
            library.write(some[0], (library.folder / some[0]).read_bytes())
        elif len(some) > 1:
            library.turn(*some[: random.integers(2, len(some) + 1)])

    for _ in range(25):
        for _ in range(random.integers(1, 6)):
            change()
        monkeypatch.setattr(filling, "_ROWS_A_COMMIT", int(random.integers(1, 4)))
        update = index.add_files(library.paths(), workers=1)
        found, truth = rows(index), library.truth()
        assert {path: row for path, row in found.items() if Path(path).exists()} == truth
        assert len(library.paths()) == update.added + update.moved + update.unchanged + len(update.failed)
        assert {failed.path for failed in index.failures() if Path(failed.path).exists()} == set(library.paths()) - set(
            truth
        )


def test_a_run_that_is_cut_off_between_two_commits(index, library, monkeypatch):
    monkeypatch.setattr(filling, "_ROWS_A_COMMIT", 1)
    library.turn("a.off", "b.off", "c.off")
    run_tasks = filling.run_tasks

    def cut_off(function, tasks, **how):
        yield next(run_tasks(function, tasks, **how))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(filling, "run_tasks", cut_off)
        with pytest.raises(KeyboardInterrupt):
            index.add_files(library.paths(), workers=1)
    assert rows(index) != library.truth()
    index.add_files(library.paths(), workers=1)
    assert rows(index) == library.truth()


def test_copies(index, library):
    shutil.copy(library.folder / "a.off", library.folder / "copy.off")
    assert index.add_files(library.paths(), workers=1).moved == 1
    library.write("a.off", library.contents[6])
    assert index.add_files(library.paths(), workers=1).added == 1
    assert rows(index) == library.truth()
