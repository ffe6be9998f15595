"""VTK's legacy format: keywords in lines of text, and arrays as text or big-endian bytes between them."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import numbers
from fsh3d_o3d.files.formats.vtk.cells import POLYGON, STRIP, Cells, geometry_of, named_values
from fsh3d_o3d.files.formats.vtk.xml import cells_between
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_HEAD = re.compile(rb"# vtk DataFile Version \d+\.\d+[^\n]*\n[^\n]*\n[ \t]*(ASCII|BINARY)[^\n]*\n", re.IGNORECASE)
_KINDS = {
    b"char": "i1",
    b"unsigned_char": "u1",
    b"short": "i2",
    b"unsigned_short": "u2",
    b"int": "i4",
    b"unsigned_int": "u4",
    b"long": "i8",
    b"unsigned_long": "u8",
    b"vtktypeint64": "i8",
    b"vtkidtype": "i4",
    b"float": "f4",
    b"double": "f8",
}
_GROUPS = {b"VERTICES": 2, b"LINES": 4, b"TRIANGLE_STRIPS": STRIP, b"POLYGONS": POLYGON, b"CELLS": 0}
_KEYWORD = re.compile(rb"[ \t]*[A-Z_]{4,}")
_WIDTHS = {b"NORMALS": 3, b"VECTORS": 3, b"TENSORS": 9}
_DIGITS = 15  # of a number of points or cells


def parse_vtk(source: Source) -> MeshArrays | PointArrays:
    """Return a legacy file of PolyData, or the surface of an unstructured grid, with the values at its points."""
    text = source.data.replace(b"\r\n", b"\n") if b"ASCII" in source.data[:1024].upper() else source.data
    head = _HEAD.match(text)
    if head is None:
        raise GeometryReadError("it does not begin with '# vtk DataFile Version', a title, and ASCII or BINARY")
    return _Reader(source, text, head.end(), binary=head[1].upper() == b"BINARY").geometry()


class _Reader:
    """A place in the file, and what has been read up to there."""

    def __init__(self, source: Source, text: bytes, at: int, *, binary: bool) -> None:
        self._source, self._text, self._at, self._binary = source, text, at, binary
        self._points: NDArray[np.float64] | None = None
        self._cells: list[Cells] = []
        self._kinds: IntArray | None = None
        self._values: dict[str, NDArray[np.generic]] = {}

    def geometry(self) -> MeshArrays | PointArrays:
        words = self._line()
        if words[:1] != [b"DATASET"] or words[1:2] not in ([b"POLYDATA"], [b"UNSTRUCTURED_GRID"]):
            what = b" ".join(words)[:40].decode("ascii", "replace")
            raise GeometryReadError(f"it holds '{what}', not DATASET POLYDATA or UNSTRUCTURED_GRID")
        while (words := self._line()) and words[0] not in (b"POINT_DATA", b"CELL_DATA"):
            self._geometry_part(words)
        if self._points is None:
            raise GeometryReadError("truncated: its points are missing")
        if not words and not self._cells:
            raise GeometryReadError("truncated, or only points: those of a cloud are named under VERTICES")
        if words and words[0] == b"POINT_DATA":
            self._point_data(self._number(words, 1))
        cells = self._all_cells()
        return geometry_of(
            self._source, self._points, cells, named_values(self._source, self._values, len(self._points))
        )

    def _geometry_part(self, words: list[bytes]) -> None:
        keyword = words[0].upper()
        if keyword == b"POINTS":
            count = self._number(words, 1)
            self._points = self._array(3 * count, self._kind(words, 2)).astype(np.float64).reshape(-1, 3)
        elif keyword in _GROUPS:
            self._cells.append(self._group(keyword, self._number(words, 1), self._number(words, 2)))
        elif keyword == b"CELL_TYPES":
            self._kinds = self._array(self._number(words, 1), "i4").astype(np.int64)
        elif keyword == b"METADATA":
            while self._at < len(self._text) and self._raw_line().strip():
                pass
        elif keyword == b"FIELD":
            self._field(self._number(words, 2))
        else:
            raise GeometryReadError(f"damaged: '{words[0][:30].decode('ascii', 'replace')}' where a keyword should be")

    def _group(self, keyword: bytes, first: int, second: int) -> Cells:
        name = keyword.decode("ascii")
        before = self._at
        words = self._line()
        if words[:1] == [b"OFFSETS"]:
            bounds = self._array(first, self._kind(words, 1)).astype(np.int64)
            words = self._line()
            if words[:1] != [b"CONNECTIVITY"] or not first:
                raise GeometryReadError(f"damaged: the corners of its {name} are missing")
            return cells_between(
                bounds, self._array(second, self._kind(words, 1)).astype(np.int64), _GROUPS[keyword], name
            )
        self._at = before
        listed = self._array(second, "i4").astype(np.int64)
        counts = _counts(listed, first, name)
        is_count = np.zeros(len(listed), dtype=np.bool_)
        is_count[np.cumsum(counts + 1) - counts - 1] = True
        return Cells(np.full(first, _GROUPS[keyword]), listed[~is_count], counts)

    def _all_cells(self) -> Cells:
        names = ("kinds", "corners", "counts")
        if not self._cells:
            return Cells(*(np.empty(0, dtype=np.int64) for _ in names))
        cells = Cells(*(np.concatenate([getattr(part, name) for part in self._cells]) for name in names))
        if self._kinds is None:
            if (cells.kinds == 0).any():
                raise GeometryReadError("truncated: the kinds of its cells are missing")
            return cells
        if len(self._kinds) != len(cells.counts):
            raise GeometryReadError(f"damaged: {len(cells.counts)} cells, but {len(self._kinds)} kinds of them")
        return Cells(self._kinds, cells.corners, cells.counts)

    def _point_data(self, count: int) -> None:
        """Read what belongs to points up to what is not known; a file that is cut off there is refused."""
        while (words := self._line()) and words[0] != b"CELL_DATA":
            keyword = words[0].upper()
            name = words[1].decode("utf-8", "replace") if len(words) > 1 else ""
            if keyword == b"SCALARS":
                width = self._number(words, 3) if len(words) > 3 else 1
                if self._line()[:1] != [b"LOOKUP_TABLE"]:
                    raise GeometryReadError("damaged: the lookup table of scalars is missing")
                self._keep(name, count, width, self._kind(words, 2))
            elif keyword in _WIDTHS:
                name = "normals" if keyword == b"NORMALS" else name
                self._keep(name, count, _WIDTHS[keyword], self._kind(words, 2))
            elif keyword == b"COLOR_SCALARS":
                self._keep("colors", count, self._number(words, 2), "u1" if self._binary else "f4")
            elif keyword == b"TEXTURE_COORDINATES":
                self._keep(name, count, self._number(words, 2), self._kind(words, 3))
            elif keyword == b"LOOKUP_TABLE":
                self._array(4 * self._number(words, 2), "u1" if self._binary else "f4")
            elif keyword == b"FIELD":
                self._values |= self._field(self._number(words, 2))
            elif keyword == b"METADATA":
                while self._at < len(self._text) and self._raw_line().strip():
                    pass
            else:
                shown = words[0][:30].decode("ascii", "replace")
                raise GeometryReadError(f"damaged: '{shown}' where a keyword should be")

    def _keep(self, name: str, count: int, width: int, kind: str) -> None:
        values = self._array(count * width, kind)
        self._values[name] = values.reshape(-1, width) if width > 1 else values

    def _field(self, arrays: int) -> dict[str, NDArray[np.generic]]:
        found: dict[str, NDArray[np.generic]] = {}
        for _ in range(min(arrays, 10**6)):
            words = self._line()
            if words[:1] == [b"METADATA"]:
                while self._at < len(self._text) and self._raw_line().strip():
                    pass
                words = self._line()
            width, count = self._number(words, 1), self._number(words, 2)
            values = self._array(width * count, self._kind(words, 3))
            found[words[0].decode("utf-8", "replace")] = values.reshape(-1, width) if width > 1 else values
        return found

    def _array(self, count: int, kind: str) -> NDArray[np.generic]:
        if self._binary:
            dtype = np.dtype(f">{kind}")
            end = self._at + count * dtype.itemsize
            if end > len(self._text):
                raise GeometryReadError(f"truncated: {counted(count, 'number')} announced, the file ends before")
            values = np.frombuffer(self._text, dtype=dtype, count=count, offset=self._at)
            self._at = end
            return values
        end = self._at
        while end < len(self._text) and not _KEYWORD.match(self._text, end):
            newline = self._text.find(b"\n", end)
            end = len(self._text) if newline < 0 else newline + 1
        found = numbers(self._text[self._at : end])
        if len(found) < count:
            raise GeometryReadError(f"truncated: {counted(count, 'number')} announced, {len(found)} follow")
        if len(found) > count:
            raise GeometryReadError(f"damaged: {counted(count, 'number')} announced, {len(found)} follow")
        self._at = end
        if kind[0] in "iu":
            if not (np.abs(found) < 2**53).all() or (found != np.rint(found)).any():
                raise GeometryReadError("damaged: whole numbers expected")
            return found.astype(np.int64)
        return found

    def _line(self) -> list[bytes]:
        """Return the words of the next line that is not blank; none at the end."""
        while self._at < len(self._text):
            words = self._raw_line().split()
            if words:
                return words
        return []

    def _raw_line(self) -> bytes:
        end = self._text.find(b"\n", self._at)
        end = len(self._text) if end < 0 else end
        line = self._text[self._at : end]
        self._at = end + 1
        return line

    def _number(self, words: list[bytes], place: int) -> int:
        word = words[place] if len(words) > place else b""
        if not word.isdigit() or len(word) > _DIGITS:
            raise GeometryReadError(f"damaged: '{word[:20].decode('ascii', 'replace')}' should be a whole number")
        return int(word)

    def _kind(self, words: list[bytes], place: int) -> str:
        word = (words[place] if len(words) > place else b"").lower()
        if word not in _KINDS:
            raise GeometryReadError(f"an array is of type '{word[:20].decode('ascii', 'replace')}', which is not read")
        return _KINDS[word]


def _counts(listed: IntArray, cells: int, name: str) -> IntArray:
    """Return how many corners each cell has, where that number stands before them."""
    if (
        cells
        and len(listed) >= cells
        and not len(listed) % cells
        and (listed[:: len(listed) // cells] == len(listed) // cells - 1).all()
    ):
        return np.full(cells, len(listed) // cells - 1)
    counts = np.empty(cells, dtype=np.int64)
    at = 0
    for row in range(cells):  # where a cell begins is known only from the one before it
        if at >= len(listed) or listed[at] < 0:
            raise GeometryReadError(f"truncated or damaged: its {name} break off after {row} of {cells}")
        counts[row] = listed[at]
        at += 1 + int(listed[at])
    if at != len(listed):
        raise GeometryReadError(f"truncated or damaged: {cells} {name} have other than {len(listed)} numbers")
    return counts
