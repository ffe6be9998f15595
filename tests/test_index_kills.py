"""The endurance test of the index runs, and notices what it looks for."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import index_kills
from benchmarks._changing_library import ChangingLibrary, identity_of
from benchmarks.index_kills import Content, examine
from fsh3d_o3d.cli import main
from fsh3d_o3d.index.shape_index import ShapeIndex
from tests.index.index_cases import write_library


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A library of three models and a broken file, its index, and the models."""
    root = tmp_path_factory.mktemp("kills")
    paths = write_library(root / "library", range(3))
    (root / "library" / "broken.off").write_text("not a mesh")
    arguments = ["--option", "energies", "--no-thumbnails", "--workers", "1"]
    assert main(["index", str(root / "library"), str(root / "index"), *arguments]) == 1
    models = frozenset((path, identity_of(Path(path))[0]) for path in map(os.path.realpath, paths))
    return root, models, arguments


def copied(case, tmp_path) -> str:
    return os.fspath(shutil.copytree(case[0] / "index", tmp_path / "index"))


def test_two_kills(case, tmp_path, capsys):
    arguments = ["--models", str(case[0] / "library"), "--kills", "2", "--output", str(tmp_path), *case[2]]
    assert index_kills.main(arguments) == 0
    report = json.loads((tmp_path / "index_kills.json").read_text(encoding="utf-8"))
    assert (report["models"], report["failures"], len(report["kills"]), report["problems"]) == (3, 1, 2, [])
    figures = report["figures"]
    assert figures["kills"] == figures["start-up"] + figures["filling"] + figures["end"] == 2
    assert figures["indices completed"] >= 1
    assert figures["changes of the library"] >= 2
    assert (figures["opened every time"], figures["duplicates"], figures["lost models"]) == (True, 0, 0)
    assert all(0 < kill["seconds"] < 60 for kill in report["kills"])
    assert "kill 2: " in capsys.readouterr().out


def test_a_sound_index(case):
    found = examine(str(case[0] / "index"), case[1])
    assert (found.made, found.models, found.problems) == (True, case[1], ())
    assert [os.path.basename(path) for path, _ in found.failures] == ["broken.off"]  # noqa: PTH119
    assert index_kills._differences(found, found) == []


def test_what_is_twice_lost_or_damaged_is_noticed(case, tmp_path):
    index = copied(case, tmp_path)
    store = ShapeIndex.open(index)._store
    store.models.add(store.models.search().limit(1).to_arrow())
    store.failures.add(store.failures.search().limit(1).to_arrow())
    problems = examine(index, case[1] | {("~gone", "")}).problems
    assert [text.partition(":")[0] for text in problems] == ["twice in the models", "twice in the failures", "lost"]
    store.remove(store.models, store.columns(store.models, ["path"])["path"].to_pylist())
    assert len(examine(index, case[1]).problems) == 4  # three models, and the failure that is there twice
    shutil.rmtree(tmp_path / "index" / "models.lance" / "_versions")
    (problem,) = examine(index, case[1]).problems
    assert problem.startswith("does not open: ")
    assert examine(index).problems == (problem,)


def test_no_index_yet_is_no_problem_unless_there_was_one(case, tmp_path):
    missing = os.fspath(tmp_path / "none")
    assert examine(missing) == Content(False, frozenset(), frozenset(), ())
    (problem,) = examine(missing, case[1]).problems
    assert problem.startswith("does not open: ")
    index = copied(case, tmp_path)
    shutil.rmtree(tmp_path / "index" / "models.lance")  # made last
    assert examine(index).problems == ()
    assert examine(index, case[1]).problems != ()


def test_differences_of_a_complete_index():
    expected = Content(True, frozenset({("a", "1"), ("b", "2")}), frozenset({("c", "broken")}), ())
    found = Content(
        True, frozenset({("b", "3"), ("a", "1")}), frozenset({("c", "was killed")}), ("twice in the models: b",)
    )
    words = [text.partition(":")[0] for text in index_kills._differences(found, expected)]
    assert words == ["twice in the models", "missing, or not its content", "not expected", "other failures"]


def test_workers_are_told_from_other_processes():
    sleep = "import time; print(flush=True); time.sleep(60)"
    start = (
        f"import subprocess, sys; subprocess.run([sys.executable, '-c', {sleep!r}, {index_kills._WORKER.decode()!r}])"
    )
    for program, expected in ((sleep, False), (start, True)):
        writer = index_kills._Writer(
            subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, start_new_session=True), 0, 0
        )
        with writer.process:
            try:
                assert writer.process.stdout.read(1) == b"\n"
                assert index_kills._has_workers(writer.process.pid) is expected
            finally:
                writer.kill()
        assert writer.process.returncode == -9


def test_an_empty_library_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        index_kills.main(["--models", str(tmp_path)])
    assert caught.value.code == 2
    assert "no models" in capsys.readouterr().err


@pytest.mark.parametrize("seed", range(4))
def test_changes_lose_no_content_but_by_replacing(case, tmp_path, seed):
    library = ChangingLibrary(str(case[0] / "library"), tmp_path / "copy", random.Random(seed))
    before = set(library.identities().values())
    names = [name for _ in range(20) for name in library.change()]
    assert len(set(names)) == 8
    after = list(library.identities().values())
    assert set(after) <= before  # nothing but what was there; a replaced one may have been the last of its kind
    assert len(after) == 4 + names.count("a file copied")


def test_changes_are_those_of_the_seed(case, tmp_path):
    found = []
    for name in "ab":
        library = ChangingLibrary(str(case[0] / "library"), tmp_path / name, random.Random(3))
        for _ in range(10):
            library.change()
        found.append([(path.relative_to(library.path), identity_of(path)) for path in library.files()])
    assert found[0] == found[1]
