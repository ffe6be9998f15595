"""The tables of an index, of Lance: ``models`` and ``failures``, one row a file, and ``basis``.

Lance writes each change as new files and a manifest that is put in place last, so that an index is at every moment in
the state before or after a change.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._printable import encodable
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.files import is_uri, lance_options, list_objects
from fsh3d_o3d.index.checksums import CHECKSUM, FOLDER, FileChecksums, row_checksums
from fsh3d_o3d.index.columns import column, is_one_of
from fsh3d_o3d.index.durability import DiskSync
from fsh3d_o3d.index.errors import ShapeIndexError, translated
from fsh3d_o3d.index.folder import is_unmade, names_in, require_format
from fsh3d_o3d.index.roots import LibraryRoots
from fsh3d_o3d.index.schema import basis_table, failure_schema, model_schema, read_basis, root_schema
from fsh3d_o3d.index.sketch_basis import sketch_basis
from fsh3d_o3d.index.version import TableVersion

Result = TypeVar("Result")

FORMAT = 3
"""Version of the tables; raised whenever older code would misread them."""
_WRITE_ATTEMPTS = 20  # to write while others do, each of which can be the faster one once
_PATHS_A_QUERY = 500  # so that a condition stays some ten thousand characters; a choice
_READ_ATTEMPTS = 4  # of versions that others remove meanwhile; one replaced just now is seldom removed
_TABLES = {"basis.lance", "failures.lance", "roots.lance", "models.lance", FOLDER}
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_KEPT_SECONDS = 3600  # for which a version stays readable, longer than any query runs
_OLD_SHARE = 1.5  # times the bytes of today's rows: where old versions hold more, they are removed
_SPACE_ALWAYS_LEFT = 2**20  # bytes that old versions may hold in any case
_SMALL_FRAGMENTS = 48  # that are put together; fewer do no harm to a search


class IndexStore:
    """The tables of one index, opened. What it returns are Arrow tables and NumPy arrays."""

    def __init__(
        self, path: str, database: Any, models: Any, failures: Any, roots: Any, basis: NDArray[np.float16]
    ) -> None:
        self.path = path
        """Where it is."""
        self.models = models
        """Lance's table of what was described, to write to; it is read by ``latest``."""
        self.failures = failures
        """Lance's table of what was not, to write to."""
        self._roots = roots
        self._placed: tuple[TableVersion, LibraryRoots] | None = None
        self.basis = basis
        """(d, SKETCH_LENGTH): what sketches are made with."""
        self.metadata = {key.decode(): value.decode() for key, value in (models.schema.metadata or {}).items()}
        """What the tables were made with: ``format``, ``option``, each after ``fsh3d.``."""
        self._database = database
        self._files = FileChecksums(path)
        self._disk = DiskSync(path)
        self._reading = threading.Lock()  # of what follows
        self._held: dict[str, TableVersion] = {}
        self._watched: dict[str, Any] = {}
        self._writing = threading.RLock()  # handles are moved on by writing

    @classmethod
    def open(cls, path: str, option: SHDOption | None) -> IndexStore:
        """Open an index; with an option, make it first where there is none.

        Raises:
            FileNotFoundError: There is none, and no option.
            ShapeIndexError: The folder holds something else, a damaged index, or one of a newer version.
            OSError: It cannot be made.
        """
        if encodable(path) != path or _CONTROL.search(path):  # Lance takes no others
            raise ShapeIndexError(
                f"{path}: the name of an index, and of its folder, must be UTF-8 without control characters"
            )
        names = names_in(path)
        there = names is not None and "models.lance" in names and not is_unmade(path)
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
                database.create_table("basis", basis_table(sketch_basis(option)), exist_ok=True)
                database.create_table("failures", schema=failure_schema(), exist_ok=True)
                database.create_table("roots", schema=root_schema(), exist_ok=True)
                database.create_table("models", schema=model_schema(option, FORMAT), exist_ok=True)
            files = FileChecksums(path)
            for name in () if is_uri(path) else ("basis", "failures", "roots", "models"):
                newest = files.newest(name)
                if newest is not None and there:
                    files.require(name, newest)
                elif newest is not None:
                    DiskSync(path).table(name)
                    files.write(name, newest)
            models = database.open_table("models")
            require_format(path, (models.schema.metadata or {}).get(b"fsh3d.format", b"").decode(), FORMAT)
            failures, roots = database.open_table("failures"), database.open_table("roots")
            return cls(path, database, models, failures, roots, read_basis(path, database.open_table("basis")))

    def roots(self) -> LibraryRoots:
        """Return where the libraries lie now."""
        return self.reading(self._read_roots, "roots")

    def _read_roots(self, version: TableVersion) -> LibraryRoots:
        placed = self._placed
        if placed is None or placed[0] is not version:
            found = version.checked().to_pydict()
            locations = dict(zip(found["path"], map(os.fsdecode, found["location"]), strict=True))
            placed = self._placed = (version, LibraryRoots(self.path, locations))
        return placed[1]

    def place_library(self, own: bytes, folder: str) -> None:
        """Put down where a library lies; ``own`` is what the paths in its rows begin with."""
        self.put(self._roots, {"path": [own], "location": [os.fsencode(folder)]})

    def refresh(self) -> int:
        """See what others have written meanwhile; returns the version of the models."""
        with self._writing, translated(self.path, "reading it"):
            self.failures.checkout_latest()
            self._roots.checkout_latest()
            self.models.checkout_latest()
            return int(self.models.version)

    def latest(self, table: str = "models") -> TableVersion:
        """Return the newest version of ``"models"`` or ``"failures"``; the same object as long as it is.

        Raises:
            ShapeIndexError: It is damaged.
        """
        return self.reading(lambda version: version, table)

    def _opened(self, table: str, number: int) -> TableVersion:
        with self._reading:
            held = self._held.get(table)
            if held is None or held.number != number:
                self._files.require(table, number)
                with translated(self.path, "reading it"):
                    # A handle of its own: a shared one would be moved on under the threads that read it.
                    handle = self._database.open_table(table)
                    handle.checkout(number)
                    held = TableVersion(self.path, number, handle, int(handle.count_rows()))
                self._held[table] = held
            return held

    def reading(self, work: Callable[[TableVersion], Result], table: str = "models") -> Result:
        """Return what ``work`` makes of the newest version of a table; again if others remove it meanwhile.

        Raises:
            ShapeIndexError: The index is damaged, or was rewritten again and again while it was read.
        """
        for attempt in range(_READ_ATTEMPTS):
            number = self._number(table)
            try:
                # Opening it is part of the trial: others may remove a version as soon as there is a newer one.
                return work(self._opened(table, number))
            except ShapeIndexError:
                if attempt == _READ_ATTEMPTS - 1 or self._number(table) == number:
                    raise
        raise AssertionError  # not reached

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

    def columns(self, table: Any, names: Sequence[str]) -> Any:
        """Return some columns of all rows of a table, and ``_rowid``, as an Arrow table."""
        return self.reading(lambda version: version.columns(names), table.name)

    def where(self, column: str, values: Sequence[bytes], names: Sequence[str]) -> Any:
        """Return the models whose column holds one of these values, as an Arrow table; their checksums fit."""
        return self.reading(lambda models: models.checked_where(column, values)).select(list(names))

    def put(self, table: Any, *parts: Mapping[str, Any]) -> None:
        """Insert rows, or replace those of the same paths, in one commit; each part maps the columns to values.

        Checksums are computed here.
        """
        pa = import_installed("pyarrow")

        fields = [field for field in table.schema if field.name != CHECKSUM]
        data = pa.concat_tables(
            [pa.table({field.name: column(part[field.name], field.type) for field in fields}) for part in parts]
        )
        data = data.append_column(CHECKSUM, pa.array(row_checksums(data))).select(table.schema.names)
        merge = table.merge_insert("path").when_matched_update_all().when_not_matched_insert_all()
        self.commit(table, lambda: merge.execute(data.cast(table.schema)), "writing to it")

    def remove(self, table: Any, paths: Sequence[bytes]) -> None:
        """Delete the rows of these paths."""
        for start in range(0, len(paths), _PATHS_A_QUERY):
            condition = is_one_of("path", paths[start : start + _PATHS_A_QUERY])
            self.commit(table, functools.partial(table.delete, condition), "writing to it")

    def commit(self, table: Any, call: Callable[[], Any], doing: str) -> None:
        """Change a table by a call to Lance; when this returns, the change is on the disk.

        Lance waits for no disk. If the power fails after its commit and before the end of this, the version may be
        there without all of its data. An object storage has what it has acknowledged.

        Raises:
            OSError: It cannot be written.
            ShapeIndexError: It is damaged.
        """
        with self._writing:
            with translated(self.path, doing):
                _retried(table, call)
                number = int(table.version)
            if not is_uri(self.path):
                self._disk.table(table.name)
                self._files.write(table.name, number)

    def tidy(self) -> bool:
        """Put small fragments together and forget old versions, where that is worth it; whether models were moved."""
        from datetime import timedelta

        moved = False
        for name, table in (("models", self.models), ("failures", self.failures)):
            with translated(self.path, "compacting it"):
                table.checkout_latest()
                about = table.stats()
            many = about["fragment_stats"]["num_small_fragments"] > _SMALL_FRAGMENTS
            if many or self._old_bytes(name) > _OLD_SHARE * (about["total_bytes"] + _SPACE_ALWAYS_LEFT):
                kept = timedelta(seconds=_KEPT_SECONDS)
                self.commit(table, functools.partial(table.optimize, cleanup_older_than=kept), "compacting it")
                moved = moved or table is self.models
                self._files.tidy(name)
        return moved

    def _number(self, table: str) -> int:
        with self._reading:
            return self._newest(table)

    def _newest(self, table: str) -> int:
        """The number of a table's newest version, by the files' names: what stands in a file may be damaged."""
        newest = None if is_uri(self.path) else self._files.newest(table)
        if newest is None:
            with translated(self.path, "reading it"):
                if table not in self._watched:
                    self._watched[table] = self._database.open_table(table)
                self._watched[table].checkout_latest()
                newest = int(self._watched[table].version)
        return newest

    def _old_bytes(self, name: str) -> int:
        """Size of a table's rows on disk, those of versions before included, that nobody can be reading any more."""
        folder = os.path.join(self.path, f"{name}.lance", "data")  # noqa: PTH118 - keeps bytes that are not UTF-8
        if is_uri(folder):
            found = [(one.size, one.mtime) for one in list_objects(folder, recursive=False)]
        elif os.path.isdir(folder):  # noqa: PTH112
            found = []
            for file in os.scandir(folder):
                with contextlib.suppress(FileNotFoundError):  # removed by another process that tidies up
                    found.append((file.stat().st_size, file.stat().st_mtime_ns))
        else:
            return 0
        limit = time.time_ns() - _KEPT_SECONDS * 10**9
        return sum(size for size, changed in found if changed < limit)


def _retried(table: Any, call: Any) -> None:
    """Call; again where another writer was faster and Lance says so."""
    for attempt in range(_WRITE_ATTEMPTS):
        try:
            call()
            return
        except (RuntimeError, ValueError, OSError) as error:  # noqa: PERF203 - the loop is of attempts
            if "conflict" not in str(error).lower() or attempt == _WRITE_ATTEMPTS - 1:
                raise
            table.checkout_latest()


def _lancedb() -> Any:
    # Its notes on partitions that stay empty are of no use to who indexes a library.
    os.environ.setdefault("LANCEDB_LOG", "error")
    return import_installed("lancedb")  # takes a second or more
