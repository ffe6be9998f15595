"""Walking a library: all names, no links, nothing outside."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from fsh3d_o3d.index.library_scan import library_files, missing_files, scan_library

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


def test_what_is_not_read_is_counted(tmp_path):
    folder = tmp_path / "deep"
    for place in (folder, folder / ".git"):
        place.mkdir()
        for name in (
            b"a.DWG",
            b"b.dwg",
            b"c.log.gz",
            b"LICENSE",
            b".hidden.txt",
            b"x.a name with a full stop",
            b"d.off",
        ):
            touched(place, name)
    (folder / "link.ply").symlink_to("d.off")
    (folder / "link.txt").symlink_to("LICENSE")
    (folder / "folder").symlink_to(tmp_path)
    scan = scan_library(tmp_path)
    assert [Path(path).name for path in scan.files] == ["d.off", "d.off"]
    assert scan.other_formats == {".dwg": 2, ".gz": 1, "": 2, ".txt": 1}
    assert scan.links == 2
    assert scan.not_listed == []


def denied(monkeypatch, function, path, number):
    """The system answers with an error when it is asked for a path; whoever the tests run as."""
    original = getattr(os, function)

    def asked(name=".", *arguments, **how):
        if os.fspath(name) == os.fspath(path):
            raise OSError(number, os.strerror(number), os.fspath(name))
        return original(name, *arguments, **how)

    monkeypatch.setattr(os, function, asked)


def test_a_folder_that_cannot_be_listed_is_named(tmp_path, monkeypatch):
    for name in ("closed", "open"):
        (tmp_path / name).mkdir()
        touched(tmp_path / name, b"a.off")
    denied(monkeypatch, "scandir", tmp_path / "closed", errno.EACCES)
    scan = scan_library(tmp_path)
    assert scan.files == [os.fspath(tmp_path / "open" / "a.off")]
    assert [(Path(one.path), one.reason) for one in scan.not_listed] == [
        (tmp_path / "closed", "Permission denied, so its files are not found")
    ]
    with pytest.warns(UserWarning, match="closed: Permission denied"):
        assert list(library_files(tmp_path)) == scan.files
    denied(monkeypatch, "scandir", tmp_path, errno.EIO)
    with pytest.raises(OSError, match="Input/output error"):
        scan_library(tmp_path)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EIO, errno.ESTALE, errno.ELOOP])
def test_only_absence_is_absence(tmp_path, monkeypatch, number):
    there = touched(tmp_path, b"there.off")
    paths = [
        there,
        *(os.fspath(tmp_path / name) for name in ("none.off", "there.off/none.off", "unknown.off", "link.off")),
    ]
    (tmp_path / "link.off").symlink_to("nowhere")
    denied(monkeypatch, "lstat", paths[3], number)
    assert missing_files(paths) == ({paths[1], paths[2]}, {paths[3]: os.strerror(number)})
