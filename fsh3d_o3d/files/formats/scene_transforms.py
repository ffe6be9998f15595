"""Transforms of scenes as (3, 4) matrices: moves, turns, scales, one after another."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array

IDENTITY: Float64Array = np.eye(3, 4)
"""That leaves everything where it is."""


def composed(*transforms: Float64Array) -> Float64Array:
    """Return the transform that applies the last one first."""
    result = IDENTITY
    for inner in transforms:
        moved = result[:, :3] @ inner
        moved[:, 3] += result[:, 3]
        result = moved
    return result


def translation(vector: Float64Array) -> Float64Array:
    """Return a move."""
    return np.hstack([np.eye(3), np.reshape(vector, (3, 1))])


def scaling(factors: Float64Array) -> Float64Array:
    """Return a scale along each axis."""
    return np.hstack([np.diag(factors), np.zeros((3, 1))])


def rotation(axis: Float64Array, angle: float) -> Float64Array:
    """Return a turn by an angle in radians; about no axis, none."""
    length = float(np.linalg.norm(axis))
    if not np.isfinite(length) or length == 0:
        return IDENTITY
    x, y, z = axis / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return np.hstack([turn, np.zeros((3, 1))])


def is_finite(transform: Float64Array) -> bool:
    """Return whether all its numbers are finite."""
    return bool(np.isfinite(transform).all())
