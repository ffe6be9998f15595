"""Point clouds as text: .xyz, .xyzn, .xyzrgb and .pts."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import cloud_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import NumberRows, TextLines, indices
from fsh3d_o3d.files.formats.text_columns import text_columns
from fsh3d_o3d.geometry import PointArrays

_UNIT_LENGTH = 1e-2  # how far a normal may be from length 1: it may be printed with two decimals
_NORMALS = ("nx", "ny", "nz")
_PTS_WIDTHS = (3, 4, 6, 7)  # columns: a position, and after it an intensity, a colour or both
_COUNT_AND_BLANK_LINE = re.compile(rb"\s*\d+[ \t]*(?:\r\n|\n|\r)[ \t]*[\r\n]")
_HEAVIEST_ELEMENT = 118  # atomic number of oganesson; none is known beyond


def parse_xyz(source: Source) -> PointArrays:
    """Return lines ``x y z …``; a fourth to sixth column are normals where all of them have length 1."""
    table, names = _table(source)
    if names is not None:
        return _from_named_columns(source, table, names)
    _check_no_atomic_numbers(source, table)
    if table.shape[1] != 6:
        return cloud_of(source, table[:, :3])
    normals = table[:, 3:]
    unit = bool((np.abs(np.linalg.norm(normals, axis=1) - 1) < _UNIT_LENGTH).all())
    return cloud_of(source, table[:, :3], normals if unit else None)


def parse_xyzn(source: Source) -> PointArrays:
    """Return lines ``x y z nx ny nz``."""
    table, names = _table(source)
    if names is not None:
        return _from_named_columns(source, table, names)
    table = _six_columns(source, table)
    return cloud_of(source, table[:, :3], table[:, 3:])


def parse_xyzrgb(source: Source) -> PointArrays:
    """Return lines ``x y z r g b``, colours in [0, 1] or 0 … 255."""
    table, names = _table(source)
    if names is not None:
        return _from_named_columns(source, table, names)
    table = _six_columns(source, table)
    return cloud_of(source, table[:, :3], colors=_colors(table[:, 3:]))


def parse_pts(source: Source) -> PointArrays:
    """Return a number of points and lines ``x y z [intensity] [r g b]``, colours 0 … 255; or several such scans."""
    table, names = _table(source, counted_format=True)
    if names is not None:
        return _from_named_columns(source, table, names)
    width = table.shape[1]
    if width not in _PTS_WIDTHS:
        source.note(f"the {width - 3} columns behind x, y and z passed over: PTS has 3, 4, 6 or 7 columns")
        return cloud_of(source, table[:, :3])
    return cloud_of(source, table[:, :3], colors=_from_bytes(table[:, -3:]) if width > 4 else None)


def _table(source: Source, *, counted_format: bool = False) -> tuple[Float64Array, tuple[str, ...] | None]:
    """Return the points, and the names of the columns where the file gives them."""
    columns = text_columns(source)
    lines = columns.lines
    if not len(lines):
        raise GeometryReadError("no points")
    if counted_format:
        _check_not_ptx(lines)
    if lines.counts[0] == 1:
        rows = _scans(source, lines, counted_format=counted_format)
    else:
        rows = lines.span(0, len(lines))
        if counted_format:
            source.note("the number of points is missing before them; whether all are there cannot be told")
    if not len(rows.counts):
        raise GeometryReadError("no points")
    table = rows.columns("point", minimum=3)
    if columns.names is not None and len(columns.names) != table.shape[1]:
        if not columns.in_comment:
            raise GeometryReadError(
                f"the first line names {len(columns.names)} columns, but the points have {table.shape[1]} numbers"
            )
        return table, None
    if columns.names is not None and columns.in_comment and not _as_without(columns.names):
        source.note(f"the columns are those that a comment names: {' '.join(columns.names)[:80]}")
    return table, columns.names


def _as_without(names: tuple[str, ...]) -> bool:
    """Whether names of columns say no more than their order does."""
    return names[:3] == ("x", "y", "z") and not {*_NORMALS, "r", "g", "b"} & {*names}


def _scans(source: Source, lines: TextLines, *, counted_format: bool) -> NumberRows:
    """Return the points of one scan behind the other; a line of one number tells how many follow."""
    alone = lines.counts == 1
    announced = indices(lines.select(alone, skip=0).values, "numbers of points")
    found = np.diff(np.append(np.flatnonzero(alone), len(lines))) - 1
    wrong = np.flatnonzero(announced != found)
    if len(wrong):
        where = "the first line" if len(announced) == 1 else f"scan {wrong[0] + 1}"
        raise GeometryReadError(f"{where} announces {announced[wrong[0]]} points, but {found[wrong[0]]} follow")
    if len(announced) > 1:
        source.note(f"{len(announced)} scans were put together")
        return lines.select(~alone, skip=0)
    if not counted_format:
        source.note("the first line is the number of points")
    return lines.span(1, len(lines))


def _check_not_ptx(lines: TextLines) -> None:
    # Columns and rows of the scan, position and axes of the scanner, a matrix.
    if lines.counts[:10].tolist() == [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]:
        raise GeometryReadError("the content is PTX, scans that each stand in a frame of their own: save it as PTS")


def _check_no_atomic_numbers(source: Source, table: Float64Array) -> None:
    if table.shape[1] == 4 and _COUNT_AND_BLANK_LINE.match(source.data):
        elements = table[:, 0]
        if ((elements == np.rint(elements)) & (elements >= 1) & (elements <= _HEAVIEST_ELEMENT)).all():
            raise GeometryReadError(
                "a molecule (atomic numbers and where the atoms are), not geometry; where these are points, "
                "leave out the blank line behind their number"
            )


def _from_named_columns(source: Source, table: Float64Array, names: tuple[str, ...]) -> PointArrays:
    def columns(wanted: tuple[str, ...]) -> Float64Array | None:
        if any(names.count(name) != 1 for name in wanted):
            return None
        return table[:, [names.index(name) for name in wanted]]

    points = columns(("x", "y", "z"))
    assert points is not None  # else they would not be names of columns
    colors = columns(("r", "g", "b"))
    if colors is not None and not ((colors >= 0) & (colors <= 255)).all():
        source.note("colours outside 0 … 255 were left out")
        colors = None
    return cloud_of(source, points, columns(_NORMALS), None if colors is None else _colors(colors))


def _six_columns(source: Source, table: Float64Array) -> Float64Array:
    if table.shape[1] < 6:
        raise GeometryReadError(f"each point needs 6 numbers, found {table.shape[1]}")
    if table.shape[1] > 6:
        source.note(f"{counted(table.shape[1] - 6, 'column')} behind the sixth passed over")
    return table[:, :6]


def _colors(values: Float64Array) -> Float64Array:
    return values if np.nanmax(values, initial=0) <= 1 and np.nanmin(values, initial=0) >= 0 else _from_bytes(values)


def _from_bytes(values: Float64Array) -> Float64Array:
    if not ((values >= 0) & (values <= 255)).all():
        raise GeometryReadError("colours must lie in 0 … 255")
    return values / 255
