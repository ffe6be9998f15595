"""Data of text PLY: a record a line, or the numbers one after another."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.ply_header import PlyColumn, PlyElement
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import NumberRows, TextLines, indices

_COMMENT = re.compile(rb"(?:(?<=[\r\n])|\A)[ \t]*(?:comment|obj_info)\b[^\r\n]*")
_NUMBER = re.compile(rb"[-+]?\.?\d")
_MAXIMUM_TRAILING = 1000  # lines of words behind the data, a choice: more is a count that is wrong


def read_text(source: Source, text: bytes, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    """Return the columns of each element; one record is on each line, or the numbers follow one another anyhow."""
    elements = [element for element in elements if element.properties]
    if b"comment" in text or b"obj_info" in text:
        text, found = _COMMENT.subn(b"", text)
        if found:
            source.note(f"{counted(found, 'comment')} among the data passed over")
    lines = TextLines.of(text)
    try:
        return _line_by_line(source, lines, elements)
    except GeometryReadError:
        tables = _as_a_stream(lines, elements)
        if tables is None:
            raise
        source.note("the records are not one on each line")
        return tables


def _line_by_line(source: Source, lines: TextLines, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    expected = sum(element.count for element in elements)
    trailing = len(lines) - expected
    if not 0 <= trailing <= _MAXIMUM_TRAILING or any(
        _NUMBER.match(lines.raw(line)) for line in range(expected, len(lines))
    ):
        raise GeometryReadError(f"the header announces {expected} lines, but {len(lines)} follow")
    tables, row = {}, 0
    for element in elements:
        tables[element.name] = _text_columns(element, lines.span(row, row + element.count))
        row += element.count
    if trailing:
        source.note(f"{counted(trailing, 'line')} behind the data passed over")
    return tables


def _as_a_stream(lines: TextLines, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]] | None:
    """Return the columns wherever lines end; None where the numbers are not exactly those announced."""
    values = lines.span(0, len(lines)).values
    tables, at = {}, 0
    for element in elements:
        sizes = _record_sizes(values[at:], element)
        if sizes is None:
            return None
        stop = at + int(sizes.sum())
        tables[element.name] = _text_columns(element, NumberRows(values[at:stop], sizes))
        at = stop
    return tables if at == len(values) else None


def _record_sizes(values: Float64Array, element: PlyElement) -> IntArray | None:
    """Return how many numbers each record holds; None where they do not suffice."""
    fixed = len(element.properties)
    if element.count * fixed > len(values):
        return None
    sizes = np.full(element.count, fixed)
    if all(entry.count_dtype is None for entry in element.properties):
        return sizes
    numbers, at = values.tolist(), 0
    for record in range(element.count):  # a chain can only be followed
        start = at
        for entry in element.properties:
            if at >= len(numbers):
                return None
            items = numbers[at] if entry.count_dtype is not None else 0
            if not (0 <= items <= len(numbers)):
                return None
            at += 1 + int(items)
        if at > len(numbers):
            return None
        sizes[record] = at - start
    return sizes


def _text_columns(element: PlyElement, rows: NumberRows) -> dict[str, PlyColumn]:
    starts = rows.starts
    at = np.zeros_like(starts)
    columns: dict[str, PlyColumn] = {}
    for entry in element.properties:
        _inside_row(element, rows, at + 1)
        first = rows.values[starts + at]
        at = at + 1
        if entry.count_dtype is None:
            columns[entry.name] = PlyColumn(first, None, entry.dtype)
            continue
        counts = indices(first, "list lengths")
        if len(counts) and counts.min() < 0:
            raise GeometryReadError(f"a list of {counts.min()} items in element {element.name}")
        _inside_row(element, rows, at + counts)
        step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        columns[entry.name] = PlyColumn(rows.values[np.repeat(starts + at, counts) + step], counts, entry.dtype)
        at = at + counts
    over = np.flatnonzero(at != rows.counts)
    if len(over):
        raise GeometryReadError(
            f"{element.name} {over[0]} has {rows.counts[over[0]]} numbers where the header asks for {at[over[0]]}"
        )
    return columns


def _inside_row(element: PlyElement, rows: NumberRows, needed: IntArray) -> None:
    short = np.flatnonzero(needed > rows.counts)
    if len(short):
        raise GeometryReadError(f"{element.name} {short[0]} is cut short at {rows.counts[short[0]]} numbers")
