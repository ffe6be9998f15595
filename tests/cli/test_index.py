"""``fsh3d index`` and ``fsh3d query`` as a user runs them."""

from __future__ import annotations

import base64
import dataclasses
import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from fsh3d_o3d.cli import main
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.index import Hit
from tests.geometry.mesh_shapes import screw
from tests.index.index_cases import write_library

HOSTILE = b"<img src=x onerror=alert(1)>'\"\n\x1b[31m\xff.off"


@pytest.fixture(scope="module")
def indexed(tmp_path_factory):
    """A library with a hostile name and a broken file, indexed with pictures."""
    root = tmp_path_factory.mktemp("indexed")
    paths = write_library(root / "library", range(4))
    shutil.copy(paths[2], root / "library" / os.fsdecode(HOSTILE))
    (root / "library" / "broken.off").write_text("not a mesh")
    assert run("index", root / "library", root / "index", "--option", "energies", "--workers", "1") == 1
    return root


def run(*arguments):
    return main(list(map(str, arguments)))


def test_second_run_adds_nothing_and_lists_failures_again(indexed, capsys):
    assert run("index", indexed / "library", indexed / "index", "--json") == 1
    out, err = capsys.readouterr()
    values = json.loads(out)
    assert {name: values[name] for name in ("models", "added", "moved", "unchanged", "removed")} == {
        "models": 5,
        "added": 0,
        "moved": 0,
        "unchanged": 5,
        "removed": 0,
    }
    assert [Path(failed["path"]).name for failed in values["failed"]] == ["broken.off"]
    assert err.count("\n") == 1
    assert err.startswith(f"fsh3d: failed: {indexed / 'library' / 'broken.off'}: ")


def test_query_prints_hits(indexed, capsys):
    query = indexed / "library" / "blob2.off"
    assert run("query", indexed / "index", query, "--top", "3", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["query"] == str(query)
    assert [hit["rank"] for hit in answer["hits"]] == [1, 2, 3]
    assert all(set(hit) == {field.name for field in dataclasses.fields(Hit)} for hit in answer["hits"])
    assert all(base64.b64decode(hit["thumbnail"]).startswith(b"\x89PNG") for hit in answer["hits"])
    distances = [hit["distance"] for hit in answer["hits"]]
    assert distances == sorted(distances)
    # The file and its copy under the hostile name: the same distance, up to the rounding of the alignment.
    assert {os.fsencode(Path(hit["path"]).name) for hit in answer["hits"][:2]} == {b"blob2.off", HOSTILE}
    assert max(distances[:2]) < 1e-3
    assert run("query", indexed / "index", query, "--top", "2") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3  # the newline in the name does not end one
    assert "\x1b" not in "".join(lines)


def test_folder_of_queries(indexed, tmp_path, capsys):
    write_library(tmp_path / "queries", [1, 3])
    (tmp_path / "queries" / "broken.off").write_text("not a mesh")
    page = tmp_path / "page.html"
    assert run("query", indexed / "index", tmp_path / "queries", "--json", "--report", page) == 1
    out, err = capsys.readouterr()
    answers = [json.loads(line) for line in out.splitlines()]
    assert [Path(answer["hits"][0]["path"]).name for answer in answers] == ["blob1.off", "blob3.off"]
    assert "broken.off" in err
    assert page.read_text(encoding="utf-8").count('<section class="result"') == 2


def test_near_duplicates(indexed, capsys):
    assert run("query", indexed / "index", "--near-duplicates", "--json") == 0
    (pair,) = json.loads(capsys.readouterr().out)["pairs"]
    assert {os.fsencode(Path(pair[name]).name) for name in ("first", "second")} == {b"blob2.off", HOSTILE}
    assert pair["distance"] == 0
    assert run("query", indexed / "index", "--near-duplicates") == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 1
    assert "1 pairs within 0.05 among 5 models" in err


def test_mirror_images_are_marked(tmp_path, capsys, random_rotation):
    left = screw()
    right = MeshArrays(left.vertices * [1, 1, -1], left.triangles[:, ::-1])
    copy = MeshArrays(2 * left.vertices @ random_rotation.T, left.triangles)
    (tmp_path / "parts").mkdir()
    for name, mesh in (("left.off", left), ("right.off", right), ("copy.ply", copy)):
        write_geometry(tmp_path / "parts" / name, mesh)
    assert run("index", tmp_path / "parts", tmp_path / "index", "--no-thumbnails", "--workers", "1", "--quiet") == 0
    capsys.readouterr()
    assert run("query", tmp_path / "index", "--near-duplicates", "--limit", "0.2", "--json") == 0
    pairs = json.loads(capsys.readouterr().out)["pairs"]
    found = {frozenset(Path(pair[name]).stem for name in ("first", "second")): pair["mirrored"] for pair in pairs}
    assert found == {
        frozenset({"left", "right"}): True,
        frozenset({"copy", "right"}): True,
        frozenset({"copy", "left"}): False,
    }
    assert run("query", tmp_path / "index", "--near-duplicates", "--limit", "0.2") == 0
    out, err = capsys.readouterr()
    assert sorted(line.endswith("  mirrored") for line in out.splitlines()) == [False, True, True]
    assert "3 pairs within 0.2 among 3 models, 2 of them mirror images" in err


def test_prune(tmp_path, capsys):
    paths = write_library(tmp_path / "library", range(2))
    common = ("index", tmp_path / "library", tmp_path / "index", "--no-thumbnails", "--workers", "1", "--quiet")
    assert run(*common) == 0
    Path(paths[0]).unlink()
    assert run(*common) == 0
    assert "2 models (0 added" in capsys.readouterr().out
    assert run(*common, "--prune") == 0
    assert "1 models (0 added, 0 moved, 1 unchanged, 1 removed, 0 failed)" in capsys.readouterr().out


def test_a_folder_without_permission_is_no_reason_to_forget(tmp_path, capsys, monkeypatch):
    paths = [*write_library(tmp_path / "library", [0]), *write_library(tmp_path / "library" / "closed", [1, 2])]
    common = (
        "index",
        tmp_path / "library",
        tmp_path / "index",
        "--no-thumbnails",
        "--workers",
        "1",
        "--quiet",
        "--prune",
    )
    assert run(*common) == 0
    closed = os.fspath(tmp_path / "library" / "closed")
    for name in ("scandir", "lstat"):
        monkeypatch.setattr(os, name, Denying(getattr(os, name), closed))
    Path(paths[0]).rename(tmp_path / "library" / "renamed.off")
    capsys.readouterr()
    assert run(*common, "--json") == 1
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert (figures["models"], figures["removed"]) == (3, 1)
    reasons = {Path(failed["path"]).name: failed["reason"] for failed in figures["failed"]}
    assert reasons == {"closed": "Permission denied, so its files are not found"}
    assert err == f"fsh3d: failed: {closed}: Permission denied, so its files are not found\n"


class Denying:
    """A function of the system that denies access to what is in a folder."""

    def __init__(self, function, closed):
        self.function, self.closed = function, closed

    def __call__(self, path=".", *arguments, **how):
        listing = self.function.__name__ == "scandir" and os.fspath(path) == self.closed
        if listing or os.path.dirname(os.fspath(path)) == self.closed:  # noqa: PTH120
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return self.function(path, *arguments, **how)


def test_files_of_other_formats_are_named(tmp_path, capsys):
    write_library(tmp_path / "library", [0])
    for name in ("a.blend", "b.DWG", "c.log.gz", "d.dwg", ".DS_Store"):
        (tmp_path / "library" / name).touch()
    common = ("index", tmp_path / "library", tmp_path / "index", "--no-thumbnails", "--workers", "1", "--quiet")
    assert run(*common) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["4 files of other formats: .dwg 2, .blend 1, .gz 1"]
    assert run(*common, "--json") == 0
    assert json.loads(capsys.readouterr().out)["other_formats"] == {".dwg": 2, ".blend": 1, ".gz": 1}
    for number in range(12):
        (tmp_path / "library" / f"x.e{number}").touch()
    assert run(*common) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith(", .e4 1, .e5 1, and 5 of 5 further extensions")


@pytest.mark.parametrize("command", ["index", "query"])
def test_a_folder_where_nothing_can_be_read_is_no_success(indexed, tmp_path, capsys, command):
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "a.blend").touch()
    (tmp_path / "library" / "link").symlink_to(indexed)
    folders = (
        [tmp_path / "library", tmp_path / "new"] if command == "index" else [indexed / "index", tmp_path / "library"]
    )
    assert run(command, *folders) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        f"fsh3d: error: {tmp_path / 'library'}: no meshes or point clouds in this folder "
        "(1 file of other formats: .blend 1; 1 symbolic link, not followed)\n"
    )
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["index", "none", "index"], "none: No such file"),
        (["query", "none", "x.off"], "none: No such file"),
        (["query", "INDEX"], "give either a file"),
        (["query", "INDEX", "x.off", "--near-duplicates"], "give either a file"),
        (["query", "INDEX", "none.off"], "No such file"),
        (["query", "INDEX", "QUERY", "--report", "page.txt"], "must end in .html"),
        (["query", "INDEX", "QUERY", "--report", "no/such/page.html"], "there is no folder"),
        (["query", "INDEX", "QUERY", "--top", "0"], "top must be between"),
        (["query", "INDEX", "--near-duplicates", "--report", "page.html"], "--report shows"),
        (["query", "LIBRARY", "QUERY"], "no index"),
        (["index", "LIBRARY", "INDEX", "--option", "best"], "not made with the option given"),
    ],
)
def test_mistakes(indexed, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    places = {"INDEX": "index", "LIBRARY": "library", "QUERY": "library/blob1.off"}
    given = [indexed / places[name] if name in places else name for name in arguments]
    assert run(*given) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert message in err
