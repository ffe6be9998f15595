"""Columns of Arrow tables, to arrays and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import IntArray


def vectors(column: Any, dtype: Any) -> NDArray[Any]:
    """Return a column of fixed-size lists (n, k), of an Arrow table, as an array."""
    length = column.type.list_size
    parts = [chunk.flatten().to_numpy().reshape(-1, length) for chunk in column.chunks]
    return np.concatenate([np.empty((0, length), dtype=dtype), *parts], dtype=dtype, casting="unsafe")


def fixed_lists(rows: NDArray[Any]) -> Any:
    """Return an array (n, k) as a fixed-size list column."""
    pa = import_installed("pyarrow")

    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(rows).ravel()), rows.shape[1])


def column(values: Any, kind: Any) -> Any:
    """Return values, a sequence or a column of another table, as a column of a type."""
    pa = import_installed("pyarrow")

    return values.cast(kind) if isinstance(values, pa.ChunkedArray) else pa.array(values, kind)


def identifiers(table: Any) -> IntArray:
    """Return the column ``_rowid`` (n,) of an Arrow table."""
    return np.asarray(table["_rowid"].to_numpy(), dtype=np.int64)


def is_one_of(column: str, values: Sequence[bytes]) -> str:
    """Return the condition, as Lance takes it, that a column of bytes holds one of these values."""
    return f"{column} IN ({', '.join(f'X{value.hex()!r}' for value in values)})"
