"""Vectors of an index in one byte a number, and short sketches of them by which to search (private).

A number x is stored as the nearest multiple of a common step to sign(x)·√|x|: small numbers, of which descriptors have
most, keep more digits than large ones. What that costs in retrieval is measured in ``docs/library.md``.

A sketch is a projection of the signed roots onto fixed random signs. By Johnson and Lindenstrauss (1984; signs:
Achlioptas 2003) it keeps Euclidean distances to 1/√128 or so, and

    Σ(√a − √b)² ≤ 2 Σ|a − b|    (with signs; without the 2 where they agree),

so that near in L1 is near in the sketch. It does not depend on the rows of an index: new rows need no training.
"""

from __future__ import annotations

import functools
import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.descriptors import SHDOption

ALIGNED_DEGREES = 8
"""Degrees below this are kept for alignment."""
SKETCH_LENGTH = 128
"""Numbers in a sketch."""
_LARGEST = 127  # of an int8
_BLOCK = 256  # rows that are decoded at once: their float32 fit the cache


def encoded(vectors: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Return codes (n, d) and steps (n,) of vectors (n, d)."""
    roots = np.copysign(np.sqrt(np.abs(vectors, dtype=np.float32)), vectors)
    steps = np.abs(roots).max(axis=1) / np.float32(_LARGEST)
    scale = np.where(steps > 0, steps, np.float32(1))
    return np.round(roots / scale[:, None]).astype(np.int8), steps.astype(np.float32)


def decoded(codes: NDArray[np.int8], steps: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the vectors (n, d) float32 that codes and steps stand for."""
    result = np.empty(codes.shape, dtype=np.float32)
    for start in range(0, len(codes), _BLOCK):
        part = slice(start, start + _BLOCK)
        roots = codes[part].astype(np.float32)
        np.multiply(roots, np.abs(roots), out=result[part])
        result[part] *= np.square(steps[part])[:, None]
    return result


def sketches(codes: NDArray[np.int8], steps: NDArray[np.float32]) -> NDArray[np.float16]:
    """Return sketches (n, SKETCH_LENGTH); the squared distance of two is about that of the signed roots."""
    roots = codes.astype(np.float32) * steps[:, None]
    return (roots @ _signs(codes.shape[1])).astype(np.float16)


def signature_type(option: SHDOption) -> np.dtype[Any]:
    """Return how a row's numbers lie in its ``signature``: in one piece, because a piece is what a read costs."""
    length = option.feature_shape[0] * option.feature_shape[1]
    coefficients = functions_of(option) * min(ALIGNED_DEGREES, option.bandwidth) ** 2
    return np.dtype(
        [
            ("frame", "<f8", 13),  # centroid, RMS radius, principal axes
            ("feature_step", "<f4"),
            ("feature", "i1", length),
            ("coefficients_step", "<f4"),
            ("coefficients", "i1", coefficients),
            ("checksum", "<u4"),  # CRC-32 of all before it
        ]
    )


def functions_of(option: SHDOption) -> int:
    """Return the number R of functions on the sphere behind a feature."""
    return len(option.frames) * option.shell_fields.count * option.rows


@functools.lru_cache(maxsize=4)
def _signs(length: int) -> NDArray[np.float32]:
    """(length, SKETCH_LENGTH) of ±1/√SKETCH_LENGTH from a hash function, which no library's next version changes."""
    stream = hashlib.shake_128(b"fsh3d_o3d sketch 1").digest(length * SKETCH_LENGTH // 8)
    bits = np.unpackbits(np.frombuffer(stream, dtype=np.uint8)).reshape(length, SKETCH_LENGTH)
    return (2 * bits.astype(np.float32) - 1) / np.float32(np.sqrt(SKETCH_LENGTH))
