"""Arrays of a glTF file: accessors, dense and sparse."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.buffers import GltfBuffers
from fsh3d_o3d.files.formats.gltf.document import GltfDocument, natural

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # by componentType
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}  # numbers in an item
# Items of an accessor that lies in no buffer and so costs the file nothing: enough for any morph target, and too
# little to fill memory (240 MB of positions).
_MOST_IMPLICIT = 10_000_000


class GltfAccessors:
    """Numbers by accessor; counts are held against what the file holds before any allocation."""

    def __init__(self, document: GltfDocument) -> None:
        self._document = document
        self.buffers = GltfBuffers(document)

    def count(self, index: object) -> int:
        """Return the number of items."""
        return natural(self._document.entry("accessors", index), "count")

    def embedded(self, index: object) -> bool:
        """Return whether an accessor lies in a buffer."""
        return "bufferView" in self._document.entry("accessors", index)

    def numbers(self, index: object, kinds: tuple[str, ...], rows: IntArray | None = None) -> Float64Array:
        """Return an accessor as (count, width) numbers, or some of its rows; what is normalised is divided."""
        array = self.raw(index, kinds)
        return unit_range(array if rows is None else array[rows], self.normalized(index))

    def indices(self, index: object) -> IntArray:
        """Return an accessor of whole numbers >= 0 as (count,)."""
        array = self.raw(index, ("SCALAR",))
        if array.dtype.kind != "u":
            raise GeometryReadError("damaged: indices must be unsigned integers")
        return array.ravel().astype(np.int64)

    def normalized(self, index: object) -> bool:
        """Return whether integers of an accessor stand for fractions of the largest of their type."""
        return self._document.entry("accessors", index).get("normalized") is True

    def raw(self, index: object, kinds: tuple[str, ...]) -> NDArray[Any]:
        """Return an accessor as it is stored, (count, width)."""
        accessor = self._document.entry("accessors", index)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if kind not in kinds or not isinstance(component, int) or component not in _COMPONENTS:
            raise GeometryReadError(f"damaged: accessor {index} is not {' or '.join(kinds)} of a known component type")
        dtype, width, count = np.dtype(_COMPONENTS[component]), _WIDTHS[kind], natural(accessor, "count")
        sparse = accessor.get("sparse")
        if "bufferView" in accessor:
            array = self._dense(accessor, f"accessor {index}", dtype, count, width)
        elif count == 0 or count > _MOST_IMPLICIT:
            raise GeometryReadError(f"damaged: accessor {index} has {count} items and no buffer")
        else:
            array = np.broadcast_to(np.zeros((), dtype), (count, width))
        return array if sparse is None else self._replaced(array, sparse, f"accessor {index}")

    def _dense(self, entry: dict[str, Any], name: str, dtype: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        view, stated = self.buffers.view(entry.get("bufferView"))
        size, begin = dtype.itemsize * width, natural(entry, "byteOffset", 0)
        stride = size if stated is None else stated
        if count == 0 or stride < size or begin + (count - 1) * stride + size > len(view):
            raise GeometryReadError(f"truncated or damaged: {name} of {count} items exceeds its buffer")
        return np.ndarray((count, width), dtype, buffer=view, offset=begin, strides=(stride, dtype.itemsize))

    def _replaced(self, array: NDArray[Any], sparse: object, name: str) -> NDArray[Any]:
        """An accessor in which some items are replaced by others."""
        parts = (sparse.get("indices"), sparse.get("values")) if isinstance(sparse, dict) else (None, None)
        where, values = parts
        if not isinstance(sparse, dict) or not isinstance(where, dict) or not isinstance(values, dict):
            raise GeometryReadError(f"damaged: {name} is not a whole sparse accessor")
        component, count = where.get("componentType"), natural(sparse, "count")
        if component not in (5121, 5123, 5125) or count > len(array):
            raise GeometryReadError(f"damaged: {name} replaces {count} of {len(array)} items by unknown indices")
        indices = self._dense(where, f"sparse {name}", np.dtype(_COMPONENTS[component]), count, 1).ravel()
        if int(indices[-1]) >= len(array) or (indices[1:] <= indices[:-1]).any():
            raise GeometryReadError(f"damaged: the sparse indices of {name} do not increase within {len(array)} items")
        result = array.copy()
        result[indices] = self._dense(values, f"sparse {name}", array.dtype, count, array.shape[1])
        return result


def unit_range(array: NDArray[Any], normalized: bool) -> Float64Array:
    """Return numbers as float64; integers that are ``normalized`` are divided by the largest of their type."""
    if not normalized or array.dtype.kind not in "iu":
        return array.astype(np.float64)
    return np.maximum(array / np.iinfo(array.dtype).max, -1.0)
