"""Rows of an index: from what was found in a file, and back to numbers that can be compared."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors import ShapeSignature, SHDOption
from fsh3d_o3d.index.codec import decoded, encoded, functions_of, signature_type, sketches
from fsh3d_o3d.index.columns import fixed_lists
from fsh3d_o3d.index.errors import ShapeIndexError
from fsh3d_o3d.index.extraction import Described, frame_numbers, identity


@value
class Query:
    """What rows of an index are compared with; rounded as if stored: a file is at distance 0 from itself."""

    feature: NDArray[np.float32]
    """(d,)."""
    sketch: NDArray[np.float32]
    """(SKETCH_LENGTH,)."""
    coefficients: NDArray[np.float32]
    """(R, b²)."""
    frame: Float64Array
    """(13,): centroid, RMS radius, principal axes."""

    @classmethod
    def of(cls, signature: ShapeSignature, basis: NDArray[np.float16]) -> Query:
        """Return what is compared of a signature; ``basis`` is the index's, of its sketches."""
        feature = decoded(*encoded(signature.feature[None]))
        low = encoded(signature.coefficients.reshape(1, -1))
        return cls(
            feature=feature[0],
            sketch=sketches(feature, basis)[0].astype(np.float32),
            coefficients=decoded(*low).reshape(signature.coefficients.shape),
            frame=frame_numbers(signature),
        )


@dataclass(frozen=True, eq=False)
class StoredRows:
    """The numbers of some rows of an index, as they are stored; decoded as far as they are asked for."""

    numbers: NDArray[Any]
    """(n,) of ``signature_type``."""
    functions: int
    """R, of each row."""

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, which: slice | IntArray) -> StoredRows:
        return StoredRows(self.numbers[which], self.functions)

    @property
    def features(self) -> NDArray[np.float32]:
        """(n, d), computed."""
        return decoded(self.numbers["feature"], self.numbers["feature_step"])

    @property
    def coefficients(self) -> NDArray[np.float32]:
        """(n, R, b²), computed."""
        flat = decoded(self.numbers["coefficients"], self.numbers["coefficients_step"])
        return flat.reshape(len(self), self.functions, flat.shape[1] // self.functions)

    @property
    def frames(self) -> Float64Array:
        """(n, 13): centroid, RMS radius, principal axes."""
        return np.array(self.numbers["frame"])


def model_columns(
    paths: Sequence[str], found: Sequence[Described], option: SHDOption, basis: NDArray[np.float16]
) -> dict[str, Any]:
    """Return the columns of files that were described; ``basis`` is the index's, of its sketches."""
    own = [one.signature for one in found if one.signature is not None]
    rows = np.zeros(len(own), dtype=signature_type(option))
    rows["frame"] = np.stack([frame_numbers(one) for one in own])
    rows["feature"], rows["feature_step"] = encoded(np.stack([one.feature for one in own]))
    rows["coefficients"], rows["coefficients_step"] = encoded(np.stack([one.coefficients.ravel() for one in own]))
    rows["checksum"] = _checksums(rows)
    return {
        "path": [os.fsencode(path) for path in paths],
        "content": [one.content for one in found],
        "identity": [identity(path, one.content) for path, one in zip(paths, found, strict=True)],
        "size": [one.state.size for one in found],
        "mtime": [one.state.mtime for one in found],
        "vertices": [one.vertices for one in found],
        "triangles": [one.triangles for one in found],
        "watertight": [one.watertight for one in found],
        "option": [option.fingerprint] * len(found),
        "signature": [row.tobytes() for row in rows],
        "sketch": fixed_lists(sketches(decoded(rows["feature"], rows["feature_step"]), basis)),
        "thumbnail": [one.thumbnail for one in found],
    }


def moved_columns(rows: Any, paths: Sequence[str], found: Sequence[Described]) -> dict[str, Any]:
    """Return the columns of files whose content is known: those of ``rows`` (Arrow, in order) with their own names."""
    own = {
        "path": [os.fsencode(path) for path in paths],
        "size": [one.state.size for one in found],
        "mtime": [one.state.mtime for one in found],
    }
    return {name: own.get(name, rows[name]) for name in rows.column_names}


def stored_rows(column: Any, option: SHDOption, where: str) -> StoredRows:
    """Return what the column ``signature`` of an Arrow table holds.

    Raises:
        ShapeIndexError: A row does not fit its checksum.
    """
    kind = signature_type(option)
    rows = np.concatenate(
        [
            np.empty(0, kind),
            *(np.frombuffer(part.buffers()[1], kind, len(part), part.offset * kind.itemsize) for part in column.chunks),
        ]
    )
    wrong = int(np.count_nonzero(_checksums(rows) != rows["checksum"]))
    if wrong:
        raise ShapeIndexError(f"{where}: the index is damaged: {wrong} rows do not fit their checksums")
    return StoredRows(rows, functions_of(option))


def _checksums(rows: NDArray[Any]) -> NDArray[np.uint32]:
    """CRC-32 (n,) of rows: storage that flips a bit is found out, not believed."""
    bare = rows.dtype.itemsize - rows.dtype["checksum"].itemsize
    parts = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), rows.dtype.itemsize)
    return np.array([zlib.crc32(part[:bare].data) for part in parts], dtype=np.uint32)
