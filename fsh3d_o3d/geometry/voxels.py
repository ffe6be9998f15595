"""Points averaged in the cells of a cubic lattice: a surface sampled at one spacing, whatever the density was."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray

_LARGEST_CELL = 2.0**62  # number of a cell along an axis that int64 still holds
_LARGEST_KEY = 2**62  # cells in the box around all, up to which one int64 numbers them


def voxel_means(points: Float64Array, spacing: float) -> Float64Array:
    """Return the means (m, 3) of the points (n, 3) in each cell of a lattice through the origin, in the cells' order.

    A mean depends on the points of its own cell and on nothing else.
    """
    order, start = voxel_cells(points, spacing)
    count = np.diff(start, append=len(points))
    return np.asarray(np.add.reduceat(points[order], start, axis=0) / count[:, None])


def voxel_cells(points: Float64Array, spacing: float) -> tuple[IntArray, IntArray]:
    """Group points (n, 3) by their cells: an order (n,) of the points, and where in it each cell begins (m,)."""
    cell = np.clip(np.floor(points / spacing), -_LARGEST_CELL, _LARGEST_CELL).astype(np.int64)
    cell -= cell.min(axis=0)
    size = [int(extent) + 1 for extent in cell.max(axis=0)]
    if size[0] * size[1] * size[2] < _LARGEST_KEY:
        key = (cell[:, 2] * size[1] + cell[:, 1]) * size[0] + cell[:, 0]
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.concatenate(([True], key[1:] != key[:-1]))
    else:
        order = np.lexsort(cell.T)
        cell = cell[order]
        first = np.concatenate(([True], (cell[1:] != cell[:-1]).any(axis=1)))
    return order, np.flatnonzero(first)
