"""Whatever happens to the names of files and folders, each file is in the index exactly once, with its own content."""

from __future__ import annotations

import errno
import hashlib
import itertools
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.index import filling as filling
from fsh3d_o3d.index.extraction import Described, FileState, describe
from fsh3d_o3d.index.rows import model_columns
from fsh3d_o3d.index.shape_index import ShapeIndex
from fsh3d_o3d.jobs.worker_pool import Outcome
from tests.files.formats.gltf.gltf_files import GltfFile
from tests.files.mutations import VERTICES
from tests.index.index_cases import QUICK, blob, write_library

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
        return sorted(os.fspath(path) for path in self.folder.rglob("*.off"))

    def truth(self):
        """What must be in the index of each readable file."""
        found = {path: self.expected.get(Path(path).read_bytes()) for path in self.paths()}
        return {path: row for path, row in found.items() if row is not None}


def rows(index):
    """What is in the index of each path; fails where a path is in two rows."""
    store = index._store
    store.refresh()
    table = store.columns(store.models, ["path", "content", "signature"]).to_pydict()
    names = [store.roots().path(stored) for stored in table["path"]]
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


@pytest.mark.parametrize("as_library", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_any_sequence_of_changes(index, library, monkeypatch, seed, as_library):
    """Of files given one by one, and as a library, which may also move as a whole."""
    random = np.random.default_rng(seed)
    names = [f"{name}.off" for name in "abcdefgh"]

    def change():
        there = [Path(path).name for path in library.paths()]
        some = random.permutation(there).tolist()
        kind = random.integers(8 if as_library else 7)
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
        elif kind == 7:
            target = library.folder.with_name(f"library{random.integers(10**9)}")
            library.folder = library.folder.rename(target)
        elif len(some) > 1:
            library.turn(*some[: random.integers(2, len(some) + 1)])

    for _ in range(25):
        for _ in range(random.integers(1, 6)):
            change()
        monkeypatch.setattr(filling, "_ROWS_A_COMMIT", int(random.integers(1, 4)))
        folder = library.folder if as_library else None
        update = index.add_files(library.paths(), workers=1, library=folder)
        found, truth = rows(index), library.truth()
        assert {path: row for path, row in found.items() if Path(path).exists()} == truth
        # Rows of files that are gone are those of which nothing is left.
        gone = [row for path, row in found.items() if path not in truth]
        assert not set(gone) & set(truth.values())
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


def test_a_renamed_file_leaves_its_old_name(index, library):
    (library.folder / "a.off").rename(library.folder / "z.off")
    update = index.add_files(library.paths(), workers=1)
    assert (update.added, update.moved, update.unchanged, update.gone) == (0, 1, 4, 1)
    assert rows(index) == library.truth()


def test_a_deleted_file_is_kept_until_it_is_pruned(index, library):
    before = rows(index)
    (library.folder / "a.off").unlink()
    assert index.add_files(library.paths(), workers=1).gone == 0
    assert rows(index) == before
    assert index.prune() == 1
    assert rows(index) == library.truth()


@pytest.fixture
def known(index, library, tmp_path):
    """An index that knows the library as one, with a sub-folder."""
    index.remove([library.folder])
    (library.folder / "deep").mkdir()
    for name in "de":
        (library.folder / f"{name}.off").rename(library.folder / "deep" / f"{name}.off")
    assert index.add_files(library.paths(), workers=1, library=library.folder).added == 5
    return index


def test_a_library_that_is_renamed_moves_along(known, library, tmp_path):
    old, library.folder = library.folder, library.folder.rename(tmp_path / "elsewhere")
    update = known.add_files(library.paths(), workers=1, library=library.folder)
    assert [(move.old, move.new) for move in update.libraries] == [(os.fspath(old), os.fspath(library.folder))]
    assert (update.added, update.moved, update.unchanged, update.gone) == (0, 0, 5, 0)
    assert rows(known) == library.truth()
    assert {hit.path for hit in known.query(blob(0))} == set(library.paths())
    again = known.add_files(library.paths(), workers=1, library=library.folder)
    assert (again.unchanged, again.libraries) == (5, ())


@pytest.mark.parametrize("left", [3, 2])
def test_half_of_a_library_tells_where_it_is(known, library, tmp_path, left):
    old, library.folder = library.folder, library.folder.rename(tmp_path / "elsewhere")
    for path in library.paths()[left:]:
        Path(path).unlink()
    update = known.add_files(library.paths(), workers=1, library=library.folder)
    assert len(update.libraries) == (left == 3)
    found = rows(known)
    assert {path: row for path, row in found.items() if Path(path).exists()} == library.truth()
    assert len(found) == (5 if left == 3 else 7)
    # What is not recognised can be told.
    update = known.add_files(library.paths(), workers=1, library=library.folder, moved_from=old)
    assert len(rows(known)) == 5
    assert known.prune(library.folder) == 5 - left
    assert rows(known) == library.truth()


def test_another_library_under_the_same_names_is_another(known, library, tmp_path):
    """Same names, sizes and times, but other contents: nothing is believed without reading it."""
    moment = {path: Path(path).stat() for path in library.paths()}
    old, library.folder = library.folder, library.folder.rename(tmp_path / "elsewhere")
    for path, about in moment.items():
        place = path.replace(os.fspath(old), os.fspath(library.folder))
        data = bytearray(Path(place).read_bytes())
        data[-2:-1] = b"0" if data[-2:-1] != b"0" else b"1"
        Path(place).write_bytes(data)
        os.utime(place, ns=(about.st_atime_ns, about.st_mtime_ns))
    update = known.add_files(library.paths(), workers=1, library=library.folder)
    assert (update.libraries, update.unchanged) == ((), 0)
    assert len(rows(known)) == 10


def test_a_copied_library_is_another_and_one_that_was_taken_away_is_none(known, library, tmp_path):
    shutil.copytree(library.folder, tmp_path / "copy")
    first, library.folder = library.folder, tmp_path / "copy"
    update = known.add_files(library.paths(), workers=1, library=library.folder)
    assert (update.moved, update.libraries, len(rows(known))) == (5, (), 10)
    shutil.rmtree(first)
    update = known.add_files(library.paths(), workers=1, library=library.folder)
    assert (update.gone, update.unchanged) == (5, 5)
    assert rows(known) == library.truth()


def test_a_folder_without_answer_is_not_gone(known, library, tmp_path, monkeypatch):
    """The old place cannot be looked into: the copy elsewhere is another library."""
    shutil.copytree(library.folder, tmp_path / "copy")
    closed = os.fspath(library.folder)
    stat, lstat, scandir = os.stat, os.lstat, os.scandir

    def denying(function):
        def asked(path=".", *arguments, **how):
            if isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith(closed):
                raise OSError(errno.EIO, os.strerror(errno.EIO), path)
            return function(path, *arguments, **how)

        return asked

    library.folder = tmp_path / "copy"
    files = library.paths()
    for name, function in (("stat", stat), ("lstat", lstat), ("scandir", scandir)):
        monkeypatch.setattr(os, name, denying(function))
    update = known.add_files(files, workers=1, library=library.folder)
    assert (update.moved, update.gone, update.libraries) == (5, 0, ())
    kept = []
    assert known.prune(on_kept=kept.append) == 0
    assert {one.path: one.reason for one in kept} == {
        closed: "Input/output error, so 3 models in it are kept",
        f"{closed}/deep": "Input/output error, so 2 models in it are kept",
    }
    monkeypatch.undo()
    assert len(rows(known)) == 10


def test_links_to_a_library_are_that_library(known, library, tmp_path):
    (tmp_path / "link").symlink_to(library.folder)
    (tmp_path / "way").symlink_to(tmp_path)
    for link in (tmp_path / "link", tmp_path / "way" / "library"):
        linked = [path.replace(os.fspath(library.folder), os.fspath(link)) for path in library.paths()]
        assert known.add_files(linked, workers=1, library=link).unchanged == 5
        assert known.add_files(linked, workers=1).unchanged == 5
        assert known.prune(link) == 0
    assert rows(known) == library.truth()


@pytest.mark.parametrize("inner_first", [False, True])
@pytest.mark.parametrize("told", [False, True])
def test_libraries_inside_of_each_other(index, library, tmp_path, inner_first, told):
    index.remove([library.folder])
    inner = library.folder / "inner"
    inner.mkdir()
    for name in "abc":
        (library.folder / f"{name}.off").rename(inner / f"{name}.off")
    folders = [inner, library.folder] if inner_first else [library.folder, inner]
    for folder in [*folders, *folders]:
        files = [path for path in library.paths() if path.startswith(os.fspath(folder))]
        index.add_files(files, workers=1, library=folder)
    assert rows(index) == library.truth()
    old, library.folder = library.folder, library.folder.rename(tmp_path / "elsewhere")
    where = {"moved_from": old} if told else {}
    update = index.add_files(library.paths(), workers=1, library=library.folder, **where)
    assert rows(index) == library.truth()
    # The outer one is recognised where it holds half of its rows itself; else the files are read and found again.
    assert update.added == 0


def test_a_library_that_moves_into_another(known, library, tmp_path):
    (tmp_path / "all").mkdir()
    write_library(tmp_path / "all", [5])
    files = [os.fspath(tmp_path / "all" / "blob5.off")]
    known.add_files(files, workers=1, library=tmp_path / "all")
    library.folder.rename(tmp_path / "all" / "library")
    library.folder = tmp_path / "all"
    update = known.add_files(library.paths(), workers=1, library=tmp_path / "all")
    assert (update.moved, update.gone, update.unchanged) == (5, 5, 1)
    assert set(rows(known)) == set(library.paths())


def test_where_a_library_was_must_be_true(known, library, tmp_path):
    with pytest.raises(ValueError, match=f"knows no library {tmp_path}/nowhere; its libraries: {library.folder}"):
        known.add_files(library.paths(), library=tmp_path / "new", moved_from=tmp_path / "nowhere")
    with pytest.raises(ValueError, match="give library"):
        known.add_files(library.paths(), moved_from=tmp_path)


def test_a_library_that_is_gone_is_pruned_only_by_name(known, library, tmp_path):
    library.folder.rename(tmp_path / "elsewhere")
    with pytest.warns(UserWarning, match="library: nothing is there, so its 5 models are kept"):
        assert known.prune() == 0
    with pytest.raises(FileNotFoundError):
        known.prune(tmp_path / "nowhere")
    library.folder.mkdir()  # as where nothing is mounted
    with pytest.warns(UserWarning, match="nothing is there"):
        assert known.prune() == 0
    library.folder.rmdir()
    assert known.prune(library.folder) == 5
    assert rows(known) == {}


def test_forgetting_files_and_folders(known, library, tmp_path):
    (tmp_path / "link").symlink_to(library.folder)
    assert known.remove([library.folder / "a.off", tmp_path / "link" / "b.off", tmp_path / "none.off"]) == 2
    assert known.remove(library.folder / "deep") == 2
    assert list(rows(known)) == [os.fspath(library.folder / "c.off")]
    assert known.add_files(library.paths(), workers=1, library=library.folder).added == 4
    assert rows(known) == library.truth()


def test_a_buffer_beside_a_file_is_a_part_of_it(index, tmp_path):
    folder = tmp_path / "gltf"
    folder.mkdir()
    names = [folder / "one.gltf", folder / "two.gltf"]

    def write(name, stretch):
        scene = GltfFile()
        scene.mesh(scene.octahedron(POSITION=scene.array(VERTICES * np.float32(stretch))))
        scene.tree["nodes"] = [{"mesh": 0}]
        name.write_text(scene.gltf(f"{name.stem}.bin"))
        name.with_suffix(".bin").write_bytes(scene.data)

    write(names[0], [1, 2, 3])
    write(names[1], [1, 1, 4])
    assert index.add_files(names, workers=1).added == 2
    before = {path: row for path, row in rows(index).items() if path.endswith(".gltf")}
    assert index.add_files(names, workers=1).unchanged == 2
    # The same text, and a buffer of the same size with other numbers.
    text = names[0].read_text()
    write(names[0], [2, 5, 3])
    assert names[0].read_text() == text
    os.utime(names[0], (1, 1))
    os.utime(names[0].with_suffix(".bin"), (9 * 10**9, 9 * 10**9))
    update = index.add_files(names, workers=1)
    assert (update.added, update.moved) == (1, 1)  # the other was looked into, and is as it was
    after = rows(index)
    assert after[str(names[1])] == before[str(names[1])]
    assert after[str(names[0])][0] != before[str(names[0])][0]
    assert after[str(names[0])][1] != before[str(names[0])][1]
    names[1].with_suffix(".bin").unlink()
    assert [failed.path for failed in index.add_files(names, workers=1).failed] == [str(names[1])]
    write(names[1], [1, 1, 4])
    assert index.add_files(names, workers=1).failed == ()
