"""Distances of shapes that are aligned first, for the best candidates of a search.

A rotation-invariant feature does not know how degrees sit relative to each other. Coefficients do, once the rotation
that takes one shape to the other is found. Two shapes at their best rotation are compared by

    d(a, b) = 2 Σ|√a − √b| / Σ(|√a| + |√b|),    √ with the sign of its argument,

in the principal axes of the one and of the other, on average: L1 and the root let many small differences count beside
a few large ones, and the principal axes make coefficients of symmetric shapes sparse, whatever pose a file has. Signs
of axes do not matter: half a turn about an axis changes no more than signs of coefficients.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere import estimate_rotations, parity, resolve_threads, rotate_each, run_all, single_threaded_blas

__all__ = ["signature_distances", "fits_only_mirrored", "mixed_distances"]

_ALIGNED_SHARE = 0.5  # of the aligned distance in the mix; anything from 0.4 to 0.6 does
# Of what depends on direction in one shape and differs in the other. 22 symmetric shapes and copies of them, turned,
# subdivided and mirrored, are at most 0.09 apart, and mirrored or not within 0.01 of the same; mirrored brackets are
# 0.56 apart when turned and 0.02 when mirrored, animals in one pose 0.1 … 0.5 and 0.02.
_MIRROR_MARGIN = 0.04  # relative distance by which a mirror image has to be nearer
_MIRROR_RATIO = 0.5  # of the distance of the best rotation, at most, that a mirror image may have
_CANDIDATES_A_JOB = 64  # fixed, so that results do not depend on the number of threads


def signature_distances(
    query: object, candidates: object, *, threads: int | None = None
) -> tuple[Float64Array, Float64Array]:
    """Return the distance of each candidate to the query after alignment, and the rotation that aligns it.

    Symmetric up to rounding where the same maximum of the correlation is found from both sides.

    Args:
        query: (R, b²) ``ShapeSignature.coefficients``.
        candidates: (n, R, b²) of the same option and bandwidth.
        threads: At most this many; None: what the process may use. The result does not depend on it.

    Returns:
        Distances (n,) in [0, 2] and rotations (n, 3, 3), which take each candidate's coefficients to the query's.

    Raises:
        ValueError: Wrong shapes, not finite.
    """
    one, _ = check.coefficients(query, "query")
    many, _ = check.coefficients(candidates, "candidates")
    if one.ndim != 2 or many.ndim != 3 or many.shape[1:] != one.shape:
        raise ValueError(f"candidates must have shape (n, R, b²) and query (R, b²), got {many.shape} and {one.shape}")
    own, others = one.astype(np.float64), many.astype(np.float64)
    threads = resolve_threads(threads)
    rotations, _ = estimate_rotations(_without_mean(others), _without_mean(own), threads=threads)
    distances = np.empty(len(others))

    def compare(start: int) -> None:
        part = slice(start, start + _CANDIDATES_A_JOB)
        here = _root_distance(own[None], rotate_each(others[part], rotations[part]))
        there = _root_distance(rotate_each(own[None], rotations[part], inverse=True), others[part])
        distances[part] = (here + there) / 2

    with single_threaded_blas():
        jobs = [lambda start=start: compare(start) for start in range(0, len(others), _CANDIDATES_A_JOB)]
        run_all(jobs, threads)
    return distances, rotations


def mixed_distances(features: FloatArray, aligned: FloatArray) -> Float64Array:
    """Return the distances by which candidates are re-ranked: of the features and of the aligned shapes, weighted."""
    return np.asarray((1 - _ALIGNED_SHARE) * features + _ALIGNED_SHARE * aligned, dtype=np.float64)


def fits_only_mirrored(query: object, candidates: object, *, threads: int | None = None) -> NDArray[np.bool_]:
    """Tell which candidates are clearly nearer to the query as mirror images than at any rotation: left and right.

    What is symmetric to a plane fits both ways, and is not among them. Compared are relative distances in L2, which
    give little weight to the many small coefficients that only differ by where a surface was sampled.

    Args:
        query: (R, b²) ``ShapeSignature.coefficients``.
        candidates: (n, R, b²) of the same option and bandwidth.
        threads: At most this many; None: what the process may use. The result does not depend on it.

    Returns:
        (n,) bool.

    Raises:
        ValueError: Wrong shapes, not finite.
    """
    one, b = check.coefficients(query, "query")
    many, _ = check.coefficients(candidates, "candidates")
    if one.ndim != 2 or many.ndim != 3 or many.shape[1:] != one.shape:
        raise ValueError(f"candidates must have shape (n, R, b²) and query (R, b²), got {many.shape} and {one.shape}")
    own, others = _without_mean(one.astype(np.float64)), _without_mean(many.astype(np.float64))
    sizes = np.square(own).sum() + np.square(others).sum(axis=(1, 2))
    apart = []
    for rows in (others, others * parity(b)):
        agreement = estimate_rotations(rows, own, threads=threads)[1]
        apart.append(np.sqrt(np.maximum(sizes - 2 * agreement, 0) / np.maximum(sizes / 2, np.finfo(float).tiny)))
    turned, mirrored = apart
    return np.asarray((mirrored < turned - _MIRROR_MARGIN) & (mirrored < _MIRROR_RATIO * turned))


def _without_mean(rows: Float64Array) -> Float64Array:
    """Without degree 0, which no rotation changes."""
    return np.concatenate((np.zeros((*rows.shape[:-1], 1)), rows[..., 1:]), axis=-1)


def _root_distance(first: Float64Array, second: Float64Array) -> Float64Array:
    left, right = _roots(first), _roots(second)
    total = np.abs(left).sum(axis=(1, 2)) + np.abs(right).sum(axis=(1, 2))
    return np.asarray(2 * np.abs(left - right).sum(axis=(1, 2)) / np.maximum(total, np.finfo(float).tiny))


def _roots(values: Float64Array) -> Float64Array:
    return np.copysign(np.sqrt(np.abs(values)), values)
