"""The tables of an index, of Lance: ``models`` and ``failures``, one row a file, and ``basis`` (private).

Lance writes each change as new files and a manifest that is put in place last, so that an index is at every moment in
the state before or after a change. ``path`` is its unenforced primary key: with it, and only with it, two writers that
insert the same path at the same moment notice, and one of them tries again.
"""

from __future__ import annotations

import errno
import functools
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.adapters._object_storage import folder_names, is_uri, lance_options, list_objects
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.retrieval._index_codec import SKETCH_LENGTH, signature_type
from fsh3d_o3d.retrieval._index_errors import ShapeIndexError, translated
from fsh3d_o3d.retrieval._sketch_basis import sketch_basis

FORMAT = 2
"""Version of the tables; raised whenever older code would misread them."""
_KEY = {"lance-schema:unenforced-primary-key": "true"}
_ATTEMPTS = 20  # to write while others do
_PATHS_A_QUERY = 500
_ROWS_A_BATCH = 4096
_TABLES = {"failures.lance", "basis.lance", "models.lance"}
_KEPT_SECONDS = 3600  # for which a version stays readable
_WASTE = 1.5  # times the rows there are: then versions before are removed
_LITTLE = 2**20  # bytes that nobody minds
_SMALL_FRAGMENTS = 48  # that are put together; fewer do no harm


class IndexStore:
    """The tables of one index, opened. What it returns are Arrow tables and NumPy arrays."""

    def __init__(self, path: str, models: Any, failures: Any, basis: NDArray[np.float16]) -> None:
        self.path = path
        """Where it is."""
        self.models = models
        """Lance's table of what was described."""
        self.failures = failures
        """Lance's table of what was not."""
        self.basis = basis
        """(d, SKETCH_LENGTH): what sketches are made with."""
        self.metadata = {key.decode(): value.decode() for key, value in (models.schema.metadata or {}).items()}
        """What the tables were made with: ``format``, ``option``, each after ``fsh3d.``."""

    @classmethod
    def open(cls, path: str, option: SHDOption | None) -> IndexStore:
        """Open an index; with an option, make it first where there is none.

        Raises:
            FileNotFoundError: There is none, and no option.
            ShapeIndexError: The folder holds something else, a damaged index, or one of a newer version.
            OSError: It cannot be made.
        """
        names = _names(path)
        there = names is not None and "models.lance" in names and not _unmade(path)
        if not there and option is None:
            if names is not None:
                raise ShapeIndexError(f"{path}: this folder is no index")
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        if not there and not (names or set()) <= _TABLES:  # of an index whose making was interrupted
            raise ShapeIndexError(f"{path}: there is something else here, and no index is made over it")
        with translated(path, "opening it"):
            database = _lancedb().connect(path, storage_options=lance_options(path))
            if not there and option is not None:
                # Models last: where they are, there is all.
                database.create_table("basis", _basis_table(sketch_basis(option)), exist_ok=True)
                database.create_table("failures", schema=_failure_schema(), exist_ok=True)
                database.create_table("models", schema=_model_schema(option), exist_ok=True)
            models = database.open_table("models")
            store_format = (models.schema.metadata or {}).get(b"fsh3d.format", b"").decode()
            if store_format.isdigit() and int(store_format) > FORMAT:
                raise ShapeIndexError(
                    f"{path}: the index has format {store_format}, made by a newer version of fsh3d_o3d; "
                    f"this one reads up to {FORMAT}"
                )
            if store_format.isdigit() and int(store_format) < FORMAT:
                raise ShapeIndexError(
                    f"{path}: the index has format {store_format}, made by an older version of fsh3d_o3d; "
                    "index the library anew"
                )
            if store_format != str(FORMAT):
                raise ShapeIndexError(f"{path}: this folder is no index of fsh3d_o3d")
            basis = database.open_table("basis").search().limit(SKETCH_LENGTH).to_arrow().sort_by("number")
            return cls(path, models, database.open_table("failures"), vectors(basis["direction"], np.float16).T)

    def refresh(self) -> int:
        """See what others have written meanwhile; returns the version of the models."""
        with translated(self.path, "reading it"):
            self.failures.checkout_latest()
        return self.newest()

    def newest(self) -> int:
        """See which models others have written meanwhile, but not their failures; returns the version."""
        with translated(self.path, "reading it"):
            self.models.checkout_latest()
            return int(self.models.version)

    def require_writable(self) -> None:
        """Find out before the work whether rows can be written after it.

        Raises:
            PermissionError: They cannot. Of object storage, only the first write can tell.
        """
        if is_uri(self.path):
            return
        for name in ("models", "failures"):
            folder = os.path.join(self.path, f"{name}.lance", "_versions")  # noqa: PTH118 - keeps bytes that are not UTF-8
            if not os.access(folder, os.W_OK, effective_ids=True):
                raise PermissionError(errno.EACCES, "the index is read-only", self.path)

    def count(self) -> int:
        """Return the number of models."""
        with translated(self.path, "reading it"):
            return int(self.models.count_rows())

    def batches(self, names: Sequence[str]) -> Iterator[Any]:
        """Yield some columns of all models, and ``_rowid``, as Arrow tables of some thousand rows."""
        pa = import_installed("pyarrow")

        with translated(self.path, "reading it"):
            search = self.models.search().select(list(names)).with_row_id(True).limit(self.models.count_rows() or 1)
            for batch in search.to_batches(batch_size=_ROWS_A_BATCH):
                yield pa.Table.from_batches([batch])

    def columns(self, table: Any, names: Sequence[str]) -> Any:
        """Return some columns of all rows, and ``_rowid``, as an Arrow table."""
        with translated(self.path, "reading it"):
            return table.search().select(list(names)).with_row_id(True).limit(table.count_rows() or 1).to_arrow()

    def rows(self, identifiers: Iterable[int], names: Sequence[str]) -> Any:
        """Return the rows of these ``_rowid``, in their order, as an Arrow table."""
        wanted = np.fromiter(identifiers, dtype=np.int64)
        with translated(self.path, "reading it"):
            found = self.models.take_row_ids(wanted.tolist()).select(list(names)).with_row_id().to_arrow()
        place = {row: index for index, row in enumerate(found["_rowid"].to_pylist())}
        return found.take([place[row] for row in wanted.tolist()])

    def where(self, column: str, values: Sequence[bytes], names: Sequence[str]) -> Any:
        """Return the models whose column holds one of these values, as an Arrow table."""
        condition = _is_one_of(column, values)
        with translated(self.path, "reading it"):
            return self.models.search().where(condition).select(list(names)).limit(self.models.count_rows()).to_arrow()

    def put(self, table: Any, *parts: Mapping[str, Any]) -> None:
        """Insert rows, or replace those of the same paths, in one commit; each part maps the columns to values."""
        pa = import_installed("pyarrow")

        schema = table.schema
        tables = [
            pa.table({field.name: _column(part[field.name], field.type) for field in schema}, schema=schema)
            for part in parts
        ]
        data = pa.concat_tables(tables)
        merge = table.merge_insert("path").when_matched_update_all().when_not_matched_insert_all()
        with translated(self.path, "writing to it"):
            _retried(table, lambda: merge.execute(data))

    def remove(self, table: Any, paths: Sequence[bytes]) -> None:
        """Delete the rows of these paths."""
        for start in range(0, len(paths), _PATHS_A_QUERY):
            condition = _is_one_of("path", paths[start : start + _PATHS_A_QUERY])
            with translated(self.path, "writing to it"):
                _retried(table, functools.partial(table.delete, condition))

    def tidy(self) -> bool:
        """Put small fragments together and forget old versions, where that is worth it; whether models were moved."""
        from datetime import timedelta

        moved = False
        for name, table in (("models", self.models), ("failures", self.failures)):
            with translated(self.path, "compacting it"):
                table.checkout_latest()
                about = table.stats()
                many = about["fragment_stats"]["num_small_fragments"] > _SMALL_FRAGMENTS
                if many or self._old_bytes(name) > _WASTE * (about["total_bytes"] + _LITTLE):
                    kept = timedelta(seconds=_KEPT_SECONDS)
                    _retried(table, functools.partial(table.optimize, cleanup_older_than=kept))
                    moved = moved or table is self.models
        return moved

    def _old_bytes(self, name: str) -> int:
        """Size of a table's rows on disk, those of versions before included, that nobody can be reading any more."""
        folder = os.path.join(self.path, f"{name}.lance", "data")  # noqa: PTH118 - keeps bytes that are not UTF-8
        if is_uri(folder):
            found = [(one.size, one.mtime) for one in list_objects(folder, recursive=False)]
        elif os.path.isdir(folder):  # noqa: PTH112
            found = [(about.st_size, about.st_mtime_ns) for about in (file.stat() for file in os.scandir(folder))]
        else:
            return 0
        limit = time.time_ns() - _KEPT_SECONDS * 10**9
        return sum(size for size, changed in found if changed < limit)


def _basis_table(basis: NDArray[np.float16]) -> Any:
    pa = import_installed("pyarrow")

    return pa.table({"number": pa.array(range(basis.shape[1]), pa.int32()), "direction": fixed_lists(basis.T)})


def vectors(column: Any, dtype: Any) -> NDArray[Any]:
    """Return a column of fixed-size lists (n, k), of an Arrow table, as an array."""
    length = column.type.list_size
    parts = [chunk.flatten().to_numpy().reshape(-1, length) for chunk in column.chunks]
    return np.concatenate([np.empty((0, length), dtype=dtype), *parts], dtype=dtype, casting="unsafe")


def fixed_lists(rows: NDArray[Any]) -> Any:
    """Return an array (n, k) as a fixed-size list column."""
    pa = import_installed("pyarrow")

    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(rows).ravel()), rows.shape[1])


def _column(values: Any, kind: Any) -> Any:
    pa = import_installed("pyarrow")

    return values.cast(kind) if isinstance(values, pa.ChunkedArray) else pa.array(values, kind)


def _retried(table: Any, call: Any) -> None:
    """Call; again where another writer was faster and Lance says so."""
    for attempt in range(_ATTEMPTS):
        try:
            call()
            return
        except (RuntimeError, ValueError, OSError) as error:  # noqa: PERF203 - the loop is of attempts
            if "conflict" not in str(error).lower() or attempt == _ATTEMPTS - 1:
                raise
            table.checkout_latest()


def _unmade(path: str) -> bool:
    """Whether the making of the models' table was cut off before its first manifest: it then has no data, either."""
    table = os.path.join(path, "models.lance")  # noqa: PTH118 - keeps bytes that are not UTF-8
    return not any(_names(os.path.join(table, part)) for part in ("_versions", "data"))  # noqa: PTH118


def _names(path: str) -> set[str] | None:
    """What a folder holds; None if there is none."""
    if is_uri(path):
        return folder_names(path) or None
    if os.path.isfile(path):  # noqa: PTH113 - keeps bytes that are not UTF-8
        raise ShapeIndexError(f"{path}: this is a file, not the folder of an index")
    return set(os.listdir(path)) if os.path.isdir(path) else None  # noqa: PTH112, PTH208 - same


def _is_one_of(column: str, values: Sequence[bytes]) -> str:
    return f"{column} IN ({', '.join(f'X{value.hex()!r}' for value in values)})"


def _lancedb() -> Any:
    # Its notes on partitions that stay empty are of no use to who indexes a library.
    os.environ.setdefault("LANCEDB_LOG", "error")
    return import_installed("lancedb")  # takes a second or more


def _model_schema(option: SHDOption) -> Any:
    pa = import_installed("pyarrow")

    fields = [
        pa.field("path", pa.binary(), nullable=False, metadata=_KEY),  # the file's, absolute, whatever its bytes
        pa.field("content", pa.binary(32)),  # SHA-256
        pa.field("identity", pa.binary()),  # content, and how it is read
        pa.field("size", pa.int64()),
        pa.field("mtime", pa.int64()),  # nanoseconds
        pa.field("vertices", pa.int64()),
        pa.field("triangles", pa.int64()),  # 0: a cloud
        pa.field("watertight", pa.bool_()),
        pa.field("option", pa.string()),  # fingerprint
        pa.field("signature", pa.binary(signature_type(option).itemsize)),
        pa.field("sketch", pa.list_(pa.float16(), SKETCH_LENGTH)),
        pa.field("thumbnail", pa.binary()),  # PNG
    ]
    return pa.schema(fields, metadata={"fsh3d.format": str(FORMAT), "fsh3d.option": option.fingerprint})


def _failure_schema() -> Any:
    pa = import_installed("pyarrow")

    fields = [
        pa.field("path", pa.binary(), nullable=False, metadata=_KEY),
        pa.field("size", pa.int64()),
        pa.field("mtime", pa.int64()),
        pa.field("reason", pa.string()),
    ]
    return pa.schema(fields)
