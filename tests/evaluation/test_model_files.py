"""Models by id in any folder layout."""

from __future__ import annotations

import os

import pytest

from fsh3d_o3d.evaluation.model_files import find_models


def place(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


@pytest.mark.parametrize(
    "name",
    [
        "123.off",
        "m123.off",
        "M123.OFF",
        "1/m123/m123.ply",
        "a/b/c/123.Obj",
        "models/m123.stl",
        "ü ö/123.glb",
    ],
)
@pytest.mark.parametrize("model", ["123", "m123"])
def test_layouts(tmp_path, name, model):
    place(tmp_path, name, "m1234.off", "12.off", "m123.txt", "m123_thumb.jpg", "mm123.off", "m123")
    result = find_models(tmp_path, [model])
    assert result.paths == {model: tmp_path / name}
    assert result.missing == ()
    assert result.ambiguous == {}


def test_named_models(tmp_path):
    place(tmp_path, "Chair_01.off", "deep/m-x.PLY", "mask.stl")
    assert set(find_models(tmp_path, ["chair_01", "m-x", "mask", "ask"]).paths) == {"chair_01", "m-x", "mask"}


def test_missing_and_ambiguous(tmp_path):
    place(tmp_path, "1.off", "m1.ply", "2.off", "old/2.off", "3.off")
    result = find_models(tmp_path, ["1", "2", "3", "4", "5"])
    assert result.paths == {"3": tmp_path / "3.off"}
    assert result.missing == ("4", "5")
    assert result.ambiguous == {
        "1": (tmp_path / "1.off", tmp_path / "m1.ply"),
        "2": (tmp_path / "2.off", tmp_path / "old" / "2.off"),
    }


def test_links(tmp_path):
    place(tmp_path / "library", "sub/1.off")
    place(tmp_path / "elsewhere", "2.off")
    (tmp_path / "library/sub/loop").symlink_to(tmp_path / "library")
    (tmp_path / "library/self").symlink_to("self")
    (tmp_path / "library/linked").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "library/linked_again").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "library/3.off").symlink_to(tmp_path / "elsewhere/2.off")
    result = find_models(tmp_path / "library", ["1", "2", "3"])
    assert result.paths == {
        "1": tmp_path / "library/sub/1.off",
        "2": tmp_path / "library/linked/2.off",
        "3": tmp_path / "library/3.off",
    }


def test_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        find_models(tmp_path / "none", ["1"])
    place(tmp_path, "1.off")
    with pytest.raises(NotADirectoryError):
        find_models(tmp_path / "1.off", ["1"])


def test_a_folder_that_cannot_be_listed_is_named(tmp_path, monkeypatch):
    place(tmp_path, "1.off", "closed/2.off")
    listed = os.scandir

    def scandir(path):
        if os.fspath(path).endswith("closed"):
            raise PermissionError(13, "Permission denied", os.fspath(path))
        return listed(path)

    monkeypatch.setattr(os, "scandir", scandir)  # permissions do not stop the superuser, who may run the tests
    with pytest.warns(UserWarning, match="closed: Permission denied"):
        result = find_models(tmp_path, ["1", "2"])
    assert set(result.paths) == {"1"}
    assert result.missing == ("2",)
