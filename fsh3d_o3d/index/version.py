"""One version of a table of an index: what it holds does not change while it is read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.index.checksums import require_checksums
from fsh3d_o3d.index.columns import is_one_of
from fsh3d_o3d.index.errors import ShapeIndexError, translated

_ROWS_A_BATCH = 4096  # read at once: 40 MB with their thumbnails


@dataclass(frozen=True, eq=False)
class TableVersion:
    """Rows of a table as they were at one moment, whatever is written meanwhile; any number of threads may read it.

    What a query returns comes from one such version from the search to the pictures. Where others have removed its
    files, reading it fails as damage does, and a newer one has to be asked.
    """

    path: str
    """The index."""
    number: int
    """Of the version."""
    table: Any
    """Lance's table, held at the version: nobody may move it on."""
    count: int
    """Rows."""

    def batches(self, names: Sequence[str]) -> Iterator[Any]:
        """Yield some columns of all rows, and ``_rowid``, as Arrow tables of some thousand rows, unchecked."""
        pa = import_installed("pyarrow")

        number = 0
        with translated(self.path, "reading it"):
            search = self.table.search().select(list(names)).with_row_id(True).limit(self.count or 1)
            for batch in search.to_batches(batch_size=_ROWS_A_BATCH):
                number += batch.num_rows
                yield pa.Table.from_batches([batch])
        self._require_count(number)

    def columns(self, names: Sequence[str]) -> Any:
        """Return some columns of all rows, and ``_rowid``, as an Arrow table, unchecked."""
        with translated(self.path, "reading it"):
            found = self.table.search().select(list(names)).with_row_id(True).limit(self.count or 1).to_arrow()
        self._require_count(found.num_rows)
        return found

    def checked(self) -> Any:
        """Return all columns of all rows, and ``_rowid``, as an Arrow table, checked."""
        found = self.columns(self.table.schema.names)
        require_checksums(found, self.path)
        return found

    def rows(self, identifiers: Iterable[int], names: Sequence[str]) -> Any:
        """Return some columns of the rows of these ``_rowid``, in their order, as an Arrow table, unchecked."""
        wanted = np.fromiter(identifiers, dtype=np.int64).tolist()
        with translated(self.path, "reading it"):
            found = self.table.take_row_ids(wanted).select(list(names)).with_row_id().to_arrow()
        place = {row: index for index, row in enumerate(found["_rowid"].to_pylist())}
        if not place.keys() >= set(wanted):
            raise ShapeIndexError(f"{self.path}: the index is damaged: rows are missing")
        return found.take([place[row] for row in wanted])

    def checked_rows(self, identifiers: Iterable[int]) -> Any:
        """Return all columns of the rows of these ``_rowid``, in their order, as an Arrow table, checked."""
        found = self.rows(identifiers, self.table.schema.names)
        require_checksums(found, self.path)
        return found

    def checked_where(self, column: str, values: Sequence[bytes]) -> Any:
        """Return all columns of the rows whose column holds one of these values, as an Arrow table, checked."""
        with translated(self.path, "reading it"):
            found = self.table.search().where(is_one_of(column, values)).limit(self.count or 1).to_arrow()
        require_checksums(found, self.path)
        return found

    def _require_count(self, number: int) -> None:
        if number != self.count:
            raise ShapeIndexError(f"{self.path}: the index is damaged: of {self.count} rows {number} can be read")
