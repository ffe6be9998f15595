"""A byte that changes, wherever it is, is found out: right answers or an error, never a wrong answer."""

from __future__ import annotations

import os
import random
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.index import search
from fsh3d_o3d.index.checksums import FileChecksums, row_checksums
from fsh3d_o3d.index.errors import translated
from fsh3d_o3d.index.shape_index import ShapeIndex, ShapeIndexError
from tests.index.index_cases import QUICK, blob, write_library

FLIPS = 6  # in each file


def picture(geometry) -> bytes:
    return repr(geometry.vertices[:8].tolist()).encode()


def facts(path: Path) -> list[object]:
    """All that an index tells."""
    index = ShapeIndex.open(path, option=QUICK)
    hits = [*index.query(blob(3), top=5), *index.query(blob(5), top=11, rerank=0)]
    found: list[object] = [
        (hit.path, hit.rank, hit.distance, hit.vertices, hit.triangles, hit.watertight, hit.thumbnail) for hit in hits
    ]
    return [
        *found,
        [hit.transformation.tolist() for hit in hits],
        index.near_duplicates(0.3),
        index.failures(),
        len(index),
    ]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """An index of several commits, with deleted rows and a failure."""
    root = tmp_path_factory.mktemp("damage")
    paths = write_library(root / "library", range(12))
    index = ShapeIndex.open(root / "index", create=True, option=QUICK)
    index.add_files(paths[:6], workers=1, thumbnail=picture)
    (root / "library" / "broken.off").write_text("not a mesh")
    index.add_files([*paths[6:], root / "library" / "broken.off"], workers=1, thumbnail=picture)
    Path(paths[0]).unlink()
    assert index.prune() == 1
    return root


@pytest.fixture(params=[5000, 4], ids=["all", "inverted file"])
def index(request, library, tmp_path, monkeypatch):
    """A copy of it; with an inverted file."""
    monkeypatch.setitem(search.IndexSearch.__init__.__kwdefaults__, "exact_below", request.param)
    path = tmp_path / "index"
    shutil.copytree(library / "index", path)
    ShapeIndex.open(path, option=QUICK)._search.index()
    assert (path / "models.lance" / "_indices").exists() == (request.param == 4)
    return path


def test_single_bits_anywhere(index):
    expected = facts(index)
    draw = random.Random(1)
    outcomes: Counter[tuple[str, str]] = Counter()
    for file in sorted(file for file in index.rglob("*") if file.is_file()):
        data = file.read_bytes()
        for _ in range(FLIPS):
            damaged = bytearray(data)
            damaged[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
            file.write_bytes(damaged)
            try:
                assert facts(index) == expected
                outcome = "right"
            except ShapeIndexError as error:
                assert "\n" not in str(error)
                outcome = "said"
            outcomes["/".join(file.relative_to(index).parts[:2]), outcome] += 1
        file.write_bytes(data)
    assert facts(index) == expected
    # Not all of a file matters, but what does must have been met.
    for part in ("basis.lance/data", "models.lance/data", "failures.lance/data", "models.lance/_versions"):
        assert outcomes[part, "said"] > 0, part
    if (index / "models.lance" / "_indices").exists():
        assert outcomes["models.lance/_indices", "said"] > 0


@pytest.mark.parametrize(
    "column", ["path", "content", "thumbnail", "vertices", "mtime", "sketch", "watertight", "signature"]
)
def test_each_column_is_under_the_checksum(library, column):
    store = ShapeIndex.open(library / "index", option=QUICK)._store
    rows = store.latest().checked()
    before = row_checksums(rows)
    values = rows[column].to_pylist()
    other = values[1:] + values[:1]
    if column == "watertight":
        other = [not value for value in values]
    import pyarrow as pa

    place = rows.column_names.index(column)
    changed = rows.set_column(place, column, pa.array(other, rows[column].type))
    differ = np.array([one != two for one, two in zip(values, other, strict=True)])
    np.testing.assert_array_equal(row_checksums(changed) != before, differ)
    # Neither the order of columns, nor what stands in other rows, is part of it.
    np.testing.assert_array_equal(row_checksums(rows.select(rows.column_names[::-1])), before)
    np.testing.assert_array_equal(row_checksums(rows.slice(3, 2)), before[3:5])


def test_no_value_is_another_than_an_empty_one_or_zero():
    import pyarrow as pa

    tables = [
        pa.table({"a": pa.array([number], pa.int64()), "b": pa.array([text], pa.binary())})
        for number in (None, 0)
        for text in (None, b"")
    ]
    assert len({int(row_checksums(table)[0]) for table in tables}) == 4


def test_a_row_with_the_numbers_of_another_is_found_out(library, tmp_path):
    path = tmp_path / "index"
    shutil.copytree(library / "index", path)
    index = ShapeIndex.open(path, option=QUICK)
    assert index.query(blob(3), top=1)
    everything = index._search._kept
    everything.stored.numbers[:] = np.roll(everything.stored.numbers, 1)
    with pytest.raises(ShapeIndexError, match="1 rows do not fit their checksums"):
        index.query(blob(3), top=1)


def test_a_damaged_row_is_not_written_anew_under_another_name(library, tmp_path):
    path, copy = tmp_path / "index", tmp_path / "copy.off"
    shutil.copytree(library / "index", path)
    index = ShapeIndex.open(path, option=QUICK)
    target = library / "library" / "blob4.off"
    rows = index._store.where("path", [os.fsencode(target)], ["thumbnail"])
    thumbnail = rows["thumbnail"][0].as_py()
    for file in (path / "models.lance" / "data").iterdir():
        data = file.read_bytes()
        file.write_bytes(data.replace(thumbnail, thumbnail[:-1] + b"?"))
    shutil.copy(target, copy)
    with pytest.raises(ShapeIndexError, match="checksum"):
        ShapeIndex.open(path, option=QUICK).add_files([copy], workers=1)


def test_versions_without_checksums_are_read(library, tmp_path):
    """A writer that is killed between Lance's commit and ours leaves one."""
    expected = facts(library / "index")
    path = tmp_path / "index"
    shutil.copytree(library / "index", path)
    shutil.rmtree(path / "checksums")
    assert facts(path) == expected
    assert ShapeIndex.open(path, option=QUICK).prune() == 0
    assert FileChecksums(os.fspath(path)).newest("models") is not None
    assert FileChecksums(os.fspath(path)).newest("nothing") is None


@pytest.mark.parametrize("content", [b"", b"[]", b'{"version": 1}', b"[" * 10**5, b"\xff"])
def test_checksums_that_are_none_are_damage(library, tmp_path, content):
    path = tmp_path / "index"
    shutil.copytree(library / "index", path)
    for file in (path / "checksums").iterdir():
        file.write_bytes(content)
    with pytest.raises(ShapeIndexError, match="damaged: checksums of version"):
        ShapeIndex.open(path, option=QUICK)


def test_panics_of_native_code_are_damage():
    class RustPanic(Exception):  # noqa: N818 - that is its name
        pass

    class PanicException(BaseException):
        pass

    class Other(Exception):  # noqa: N818
        pass

    for kind in (RustPanic, PanicException, KeyError, TypeError, OverflowError):
        with pytest.raises(ShapeIndexError, match=r"^/index: the index is damaged"), translated("/index", "reading it"):
            raise kind("called `unwrap()`\non a `None` value")
    for kind in (Other, KeyboardInterrupt, MemoryError):
        with pytest.raises(kind), translated("/index", "reading it"):
            raise kind
