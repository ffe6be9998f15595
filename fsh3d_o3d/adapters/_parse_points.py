"""Point clouds as text (private): .xyz, .xyzn, .xyzrgb and .pts."""

from __future__ import annotations

import re

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.adapters._parse_result import cloud_of
from fsh3d_o3d.adapters._parse_text import TextLines, without_comments
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import PointArrays
from fsh3d_o3d.errors import GeometryReadError

_UNIT = 1e-2  # how far the length of a printed normal may be from 1
_COUNT_LINE = re.compile(rb"\s*(\d{1,18})[ \t]*(?=[\r\n]|$)")


def parse_xyz(source: Source) -> PointArrays:
    """Return lines ``x y z …``; a fourth to sixth column are normals where all of them have length 1."""
    table = _table(source.data)
    if table.shape[1] != 6:
        return cloud_of(source, table[:, :3])
    normals = table[:, 3:]
    unit = bool((np.abs(np.linalg.norm(normals, axis=1) - 1) < _UNIT).all())
    return cloud_of(source, table[:, :3], normals if unit else None)


def parse_xyzn(source: Source) -> PointArrays:
    """Return lines ``x y z nx ny nz``."""
    table = _table(source.data, columns=6)
    return cloud_of(source, table[:, :3], table[:, 3:])


def parse_xyzrgb(source: Source) -> PointArrays:
    """Return lines ``x y z r g b``, colours in [0, 1] or 0 … 255."""
    table = _table(source.data, columns=6)
    return cloud_of(source, table[:, :3], colors=_colors(table[:, 3:]))


def parse_pts(source: Source) -> PointArrays:
    """Return a number of points and lines ``x y z [intensity] [r g b]``, colours 0 … 255."""
    text = without_comments(source.data)
    count = _COUNT_LINE.match(text)
    if count is None:
        raise GeometryReadError("the first line must be the number of points")
    table = _table(text[count.end() :])
    if len(table) != int(count[1]):
        raise GeometryReadError(f"the first line announces {int(count[1])} points, but {len(table)} follow")
    if table.shape[1] not in (3, 4, 6, 7):
        raise GeometryReadError(f"each point needs 3, 4, 6 or 7 numbers, found {table.shape[1]}")
    return cloud_of(source, table[:, :3], colors=_bytes(table[:, -3:]) if table.shape[1] > 4 else None)


def _table(data: bytes, columns: int | None = None) -> Float64Array:
    lines = TextLines.of(without_comments(data))
    if not len(lines):
        raise GeometryReadError("no points")
    table = lines.span(0, len(lines)).columns("point", minimum=3)
    if columns is not None and table.shape[1] != columns:
        raise GeometryReadError(f"each point needs {columns} numbers, found {table.shape[1]}")
    return table


def _colors(values: Float64Array) -> Float64Array:
    return values if np.nanmax(values, initial=0) <= 1 and np.nanmin(values, initial=0) >= 0 else _bytes(values)


def _bytes(values: Float64Array) -> Float64Array:
    if not ((values >= 0) & (values <= 255)).all():
        raise GeometryReadError("colours must lie in 0 … 255")
    return values / 255
