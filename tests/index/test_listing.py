"""What an index holds can be listed, asked for, counted and taken out."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from fsh3d_o3d.cli import main
from fsh3d_o3d.descriptors.shd import shd_descriptor
from fsh3d_o3d.index.shape_index import IndexedModel, ShapeIndex
from tests.index.index_cases import QUICK, blob, write_library


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("listing")


@pytest.fixture(scope="module")
def paths(root):
    """Three files of a library, a name that is not UTF-8 among them, and a single one; all in an index."""
    paths = write_library(root / "library", range(3))
    hostile = os.fspath(root / "library" / os.fsdecode(b"\xff.off"))
    os.replace(paths[2], hostile)  # noqa: PTH105
    return [*paths[:2], hostile, *write_library(root / "single", [3])]


@pytest.fixture(scope="module")
def index(root, paths):
    index = ShapeIndex.open(root / "index", create=True, option=QUICK)
    broken = root / "library" / "broken.off"
    broken.write_text("not a mesh")
    index.add_files([*paths[:3], broken], workers=1, library=root / "library")
    index.add_files(paths[3:], workers=1)
    return index


def test_models_in_order_of_their_paths(index, paths):
    assert list(index) == sorted(paths)
    assert len(index) == 4
    model = next(model for model in index.models() if model.path == paths[0])
    about = Path(paths[0]).stat()
    assert model == IndexedModel(paths[0], about.st_size, about.st_mtime_ns, 362, 720, True)


def test_what_is_in_it(index, root, paths, monkeypatch):
    assert all(path in index for path in paths)
    assert Path(paths[0]) in index
    monkeypatch.chdir(root / "library")
    assert "blob0.off" in index
    assert "none.off" not in index
    assert root / "library" not in index
    assert 3 not in index


def test_summary(index, root):
    about = index.summary()
    assert (about.models, about.failures, about.single_files, about.searchable) == (4, 1, 1, 0)
    assert about.libraries == {os.fspath(root / "library"): 3}
    assert about.bytes_on_disk == sum(file.stat().st_size for file in (root / "index").rglob("*") if file.is_file())


def expected(paths):
    return {path.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace"): path for path in paths}


def check(names, features, paths):
    assert set(names) == set(expected(paths))
    for name, feature in zip(names, features, strict=True):
        number = {"0": 0, "1": 1, "3": 3}.get(Path(name).stem[-1], 2)
        # One byte a number: the root is off by half a 127th of the largest at most.
        np.testing.assert_allclose(feature, shd_descriptor(blob(number), QUICK), atol=0.01 * np.abs(feature).max())


def test_features_as_numpy(index, paths, tmp_path):
    target = tmp_path / "features.npz"
    target.write_text("before")
    assert index.export_features(target) == 4
    with np.load(target, allow_pickle=False) as found:
        assert found["features"].dtype == np.float32
        assert tuple(found["shape"]) == QUICK.feature_shape
        check([name.decode("utf-8") for name in found["paths"]], found["features"], paths)
    assert zipfile.ZipFile(target).testzip() is None
    assert [path.name for path in tmp_path.iterdir()] == ["features.npz"]


def test_features_as_parquet(index, paths, tmp_path):
    assert index.export_features(tmp_path / "features.parquet") == 4
    table = pyarrow.parquet.read_table(tmp_path / "features.parquet")
    check(table["path"].to_pylist(), np.array(table["feature"].to_pylist(), np.float32), paths)


def test_of_an_empty_index(tmp_path):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    assert list(index) == []
    for name in ("features.npz", "features.parquet"):
        assert index.export_features(tmp_path / name) == 0
    assert np.load(tmp_path / "features.npz")["features"].shape == (0, 144)


def test_what_cannot_be_written(index, tmp_path):
    with pytest.raises(ValueError, match=r"\.npz or \.parquet"):
        index.export_features(tmp_path / "features.csv")
    with pytest.raises(FileNotFoundError):
        index.export_features(tmp_path / "none" / "features.npz")
    assert list(tmp_path.iterdir()) == []


def test_the_command(tmp_path, capsys):
    write_library(tmp_path / "library", range(2))
    index, library = str(tmp_path / "index"), str(tmp_path / "library")
    assert main(["index", library, index, "--option", "energies", "--workers", "1", "--quiet", "--no-thumbnails"]) == 0
    capsys.readouterr()
    assert main(["info", index, "--json", "--export", str(tmp_path / "all.parquet")]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts.pop("bytes_on_disk") > 0
    assert facts == {
        "index": index,
        "kind": "index",
        "option": "energies",
        "format": 3,
        "models": 2,
        "failures": 0,
        "libraries": {library: 2},
        "single_files": 0,
        "searchable": 0,
        "exported": 2,
    }
    assert (tmp_path / "all.parquet").exists()
    assert main(["info", index]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == [
        "kind", "option", "format", "models", "failures", "single", "search", "size", "library",
    ]  # fmt: skip
    assert lines[-1].endswith(f"{library}: 2 models")
    assert main(["info", library]) == 2
    assert "this folder is no index" in capsys.readouterr().err
    assert main(["info", index, "--export", str(tmp_path / "all.csv")]) == 2
    assert main(["info", f"{library}/blob0.off", "--export", str(tmp_path / "all.npz")]) == 2
    assert main(["index", f"{library}/blob0.off", index, "--remove"]) == 0
    assert "1 models (1 removed)" in capsys.readouterr().out
    assert main(["index", f"{library}/blob0.off", index, "--remove"]) == 2
    assert "holds no models of it" in capsys.readouterr().err
