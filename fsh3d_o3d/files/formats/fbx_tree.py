"""FBX, binary and as text, into a tree of records."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED, inflated
from fsh3d_o3d.files.formats.text import numbers

_MAGIC = b"Kaydara FBX Binary  \0\x1a\0"
_FIRST_WIDE = 7500  # version from which on places in the file have 64 bits
_DEEPEST = 60  # records one in another, a choice; files have some six
_SCALARS = {b"Y": "<h", b"C": "<b", b"I": "<i", b"F": "<f", b"D": "<d", b"L": "<q"}
_ARRAYS = {b"f": "<f4", b"d": "<f8", b"l": "<i8", b"i": "<i4", b"b": "<u1"}
_COMMENT = re.compile(rb"^[ \t]*;[^\n]*", re.MULTILINE)
_RECORD = re.compile(rb"\s*([A-Za-z_]\w*)[ \t]*:[ \t]*")
_VALUES = re.compile(rb'(?:"[^"]*"|[^"{},\n]+|,\s*)*')
_END = re.compile(rb"\s*\}")
_VALUE = re.compile(rb'"([^"]*)"|([^",\s][^",]*)')


@dataclass
class FbxRecord:
    """A record: its name, its values, the records in it."""

    name: str
    values: list[Any] = field(default_factory=list)
    """Numbers, texts, and arrays of numbers."""
    children: list[FbxRecord] = field(default_factory=list)

    def find(self, name: str) -> FbxRecord | None:
        """Return the first record of a name in it."""
        return next((child for child in self.children if child.name == name), None)

    def array(self, name: str) -> NDArray[np.float64] | None:
        """Return the numbers of a record in it, however they are written."""
        found = self.find(name)
        if found is None:
            return None
        inner = found.find("a") or found  # as text, an array stands in a record of its own
        arrays = [np.atleast_1d(value) for value in inner.values if not isinstance(value, str)]
        return np.concatenate(arrays).astype(np.float64) if arrays else np.empty(0)


def fbx_records(data: bytes) -> tuple[int, FbxRecord]:
    """Return the version of a file and its outermost record.

    Raises:
        GeometryReadError: It is no FBX, cut off or damaged.
    """
    if data.startswith(_MAGIC):
        if len(data) < len(_MAGIC) + 4:
            raise GeometryReadError("truncated: the header breaks off")
        version = int.from_bytes(data[len(_MAGIC) : len(_MAGIC) + 4], "little")
        return version, _Binary(data, version).root()
    found = re.search(rb"FBXVersion:[ \t]*(\d{4,5})\b", data[:4096])
    if found is None:
        raise GeometryReadError("it is neither binary FBX nor FBX as text, which tells its 'FBXVersion'")
    return int(found[1]), _text_root(data)


class _Binary:
    def __init__(self, data: bytes, version: int) -> None:
        self._data = data
        self._head = struct.Struct("<QQQB" if version >= _FIRST_WIDE else "<IIIB")
        self._room = MOST_UNPACKED

    def root(self) -> FbxRecord:
        top = FbxRecord("")
        self._records(top, len(_MAGIC) + 4, len(self._data), 0, outermost=True)
        return top

    def _records(self, parent: FbxRecord, at: int, end: int, depth: int, *, outermost: bool = False) -> None:
        if depth > _DEEPEST:
            raise GeometryReadError(f"damaged: records are nested more than {_DEEPEST} deep")
        while at + self._head.size <= end:
            stop, count, size, length = self._head.unpack_from(self._data, at)
            if stop == 0:
                if count or size or length:
                    break
                return  # an empty record ends a list
            first = at + self._head.size + length
            if not first + size <= stop <= end:
                break
            record = FbxRecord(self._data[first - length : first].decode("utf-8", "replace"))
            record.values = self._values(first, first + size, count)
            if first + size < stop:
                self._records(record, first + size, stop, depth + 1)
            parent.children.append(record)
            at = stop
        else:
            if not outermost and at == end:
                return
        raise GeometryReadError(f"truncated or damaged: a list of records breaks off at byte {at}")

    def _values(self, at: int, end: int, count: int) -> list[Any]:
        values: list[Any] = []
        if count > end - at:
            raise GeometryReadError("damaged: a record announces more values than it has bytes")
        for _ in range(count):
            kind = self._data[at : at + 1]
            at += 1
            if kind in _SCALARS:
                size = struct.calcsize(_SCALARS[kind])
                if at + size > end:
                    break
                values.append(struct.unpack_from(_SCALARS[kind], self._data, at)[0])
            elif kind in (b"S", b"R"):
                size = 4 + int.from_bytes(self._data[at : at + 4], "little")
                if at + size > end:
                    break
                values.append(self._data[at + 4 : at + size].decode("utf-8", "replace"))
            elif kind in _ARRAYS:
                if at + 12 > end:
                    break
                length, packing, size = struct.unpack_from("<III", self._data, at)
                if at + 12 + size > end:
                    break
                values.append(self._array(_ARRAYS[kind], length, packing, self._data[at + 12 : at + 12 + size]))
                size += 12
            else:
                break
            at += size
        if len(values) != count or at != end:
            raise GeometryReadError("damaged: the values of a record do not fit it")
        return values

    def _array(self, kind: str, length: int, packing: int, content: bytes) -> NDArray[np.generic]:
        dtype = np.dtype(kind)
        needed = length * dtype.itemsize
        if packing not in (0, 1) or needed > self._room:
            raise GeometryReadError(f"damaged: an array of {length} numbers, packed in way {packing}")
        if packing:
            content, _ = inflated(content, what="an array", limit=needed)
        if len(content) != needed:
            raise GeometryReadError(f"truncated or damaged: an array of {needed} bytes has {len(content)}")
        self._room -= needed
        return np.frombuffer(content, dtype=dtype)


def _text_root(data: bytes) -> FbxRecord:
    text = _COMMENT.sub(b"", data.replace(b"\r\n", b"\n"))
    stack = [FbxRecord("")]
    at = 0
    while at < len(text):
        closing = _END.match(text, at)
        if closing is not None:
            if len(stack) == 1:
                raise GeometryReadError("damaged: a brace closes what was never opened")
            stack.pop()
            at = closing.end()
            continue
        found = _RECORD.match(text, at)
        if found is None:
            if not text[at:].strip():
                break
            shown = " ".join(text[at : at + 30].decode("ascii", "replace").split())
            raise GeometryReadError(f"damaged: '{shown}' where a record should begin")
        values = _VALUES.match(text, found.end())
        assert values is not None  # it may match nothing
        record = FbxRecord(found[1].decode("ascii"), _text_values(values[0]))
        stack[-1].children.append(record)
        at = values.end()
        if text[at : at + 1] == b"{":
            if len(stack) > _DEEPEST:
                raise GeometryReadError(f"damaged: records are nested more than {_DEEPEST} deep")
            stack.append(record)
            at += 1
    if len(stack) > 1:
        raise GeometryReadError(f"truncated: the record '{stack[-1].name[:30]}' is not closed")
    return stack[0]


def _text_values(text: bytes) -> list[Any]:
    if b'"' not in text and b"*" not in text and b"," in text:
        return [numbers(text.replace(b",", b" "))]
    values: list[Any] = []
    for quoted, plain in _VALUE.findall(text):
        word = plain.strip()
        try:
            values.append(float(word) if word else quoted.decode("utf-8", "replace"))
        except ValueError:
            values.append(word.decode("utf-8", "replace"))
    return values
