"""The index: what goes in is found, what changes is seen, what is wrong is said."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.descriptors.shd import SHDOption, descriptor_distances, shd_descriptor
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.index import store as _index_store
from fsh3d_o3d.index.shape_index import ShapeIndex, ShapeIndexError
from tests.index.index_cases import QUICK, blob, write_library

COUNT = 8


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A library of eight shapes and one broken file, indexed; tests work on copies of it."""
    root = tmp_path_factory.mktemp("filled")
    paths = write_library(root / "library", range(COUNT))
    (root / "library" / "broken.off").write_text("OFF\n4 1 0\n0 0 0\n")
    paths.append(os.fspath(root / "library" / "broken.off"))
    index = ShapeIndex.open(root / "index", create=True, option=QUICK)
    update = index.add_files(paths, workers=1, thumbnail=size_as_picture)
    assert (update.added, update.moved, update.unchanged) == (COUNT, 0, 0)
    assert [failed.path for failed in update.failed] == paths[-1:]
    return root


@pytest.fixture
def case(filled, tmp_path):
    """A copy of the index, and the paths of the library, which stays as it is."""
    shutil.copytree(filled / "index", tmp_path / "index")
    return tmp_path / "index", [os.fspath(filled / "library" / f"blob{n}.off") for n in range(COUNT)]


def size_as_picture(geometry):
    return str(len(geometry.vertices)).encode()


def opened(path):
    return ShapeIndex.open(path, option=QUICK)


def test_a_model_finds_itself_and_the_others_by_distance(case):
    path, paths = case
    index = opened(path)
    assert len(index) == COUNT
    hits = index.query(paths[3], top=5, rerank=0)
    assert [hit.rank for hit in hits] == [1, 2, 3, 4, 5]
    assert hits[0].path == paths[3]
    assert hits[0].distance == 0
    assert (hits[0].vertices, hits[0].triangles, hits[0].watertight) == (362, 720, True)
    assert hits[0].thumbnail == b"362"
    features = np.stack([shd_descriptor(blob(n), QUICK) for n in range(COUNT)])
    true = descriptor_distances(features[3], features, QUICK)[0]
    assert [hit.path for hit in hits] == [paths[n] for n in np.argsort(true)[:5]]
    # One byte a number costs a few thousandths of distances in [0, 2].
    np.testing.assert_allclose([hit.distance for hit in hits], np.sort(true)[:5], atol=0.01)


def test_hits_tell_how_they_lie(tmp_path, random_rotation, rng):
    paths = write_library(tmp_path / "library", range(4, 7))
    index = ShapeIndex.open(tmp_path / "index", create=True)
    index.add_files(paths, workers=1)
    mesh, shift = blob(5), rng.standard_normal(3)
    moved = MeshArrays(2.5 * mesh.vertices @ random_rotation.T + shift, mesh.triangles)
    for rerank in (0, 4):
        hit = index.query(moved, top=1, rerank=rerank)[0]
        assert hit.path == paths[1]
        # Samples of the surface lie elsewhere after the rotation; a tenth of a degree was seen.
        assert np.abs(hit.rotation - random_rotation).max() < 0.02
        onto = mesh.vertices @ hit.transformation[:3, :3].T + hit.transformation[:3, 3]
        assert np.abs(onto - moved.vertices).max() < 0.02 * moved.diagonal
        assert not hit.rotation.flags.writeable


def test_what_has_not_changed_is_not_read(case, monkeypatch):
    path, paths = case
    monkeypatch.setattr("fsh3d_o3d.index.filling.run_tasks", only_for([]))
    update = opened(path).add_files([*paths, paths[0]], workers=1)
    assert (update.added, update.moved, update.unchanged, update.failed) == (0, 0, COUNT, ())


def only_for(expected):
    def run_tasks(function, tasks, **_):
        assert list(tasks) == expected
        yield from ()

    return run_tasks


def test_changed_renamed_touched_and_removed_files(tmp_path):
    paths = write_library(tmp_path / "library", range(4))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    index.add_files(paths, workers=1)
    write_geometry(paths[0], blob(9))
    renamed = os.fspath(tmp_path / "library" / "new name.off")
    Path(paths[1]).rename(renamed)
    os.utime(paths[2], (1, 1))
    update = index.add_files([paths[0], renamed, paths[2], paths[3]], workers=1)
    assert (update.added, update.moved, update.unchanged, update.failed) == (1, 2, 1, ())
    assert (update.gone, len(index)) == (1, 4)  # the old name went with the file
    assert index.prune(tmp_path / "library") == 0
    hits = {hit.path: hit for hit in index.query(blob(1), top=10, rerank=0)}
    assert set(hits) == {paths[0], renamed, paths[2], paths[3]}
    assert hits[renamed].distance == min(hit.distance for hit in hits.values()) < 1e-6
    assert index.query(blob(9), top=1)[0].path == paths[0]
    again = index.add_files([paths[0], renamed, paths[2], paths[3]], workers=1)
    assert again.unchanged == 4


def test_a_folder_that_is_not_there_is_not_pruned(case, tmp_path):
    index = opened(case[0])
    with pytest.raises(FileNotFoundError):
        index.prune(tmp_path / "not mounted")
    (tmp_path / "empty").mkdir()
    assert index.prune(tmp_path / "empty") == 0
    assert len(index) == COUNT


def test_failures_are_kept_in_mind_until_they_change(tmp_path):
    (good,) = write_library(tmp_path / "library", [0])
    bad = tmp_path / "library" / "bad.off"
    bad.write_text("OFF\n4 1 0\n0 0 0\n")
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    first = index.add_files([good, bad, tmp_path / "none.off"], workers=1)
    assert [Path(failed.path).name for failed in first.failed] == ["bad.off", "none.off"]
    assert first.failed[1].reason == "No such file or directory"
    assert index.failures() == first.failed[:1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fsh3d_o3d.index.filling.run_tasks", only_for([]))
        assert index.add_files([bad], workers=1).failed == first.failed[:1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fsh3d_o3d.index.filling.run_tasks", only_for([os.fspath(bad)]))
        index.add_files([bad], workers=1, retry_failed=True)
    # A failure that is mended moves to the models, a model that breaks moves to the failures.
    write_geometry(bad, blob(1))
    Path(good).write_text("not a mesh")
    update = index.add_files([good, bad], workers=1)
    assert (update.added, len(update.failed), len(index)) == (1, 1, 1)
    assert [failed.path for failed in index.failures()] == [good]
    assert index.query(blob(0), top=5)[0].path == os.fspath(bad)


def test_a_file_that_changes_while_it_is_read_is_noticed(tmp_path):
    (path,) = write_library(tmp_path / "library", [0])
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    update = index.add_files([path], workers=1, thumbnail=Touching(path))
    assert [failed.reason for failed in update.failed] == ["changed while it was read"]
    assert index.add_files([path], workers=1).added == 1  # its state is another one now: tried again


class Touching:
    """Changes the file that is being read."""

    def __init__(self, path):
        self.path = path

    def __call__(self, _):
        os.utime(self.path, (5, 5))
        return b""


def test_names_of_any_bytes(tmp_path):
    (source,) = write_library(tmp_path / "library", [0])
    names = [b"a'b\".off", b"new\nline.off", b"\xff\xfe.off", b"<img src=x>.off"]
    paths = [tmp_path / os.fsdecode(name) for name in names]
    for path in paths:
        shutil.copy(source, path)
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    assert index.add_files(paths, workers=1).added == 4
    assert {hit.path for hit in index.query(source)} == set(map(os.fspath, paths))
    for path in paths:
        path.unlink()
    assert index.prune() == 4
    assert index.query(source) == ()


def test_other_options_are_refused(case):
    path, _ = case
    with pytest.raises(ShapeIndexError, match="not made with the option given"):
        ShapeIndex.open(path, option=SHDOption())
    with pytest.raises(ShapeIndexError, match="the same option"):
        ShapeIndex.open(path)
    with pytest.raises(TypeError, match="SHDOption"):
        ShapeIndex.open(path, option="best")


def test_named_options_need_not_be_given_again(tmp_path):
    ShapeIndex.open(tmp_path / "index", create=True, option=SHDOption.published())
    assert ShapeIndex.open(tmp_path / "index").option == SHDOption.published()


def test_no_index(tmp_path):
    with pytest.raises(FileNotFoundError):
        ShapeIndex.open(tmp_path / "none")
    assert not (tmp_path / "none").exists()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.txt").write_text("precious")
    with pytest.raises(ShapeIndexError, match="no index"):
        ShapeIndex.open(tmp_path / "folder")
    with pytest.raises(ShapeIndexError, match="something else"):
        ShapeIndex.open(tmp_path / "folder", create=True)
    with pytest.raises(ShapeIndexError, match="this is a file"):
        ShapeIndex.open(tmp_path / "folder" / "thesis.txt", create=True)


@pytest.mark.parametrize("table", ["basis", "failures", "models"])
def test_making_that_was_cut_off_is_taken_up(tmp_path, table):
    """Killed, or out of room, before the first manifest of a table, and so before those made after it."""
    path = tmp_path / "index"
    ShapeIndex.open(path, create=True, option=QUICK)
    shutil.rmtree(path / f"{table}.lance" / "_versions")
    for later in {"basis": ("failures", "models"), "failures": ("models",), "models": ()}[table]:
        shutil.rmtree(path / f"{later}.lance")
    with pytest.raises(ShapeIndexError, match="no index"):
        ShapeIndex.open(path, option=QUICK)
    index = ShapeIndex.open(path, create=True, option=QUICK)
    assert index.add_files(write_library(tmp_path / "library", range(2)), workers=1).added == 2


def test_newer_format(tmp_path, monkeypatch):
    monkeypatch.setattr(_index_store, "FORMAT", 7)
    ShapeIndex.open(tmp_path / "index", create=True)
    monkeypatch.undo()
    with pytest.raises(ShapeIndexError, match="format 7, made by a newer version"):
        ShapeIndex.open(tmp_path / "index")


def test_older_format(tmp_path, monkeypatch):
    monkeypatch.setattr(_index_store, "FORMAT", 1)
    ShapeIndex.open(tmp_path / "index", create=True)
    monkeypatch.undo()
    with pytest.raises(ShapeIndexError, match=r"format 1, made by an older version.* index the library anew"):
        ShapeIndex.open(tmp_path / "index")


def damage_manifests(index):
    for manifest in index.glob("models.lance/_versions/*.manifest"):
        manifest.write_bytes(b"garbage" * 20)


def remove_data(index):
    shutil.rmtree(index / "models.lance" / "data")


def cut_data(index):
    for file in index.glob("models.lance/data/*"):
        file.write_bytes(file.read_bytes()[:-100])


def remove_table(index):
    shutil.rmtree(index / "failures.lance")


def flip_bits(index):
    """Within the feature of a row, found by its bytes: nothing but the checksum knows."""
    store = opened(index)._store
    signature = store.columns(store.models, ["signature"])["signature"][2].as_py()
    flipped = 0
    for file in index.glob("models.lance/data/*"):  # one a commit: more where describing took longer
        data = bytearray(file.read_bytes())
        place = data.find(signature[200:264])
        if place >= 0:
            data[place + 5] ^= 0x40
            file.write_bytes(data)
            flipped += 1
    assert flipped == 1


@pytest.mark.parametrize("damage", [damage_manifests, remove_data, cut_data, remove_table, flip_bits])
def test_damage_is_said_in_one_line(case, damage):
    path, paths = case
    damage(path)
    with pytest.raises(ShapeIndexError, match="damaged") as caught:
        opened(path).query(paths[0])
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_near_duplicates(tmp_path, random_rotation):
    paths = write_library(tmp_path / "library", range(5))
    mesh = blob(2)
    copy = tmp_path / "library" / "copy.ply"
    write_geometry(copy, MeshArrays(3 * mesh.vertices @ random_rotation.T, mesh.triangles[::-1]))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    index.add_files([*paths, copy], workers=1)
    (pair,) = index.near_duplicates(0.12)  # this coarse option notices a rotation by some hundredths
    assert {pair.first, pair.second} == {paths[2], os.fspath(copy)}
    everything = index.near_duplicates(2)
    assert len(everything) == 6 * 5 // 2
    assert [pair.distance for pair in everything] == sorted(pair.distance for pair in everything)


def test_bad_arguments(case, tmp_path):
    index = opened(case[0])
    with pytest.raises(ValueError, match="top"):
        index.query(blob(0), top=0)
    with pytest.raises(ValueError, match="rerank"):
        index.query(blob(0), rerank=-1)
    with pytest.raises(ValueError, match="workers"):
        index.add_files([], workers=0)
    with pytest.raises(ValueError, match="timeout"):
        index.add_files([], timeout=0)
    with pytest.raises(ValueError, match="limit"):
        index.near_duplicates(-1)
    with pytest.raises(FileNotFoundError):
        index.query(tmp_path / "none.off")
    with pytest.raises(TypeError, match="geometry"):
        index.query(3)
