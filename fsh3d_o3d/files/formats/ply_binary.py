"""Records of binary PLY: in one view where their lists are equally long, one after another where not."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError

Layout: TypeAlias = Sequence[tuple[str, str | None]]
Columns: TypeAlias = list[tuple[Float64Array, IntArray | None]]


def read_binary_element(data: bytes, offset: int, name: str, count: int, layout: Layout) -> tuple[Columns, int]:
    """Return the properties of ``count`` records from ``offset``, and the offset behind them.

    Args:
        data: The file.
        offset: Where the element begins.
        name: The element's name, for messages.
        count: Number of records that the header announces; checked against the file's size before anything else.
        layout: For each property the type, and for a list the type of its length.

    Returns:
        For each property its values and, for a list, (count,) lengths; and the offset of the next element.
    """
    smallest = sum(np.dtype(length or kind).itemsize for kind, length in layout)
    if count * smallest > len(data) - offset:
        raise GeometryReadError(
            f"truncated: {count} records of element {name} need at least {count * smallest} bytes, "
            f"but {len(data) - offset} are left"
        )
    if count == 0:
        empty = np.empty(0)
        return [(empty, None if length is None else empty.astype(np.int64)) for _, length in layout], offset
    result = _equal_lengths(data, offset, count, layout)
    return result if result is not None else _varying_lengths(data, offset, name, count, layout)


def _equal_lengths(data: bytes, offset: int, count: int, layout: Layout) -> tuple[Columns, int] | None:
    """Read records whose lists have the lengths of the first record's, in one view; None where they do not."""
    lengths = _first_lengths(data, offset, layout)
    if lengths is None:
        return None
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for number, ((kind, length), items) in enumerate(zip(layout, lengths, strict=True)):
        if length is not None:
            fields.append((f"n{number}", length))
        fields.append((f"v{number}", kind, items) if length is not None else (f"v{number}", kind))
    dtype = np.dtype(fields)
    if count * dtype.itemsize > len(data) - offset:
        return None
    table = np.frombuffer(data, dtype=dtype, count=count, offset=offset)
    columns: Columns = []
    for number, ((_, length), items) in enumerate(zip(layout, lengths, strict=True)):
        values = table[f"v{number}"].reshape(-1).astype(np.float64)
        if length is None:
            columns.append((values, None))
        elif (table[f"n{number}"] != items).any():
            return None
        else:
            columns.append((values, np.full(count, items, dtype=np.int64)))
    return columns, offset + count * dtype.itemsize


def _first_lengths(data: bytes, offset: int, layout: Layout) -> list[int] | None:
    lengths = []
    for kind, length in layout:
        items = 1
        if length is not None:
            size = np.dtype(length).itemsize
            if offset + size > len(data):
                return None
            items = int(np.frombuffer(data, dtype=length, count=1, offset=offset)[0])
            offset += size
        offset += items * np.dtype(kind).itemsize
        if items < 0 or offset > len(data):
            return None
        lengths.append(items)
    return lengths


def _varying_lengths(data: bytes, offset: int, name: str, count: int, layout: Layout) -> tuple[Columns, int]:
    """Read records whose lists differ in length."""
    starts, lengths, end = _record_starts(data, offset, name, count, layout)
    raw = np.frombuffer(data, dtype=np.uint8)
    columns: Columns = []
    at = starts
    list_number = 0
    for kind, length in layout:
        size = np.dtype(kind).itemsize
        if length is None:
            columns.append((_gather(raw, at, kind), None))
            at = at + size
            continue
        counts = lengths[:, list_number]
        list_number += 1
        at = at + np.dtype(length).itemsize
        step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        columns.append((_gather(raw, np.repeat(at, counts) + step * size, kind), counts))
        at = at + counts * size
    return columns, end


def _record_starts(data: bytes, offset: int, name: str, count: int, layout: Layout) -> tuple[IntArray, IntArray, int]:
    """Return where each record starts, its lists' lengths (count, lists), and where the last one ends.

    A record's place depends on the lengths in the one before: this chain is the one thing here that has to be
    followed record by record.
    """
    steps: list[tuple[int, struct.Struct, int]] = []  # bytes before a list, its length's reader, its items' size
    fixed = 0
    for kind, length in layout:
        if length is None:
            fixed += np.dtype(kind).itemsize
            continue
        code = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}[length[1:]]
        reader = struct.Struct(length[0] + code)
        steps.append((fixed, reader, np.dtype(kind).itemsize))
        fixed = 0
    starts = np.empty(count, dtype=np.int64)
    lengths = np.empty((count, len(steps)), dtype=np.int64)
    for record in range(count):
        starts[record] = offset
        for number, (before, reader, size) in enumerate(steps):
            offset += before
            if offset + reader.size > len(data):
                raise GeometryReadError(f"truncated in record {record} of {count} of element {name}")
            (items,) = reader.unpack_from(data, offset)
            offset += reader.size + items * size
            if items < 0:
                raise GeometryReadError(f"a list of {items} items in element {name}")
            if offset > len(data):
                raise GeometryReadError(f"truncated in record {record} of {count} of element {name}")
            lengths[record, number] = items
        offset += fixed
    if offset > len(data):
        raise GeometryReadError(f"truncated in the last record of element {name}")
    return starts, lengths, offset


def _gather(raw: NDArray[np.uint8], at: IntArray, kind: str) -> Float64Array:
    """Read one value of type ``kind`` at each offset."""
    size = np.dtype(kind).itemsize
    octets = raw[at[:, None] + np.arange(size)]
    return np.asarray(octets.reshape(-1).view(kind), dtype=np.float64)
