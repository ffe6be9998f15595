"""Triangles of a meshopt stream: most share an edge with one that came just before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_HEADER = 0xE1  # first byte, as the extension specifies
_TAIL = 16  # bytes: pairs of references that triangles often begin with
_WRAP = 0xFFFFFFFF  # indices are counted modulo 2³²


def decode_triangles(data: bytes, count: int) -> NDArray[np.uint32]:
    """Return ``count`` indices, three for each triangle.

    Raises:
        ValueError: The stream is damaged.
    """
    triangles = count // 3
    if not data or data[0] != _HEADER:
        raise ValueError("triangles of an unknown version")
    if count == 0 or count % 3 or len(data) < 1 + triangles + _TAIL:
        raise ValueError(f"truncated: {len(data)} bytes for {count} indices")
    try:
        return _decoded(data, triangles)
    except (IndexError, TypeError):  # a place that nothing was written to, or beyond the end
        raise ValueError("triangles refer to what is not there") from None


def _decoded(data: bytes, triangles: int) -> NDArray[np.uint32]:
    # The format is a state machine: each triangle depends on those before it. Hence the one loop over triangles.
    rest = _TrailingBytes(data[1 + triangles : -_TAIL])
    common = data[-_TAIL:]
    edges: list[tuple[int, int] | None] = [None] * 16
    vertices: list[int | None] = [None] * 16
    newest_edge = newest_vertex = fresh = 0
    result: list[int] = []
    for code in data[1 : 1 + triangles]:
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = edges[newest_edge - 1 - high & 15]  # type: ignore[misc]  # None is a TypeError, as it should be
            known = 0 < low < 13
            if low == 0:
                c = fresh
                fresh = fresh + 1 & _WRAP
            elif known:
                c = vertices[newest_vertex - 1 - low & 15] + 0  # type: ignore[operator]  # same
            elif low < 15:
                c = rest.last = rest.last + (1 if low == 14 else -1) & _WRAP
            else:
                c = rest.index()
            edges[newest_edge & 15], edges[newest_edge + 1 & 15] = (c, b), (a, c)
            newest_edge += 2
            if not known:
                vertices[newest_vertex & 15] = c
                newest_vertex += 1
            result += (a, b, c)
            continue
        pair = common[low] if low < 14 else rest.byte()
        if low >= 14 and pair == 0:
            fresh = 0
        corners: list[int] = []
        # References count from the newest vertex of the triangles before this one.
        for reference in (15 if low == 15 else 0, pair >> 4, pair & 15):
            if reference == 0:
                corners.append(fresh)
                fresh = fresh + 1 & _WRAP
            elif reference < 15:
                corners.append(vertices[newest_vertex - reference & 15] + 0)  # type: ignore[operator]  # same
            elif low >= 14:
                corners.append(rest.index())
            else:
                raise ValueError("a pair of references is damaged")
        for corner, reference in zip(corners, (0, pair >> 4, pair & 15), strict=True):
            if reference in (0, 15):
                vertices[newest_vertex & 15] = corner
                newest_vertex += 1
        a, b, c = corners
        for edge in ((b, a), (c, b), (a, c)):
            edges[newest_edge & 15] = edge
            newest_edge += 1
        result += corners
    if rest.at != len(rest.data):
        raise ValueError("bytes are left over")
    return np.array(result, dtype=np.uint32)


class _TrailingBytes:
    """Bytes behind the codes: what did not fit into them, and the index that was told last."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0
        self.last = 0

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def index(self) -> int:
        value = 0
        for shift in range(0, 35, 7):
            byte = self.byte()
            value |= (byte & 127) << shift
            if byte < 128:
                break
        else:
            raise ValueError("an index of more than five bytes")
        value &= _WRAP
        self.last = self.last + (~(value >> 1) if value & 1 else value >> 1) & _WRAP
        return self.last
