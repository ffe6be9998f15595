"""Decompression of meshopt streams, as the glTF extensions ``…_meshopt_compression`` specify them.

Attributes are byte deltas of consecutive items, packed in groups of 16; triangles refer to edges and vertices that
came just before; indices are deltas of varying length. Streams refer to nothing outside themselves, and what they may
grow to is held against their length before any allocation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.files.formats.gltf.meshopt_filters import FILTERS
from fsh3d_o3d.files.formats.gltf.meshopt_triangles import decode_triangles

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
"""Names of the extensions."""

# All as the extension specifies them.
_GROUP = 16  # items whose deltas are packed together
_BLOCK_BYTES, _BLOCK_ITEMS = 8192, 256  # the largest block, by its bytes and by its items
_VERSIONS = {0xA0: 0, 0xA1: 1}  # first byte of attributes
_INDICES_HEADER = 0xD1  # first byte of indices
_INDICES_TAIL = 4  # bytes of zeros
_SMALLEST_TAIL = {0: 32, 1: 24}  # bytes, by version
# Bits of a delta by the two bits that a group has in the header: version 0, and the control modes of version 1.
_BITS_VERSION_0 = (0, 2, 4, 8)
_BITS_BY_CONTROL = ((0, 1, 2, 4), (1, 2, 4, 8))  # by the control modes 0 and 1
_ALL_ZERO, _LITERAL = 2, 3  # the other control modes


def decode_meshopt(data: bytes, count: int, stride: int, mode: object, filtered: object) -> NDArray[np.uint8]:
    """Return a stream's items as (count · stride,) bytes.

    Args:
        data: The stream.
        count: Items.
        stride: Bytes of an item.
        mode: ``"ATTRIBUTES"``, ``"TRIANGLES"`` or ``"INDICES"``.
        filtered: ``"NONE"``, ``"OCTAHEDRAL"``, ``"QUATERNION"``, ``"EXPONENTIAL"`` or ``"COLOR"``.

    Raises:
        ValueError: The stream is damaged, or of an unknown kind.
    """
    if mode == "ATTRIBUTES":
        if stride % 4 or not 4 <= stride <= 256 or not isinstance(filtered, str) or filtered not in FILTERS:
            raise ValueError(f"items of {stride} bytes with the filter {str(filtered)[:20]!r}")
        return FILTERS[filtered](_attributes(data, count, stride)).ravel()
    decoders: dict[object, Callable[[bytes, int], NDArray[np.uint32]]]
    decoders = {"TRIANGLES": decode_triangles, "INDICES": _indices}
    if mode not in decoders or stride not in (2, 4):
        raise ValueError(f"items of {stride} bytes in the mode {str(mode)[:20]!r}")
    return decoders[mode](data, count).astype(f"<u{stride}").view(np.uint8)


def _attributes(data: bytes, count: int, stride: int) -> NDArray[np.uint8]:
    """(count, stride) bytes."""
    version = _VERSIONS.get(data[0] if data else 0)
    if version is None:
        raise ValueError("attributes of an unknown version")
    channels = stride // 4
    tail = stride + (channels if version else 0)
    end = len(data) - max(tail, _SMALLEST_TAIL[version])
    per_block = min(_BLOCK_BYTES // stride // _GROUP * _GROUP, _BLOCK_ITEMS)
    # The least that a block takes: a control byte for four bytes of an item, or a header for each byte.
    least = channels if version else stride
    if end < 1 or count == 0 or math.ceil(count / per_block) * least > end - 1:
        raise ValueError(f"truncated: {len(data)} bytes for {count} items of {stride} bytes")
    groups = _Groups(data, end, version)
    for row in range(0, count, per_block):
        groups.locate_block(row, min(per_block, count - row), stride)
    if groups.at != end:
        raise ValueError("bytes are left over")
    deltas = groups.deltas(count, stride)
    baseline = np.frombuffer(data, np.uint8, stride, len(data) - tail)
    modes = data[len(data) - channels :] if version else bytes(channels)
    decoded = [_summed(deltas[:, 4 * i : 4 * i + 4], baseline[4 * i : 4 * i + 4], mode) for i, mode in enumerate(modes)]
    return np.concatenate(decoded, axis=1)


@dataclass
class _Groups:
    """Where the deltas of each group lie: known one after another, while what they are is unpacked at once."""

    data: bytes
    end: int
    version: int
    at: int = 1
    found: dict[int, list[tuple[int, int, int]]] = field(default_factory=lambda: {1: [], 2: [], 4: [], 8: []})
    """Groups by the bits of a delta: offset, first row, column."""
    literals: list[tuple[int, int, int, int]] = field(default_factory=list)
    """Deltas that are stored as they are: offset, first row, column, number."""

    def locate_block(self, row: int, items: int, stride: int) -> None:
        """Find the groups of a block of items."""
        controls = b"" if self.version == 0 else self._taken(stride // 4)
        for column in range(stride):
            bits = _BITS_VERSION_0
            if controls:
                control = controls[column >> 2] >> 2 * (column & 3) & 3
                if control == _ALL_ZERO:
                    continue
                if control == _LITERAL:
                    self.literals.append((self.at, row, column, items))
                    self._taken(items)
                    continue
                bits = _BITS_BY_CONTROL[control]
            self._locate_column(row, column, math.ceil(items / _GROUP), bits)

    def _locate_column(self, row: int, column: int, groups: int, bits: tuple[int, ...]) -> None:
        header = self._taken(math.ceil(groups / 4))
        data, at = self.data, self.at
        for group in range(groups):
            width = bits[header[group >> 2] >> 2 * (group & 3) & 3]
            if width == 0:
                continue
            self.found[width].append((at, row + _GROUP * group, column))
            packed = data[at : at + 2 * width]
            at += 2 * width  # 16 deltas; the escaped ones follow as bytes
            if width < 8:
                at += sum(packed.translate(_ESCAPES[width]))
        if at > self.end:
            raise ValueError("truncated")
        self.at = at

    def _taken(self, size: int) -> bytes:
        self.at += size
        if self.at > self.end:
            raise ValueError("truncated")
        return self.data[self.at - size : self.at]

    def deltas(self, count: int, stride: int) -> NDArray[np.uint8]:
        """(count, stride) deltas, unpacked."""
        data = np.frombuffer(self.data, np.uint8)
        # Groups are whole: rows beyond the count are unpacked and left out.
        result = np.zeros((math.ceil(count / _GROUP), _GROUP, stride), dtype=np.uint8)
        for width, groups in self.found.items():
            if groups:
                at, row, column = np.array(groups, dtype=np.int64).T
                result[row // _GROUP, :, column] = _unpacked(data, at, width)
        flat = result.reshape(-1, stride)
        for begin, row, column, items in self.literals:
            flat[row : row + items, column] = data[begin : begin + items]
        return flat[:count]


def _escapes(width: int) -> bytes:
    """For each byte, how many of the deltas of so many bits in it have all bits set."""
    full = (1 << width) - 1
    return bytes(sum(byte >> shift & full == full for shift in range(0, 8, width)) for byte in range(256))


_ESCAPES = {width: _escapes(width) for width in (1, 2, 4)}


def _unpacked(data: NDArray[np.uint8], at: NDArray[np.int64], width: int) -> NDArray[np.uint8]:
    """(g, 16) deltas of so many bits from g places."""
    packed = data[at[:, None] + np.arange(2 * width)]
    if width == 8:
        return cast(NDArray[np.uint8], packed)
    # Single bits begin at the low end of a byte, wider deltas at the high one.
    shifts = np.arange(8, dtype=np.uint8) if width == 1 else np.arange(8 - width, -1, -width, dtype=np.uint8)
    full = np.uint8((1 << width) - 1)
    values: NDArray[np.uint8] = (packed[:, :, None] >> shifts & full).reshape(len(at), _GROUP)
    escaped = values == full
    group, item = np.nonzero(escaped)
    values[group, item] = data[(at[:, None] + 2 * width + np.cumsum(escaped, axis=1) - 1)[group, item]]
    return values


def _summed(deltas: NDArray[np.uint8], baseline: NDArray[np.uint8], mode: int) -> NDArray[np.uint8]:
    """(n, 4) bytes of four neighbouring columns from their deltas and what stands before the first item."""
    kind, rotation = mode & 15, mode >> 4
    if kind > 2 or (kind < 2 and rotation):
        raise ValueError(f"deltas of the unknown kind {mode}")
    dtype = np.dtype(("<u1", "<u2", "<u4")[kind])
    steps, first = np.ascontiguousarray(deltas).view(dtype), np.ascontiguousarray(baseline).view(dtype)
    if kind == 2:
        turned = steps >> np.uint32(rotation) | steps << np.uint32(32 - rotation & 31)
        summed = np.bitwise_xor.accumulate(np.vstack([first, turned]), axis=0)
    else:
        steps = np.where(steps & 1, ~(steps >> 1), steps >> 1)
        summed = np.cumsum(np.vstack([first, steps]), axis=0, dtype=dtype)
    return np.ascontiguousarray(summed[1:]).view(np.uint8)


def _indices(data: bytes, count: int) -> NDArray[np.uint32]:
    """(count,) indices: each is the last one of two sequences, plus a delta."""
    body = np.frombuffer(data, np.uint8)[1 : len(data) - _INDICES_TAIL]
    if len(data) <= _INDICES_TAIL or data[0] != _INDICES_HEADER:
        raise ValueError("indices of an unknown version")
    ends = np.flatnonzero(body < 128)
    if count == 0 or len(ends) != count or ends[-1] != len(body) - 1:
        raise ValueError(f"{len(ends)} indices instead of {count}")
    begins = np.concatenate([[0], ends[:-1] + 1])
    place = np.arange(len(body)) - np.repeat(begins, ends + 1 - begins)
    if place.max() > 4:
        raise ValueError("an index of more than five bytes")
    values = np.add.reduceat((body & np.uint8(127)).astype(np.uint64) << (7 * place).astype(np.uint64), begins)
    codes = values.astype(np.uint32)
    steps = np.where(codes & 2, ~(codes >> 2), codes >> 2)
    second = (codes & 1).astype(bool)
    sums = [np.cumsum(np.where(chosen, steps, 0), dtype=np.uint32) for chosen in (~second, second)]
    return np.where(second, sums[1], sums[0])
