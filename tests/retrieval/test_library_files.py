"""Walking a library: all names, no links, nothing outside."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fsh3d_o3d.retrieval.library_files import library_files

HOSTILE = [b"a b.off", b"quote'\".ply", b"new\nline.obj", b"<script>.stl", b"\xff\xfe.glb", "größe.off".encode()]


def touched(folder, name):
    path = folder / os.fsdecode(name)
    path.touch()
    return os.fspath(path)


def test_any_name_is_found_and_can_be_opened(tmp_path):
    (tmp_path / "deep" / "er").mkdir(parents=True)
    expected = {touched(tmp_path / "deep" / "er", name) for name in HOSTILE}
    touched(tmp_path, b"readme.txt")
    found = list(library_files(tmp_path))
    assert set(found) == expected
    assert all(Path(path).is_absolute() and Path(path).exists() for path in found)


def test_links_are_not_followed(tmp_path):
    library, outside = tmp_path / "library", tmp_path / "outside"
    library.mkdir()
    outside.mkdir()
    secret = touched(outside, b"secret.off")
    own = touched(library, b"own.off")
    (library / "loop").symlink_to(library, target_is_directory=True)
    (library / "away").symlink_to(outside, target_is_directory=True)
    (library / "file.off").symlink_to(secret)
    (library / "dangling.off").symlink_to("nowhere")
    assert list(library_files(library)) == [own]
    (tmp_path / "entrance").symlink_to(library, target_is_directory=True)
    assert [Path(path).name for path in library_files(tmp_path / "entrance")] == ["own.off"]


def test_index_inside_of_the_library_is_left_out(tmp_path):
    (tmp_path / "index").mkdir()
    touched(tmp_path / "index", b"inner.off")
    own = touched(tmp_path, b"own.off")
    assert list(library_files(tmp_path, leave_out=tmp_path / "index")) == [own]


def test_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        list(library_files(tmp_path / "none"))
    with pytest.raises(NotADirectoryError):
        list(library_files(touched(tmp_path, b"file.off")))
