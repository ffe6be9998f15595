"""Filters of meshopt attributes, the last step of their decompression: (n, stride) bytes in and out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]


def _unchanged(items: _Bytes) -> _Bytes:
    return items


def _octahedral(items: _Bytes) -> _Bytes:
    """Unit vectors: two coordinates on an octahedron and the number that stands for 1, of 8 or 16 bits."""
    stored = _components(items, "i")
    x, y = (stored[:, i] / np.maximum(stored[:, 2], 1) for i in (0, 1))
    z = 1 - np.abs(x) - np.abs(y)
    folded = np.minimum(z, 0)
    vectors = np.stack([x - np.copysign(folded, x), y - np.copysign(folded, y), z], axis=1)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
    return _stored(np.column_stack([vectors * np.iinfo(stored.dtype).max, stored[:, 3]]), stored.dtype)


def _quaternion(items: _Bytes) -> _Bytes:
    """Unit quaternions: three components; the largest is left out, and the last number says which and what 1 is."""
    if items.shape[1] != 8:
        raise ValueError(f"quaternions of {items.shape[1]} bytes")
    stored = _components(items, "i")
    largest = stored[:, 3] & 3
    three = stored[:, :3] / (stored[:, 3:] | 3) / np.sqrt(2)
    four = np.column_stack([np.sqrt(np.maximum(0, 1 - (three**2).sum(axis=1))), three])
    result = np.empty_like(four)
    np.put_along_axis(result, (largest[:, None] + np.arange(4)) % 4, four, axis=1)
    return _stored(result * np.iinfo(stored.dtype).max, stored.dtype)


def _exponential(items: _Bytes) -> _Bytes:
    """Floats: a mantissa of 24 bits and an exponent of 8."""
    stored = np.ascontiguousarray(items).view("<i4")
    exponent, mantissa = stored >> 24, stored << 8 >> 8
    values: NDArray[np.float64] = np.ldexp(mantissa.astype(np.float64), exponent)
    return values.astype("<f4").view(np.uint8)


def _color(items: _Bytes) -> _Bytes:
    """Colours: luma, two differences, and opacity, whose highest bit tells how many bits there are."""
    stored = _components(items, "i").astype(np.int64)
    alpha = _components(items, "u")[:, 3].astype(np.int64)
    scale = (1 << np.floor(np.log2(np.maximum(alpha, 1))).astype(np.int64) + 1) - 1
    largest = np.iinfo(_components(items, "u").dtype).max
    luma, orange, green = _components(items, "u")[:, 0].astype(np.int64), stored[:, 1], stored[:, 2]
    alpha &= scale >> 1
    alpha = alpha << 1 | alpha & 1
    colors = np.stack([luma + orange - green, luma + green, luma - orange - green, alpha], axis=1)
    return _stored(np.clip(colors * (largest / scale)[:, None], 0, largest), _components(items, "u").dtype)


def _components(items: _Bytes, sign: str) -> NDArray[Any]:
    """(n, 4) integers of 8 or 16 bits."""
    if items.shape[1] not in (4, 8):
        raise ValueError(f"a filter over items of {items.shape[1]} bytes")
    return np.ascontiguousarray(items).view(f"<{sign}{items.shape[1] // 4}")


def _stored(values: NDArray[np.float64], dtype: np.dtype[Any]) -> _Bytes:
    rounded = np.copysign(np.floor(np.abs(values) + 0.5), values)
    return np.ascontiguousarray(rounded.astype(dtype)).view(np.uint8)


FILTERS: dict[str, Callable[[_Bytes], _Bytes]] = {
    "NONE": _unchanged,
    "OCTAHEDRAL": _octahedral,
    "QUATERNION": _quaternion,
    "EXPONENTIAL": _exponential,
    "COLOR": _color,
}
"""Filters by the name that glTF gives them."""
