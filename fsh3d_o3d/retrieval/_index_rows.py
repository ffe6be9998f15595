"""Rows of an index: from what was found in a file, and back to numbers that can be compared (private)."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.descriptors import ShapeSignature, SHDOption
from fsh3d_o3d.retrieval._index_codec import decoded, encoded, functions_of, signature_type, sketches
from fsh3d_o3d.retrieval._index_errors import ShapeIndexError
from fsh3d_o3d.retrieval._index_extraction import Described, frame_numbers, identity
from fsh3d_o3d.retrieval._index_store import fixed_lists


@dataclass(frozen=True, eq=False)
class Signatures:
    """What is compared, of some rows of an index or of a query; as it comes back from storage."""

    features: NDArray[np.float32]
    """(n, d)."""
    sketches: NDArray[np.float32]
    """(n, SKETCH_LENGTH), or (0, …) where they were not asked for."""
    coefficients: NDArray[np.float32]
    """(n, R, b²)."""
    frames: Float64Array
    """(n, 13): centroid, RMS radius, principal axes."""

    @classmethod
    def of(cls, signature: ShapeSignature) -> Signatures:
        """Return a query, rounded as if it had been stored: the same file is at distance 0 from itself."""
        codes, steps = encoded(signature.feature[None])
        low = encoded(signature.coefficients.reshape(1, -1))
        return cls(
            features=decoded(codes, steps),
            sketches=sketches(codes, steps).astype(np.float32),
            coefficients=decoded(*low).reshape(1, *signature.coefficients.shape),
            frames=frame_numbers(signature)[None],
        )


def model_columns(paths: Sequence[str], found: Sequence[Described], option: SHDOption) -> dict[str, Any]:
    """Return the columns of files that were described."""
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
        "sketch": fixed_lists(sketches(rows["feature"], rows["feature_step"])),
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


def signatures(column: Any, option: SHDOption, where: str) -> Signatures:
    """Return what the column ``signature`` of an Arrow table holds.

    Raises:
        ShapeIndexError: A row does not fit its checksum.
    """
    rows = np.frombuffer(b"".join(column.to_pylist()), dtype=signature_type(option))
    wrong = int(np.count_nonzero(_checksums(rows) != rows["checksum"]))
    if wrong:
        raise ShapeIndexError(f"{where}: the index is damaged: {wrong} rows do not fit their checksums")
    coefficients = decoded(rows["coefficients"], rows["coefficients_step"])
    functions = functions_of(option)
    return Signatures(
        features=decoded(rows["feature"], rows["feature_step"]),
        sketches=np.empty((0, 0), np.float32),
        coefficients=coefficients.reshape(len(rows), functions, coefficients.shape[1] // functions),
        frames=np.array(rows["frame"]),
    )


def _checksums(rows: NDArray[Any]) -> NDArray[np.uint32]:
    """CRC-32 (n,) of rows: storage that flips a bit is found out, not believed."""
    bare = rows.dtype.itemsize - rows.dtype["checksum"].itemsize
    parts = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), rows.dtype.itemsize)
    return np.array([zlib.crc32(part[:bare].tobytes()) for part in parts], dtype=np.uint32)
