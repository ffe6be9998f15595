"""Vectors of an index in one byte a number, and short sketches of them by which to search.

A number x is stored as the nearest multiple of a common step to sign(x)·√|x|: small numbers, of which descriptors have
most, keep more digits than large ones. What that costs in retrieval is measured in ``docs/library.md``.

A sketch is a projection onto few orthogonal directions (``sketch_basis``) that keep most of what tells shapes apart.
Sketches of features find candidates. Sketches of their signed roots exclude: a projection makes no distance longer, and

    Σ(√a − √b)² ≤ 2 Σ|a − b|    (with signs; without the 2 where they agree),

so that what is near in L1 is near in the sketches of roots, without exception.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.descriptors import SHDOption

ALIGNED_DEGREES = 8
"""Degrees below this are kept for alignment, 64 numbers a function in one byte each; a choice."""
SKETCH_LENGTH = 128
"""Numbers in a sketch, 256 bytes as float16: with them a query of 10⁶ rows finds 99 % of the ten nearest."""
_LARGEST = 127  # value of an int8
_BLOCK = 64  # rows that are decoded at once: their float32 fit the cache


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


def sketches(vectors: NDArray[np.float32], basis: NDArray[np.float16]) -> NDArray[np.float16]:
    """Return sketches (n, SKETCH_LENGTH) of vectors (n, d); ``basis`` (d, SKETCH_LENGTH)."""
    largest = np.finfo(np.float16).max
    # Products of a row may depend on how many rows there are, but in float64 not before the digits that are cut off.
    product = vectors.astype(np.float64) @ basis.astype(np.float64)
    return np.clip(product, -largest, largest).astype(np.float16)


def shortened(vectors: NDArray[np.float32], basis: NDArray[np.float16]) -> NDArray[np.float32]:
    """Return sketches (n, SKETCH_LENGTH) float32, no two of which are further apart than the vectors are."""
    directions = basis.astype(np.float32)
    # Orthogonal but for their rounding: 128 columns, each by less than 2⁻¹¹ of its length, make √128 · 2⁻¹¹ < 0.01.
    directions /= np.linalg.norm(directions, axis=0).max() * np.float32(1.01)
    return np.asarray(vectors @ directions)


def signed_roots(codes: NDArray[np.int8], steps: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sign(x)·√|x| (n, d) of what codes and steps stand for."""
    return codes.astype(np.float32) * steps[:, None]


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
