"""Transforms of glTF nodes and instances: (…, 3, 4) matrices, many at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source

_LARGEST = 1e100  # in units of the file; no length that anyone means; its square is still finite
_UNIT_TOLERANCE = 1e-3  # how far a quaternion may be from length 1: rounding to three decimals is no fault


def local_transforms(source: Source, nodes: Sequence[dict[str, Any]]) -> Float64Array:
    """Return each node's own transform (n, 3, 4)."""
    moved, turned, scaled, given = _Rows("translation", 3), _Rows("rotation", 4), _Rows("scale", 3), _Rows("matrix", 16)
    for row, node in enumerate(nodes):
        if "matrix" in node:
            given.add(row, node["matrix"])
            continue
        for rows in (moved, turned, scaled):
            if rows.name in node:
                rows.add(row, node[rows.name])
    result = np.zeros((len(nodes), 3, 4))
    result[:, [0, 1, 2], [0, 1, 2]] = 1
    if turned.at:
        result[turned.at, :, :3] = _rotations(source, turned.numbers())
    if scaled.at:
        result[scaled.at, :, :3] *= scaled.numbers()[:, None, :]
    if moved.at:
        result[moved.at, :, 3] = moved.numbers()
    if given.at:
        result[given.at] = given.numbers().reshape(-1, 4, 4).transpose(0, 2, 1)[:, :3]
    return result


def instance_transforms(
    source: Source,
    count: int,
    translation: Float64Array | None,
    rotation: Float64Array | None,
    scale: Float64Array | None,
) -> Float64Array:
    """Return the transforms (count, 3, 4) of instances, from what is given of (count, 3), (count, 4), (count, 3)."""
    result = np.zeros((count, 3, 4))
    result[:, [0, 1, 2], [0, 1, 2]] = 1
    if rotation is not None:
        result[:, :, :3] = _rotations(source, rotation)
    if scale is not None:
        result[:, :, :3] *= scale[:, None, :]
    if translation is not None:
        result[:, :, 3] = translation
    return result


def composed(outer: Float64Array, inner: Float64Array) -> Float64Array:
    """Return the transforms that apply ``inner`` first; both (…, 3, 4), broadcast."""
    result = outer[..., :3] @ inner
    result[..., 3] += outer[..., 3]
    return result


def placed(transforms: Float64Array, points: Float64Array) -> Float64Array:
    """Return points (v, 3) under each transform (k, 3, 4), as (k, v, 3)."""
    return points @ transforms[:, :, :3].transpose(0, 2, 1) + transforms[:, None, :, 3]


def turned_normals(transforms: Float64Array, normals: Float64Array) -> Float64Array:
    """Return normals (v, 3) under each transform (k, 3, 4), as (k, v, 3); lengths stay."""
    a, b, c = (transforms[:, :, i] for i in range(3))
    # The matrix of cofactors is the inverse transpose times the determinant: it also serves where there is no inverse.
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    cofactors[mirrors(transforms)] *= -1
    turned = normals @ cofactors.transpose(0, 2, 1)
    lengths = np.linalg.norm(turned, axis=2, keepdims=True)
    result: Float64Array = turned * (np.linalg.norm(normals, axis=1)[None, :, None] / np.where(lengths > 0, lengths, 1))
    return result


def mirrors(transforms: Float64Array) -> NDArray[np.bool_]:
    """Return which transforms (k, 3, 4) turn a surface inside out."""
    return cast(NDArray[np.bool_], np.linalg.det(transforms[:, :, :3]) < 0)


class _Rows:
    """Numbers that some nodes have and others have not."""

    def __init__(self, name: str, width: int) -> None:
        self.name = name
        self.width = width
        self.at: list[int] = []
        self.values: list[list[float]] = []

    def add(self, row: int, value: object) -> None:
        if (
            not isinstance(value, list)
            or len(value) != self.width
            or not all(type(number) is float or type(number) is int for number in value)
        ):
            raise self._error()
        self.at.append(row)
        self.values.append(value)

    def numbers(self) -> Float64Array:
        try:
            array = np.array(self.values, dtype=np.float64)
        except OverflowError:
            raise self._error() from None
        if not (np.abs(array) <= _LARGEST).all():
            raise self._error()
        return array

    def _error(self) -> GeometryReadError:
        return GeometryReadError(f"damaged: {self.name} of a node must be {self.width} numbers")


def _rotations(source: Source, quaternions: Float64Array) -> Float64Array:
    """(n, 3, 3) rotations by x, y, z, w."""
    lengths = np.linalg.norm(quaternions, axis=1)
    off: IntArray = np.flatnonzero(np.abs(lengths - 1) > _UNIT_TOLERANCE)
    if len(off):
        source.note(f"rotations that are not unit quaternions were normalised: {len(off)}")
    units = np.where(lengths[:, None] > 0, quaternions, [0, 0, 0, 1]) / np.where(lengths > 0, lengths, 1)[:, None]
    x, y, z, w = units.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
