"""Points averaged in the cells of a cubic lattice: a surface sampled at one spacing, whatever the density was."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fsh3d_o3d._validation import Float64Array, IntArray

_LARGEST_CELL = 2.0**62  # number of a cell along an axis that int64 still holds
_LARGEST_KEY = 2**62  # cells in the box around all, up to which one int64 numbers them
_COARSE = 3.0  # cells: the lattice on which densities are added up; a choice
_SMOOTH = 4.0  # cells: radius of the window in which points make a density, a choice

_WINDOW = np.pi / 2 * _SMOOTH**2  # squares of the spacing: the integral of the window over a plane


def voxel_means(points: Float64Array, spacing: float) -> Float64Array:
    """Return the means (m, 3) of the points (n, 3) in each cell of a lattice through the origin, in the cells' order.

    A mean depends on the points of its own cell and on nothing else.
    """
    order, start = voxel_cells(points, spacing)
    count = np.diff(start, append=len(points))
    return np.asarray(np.add.reduceat(points[order], start, axis=0) / count[:, None])


def voxel_samples(points: Float64Array, spacing: float) -> tuple[Float64Array, Float64Array]:
    """Return ``voxel_means`` and the area (m,) that each stands for, in squares of the spacing.

    A cell that the surface only grazes holds few points: their number over the density around tells the area, whether
    the points lie dense or sparse. What lies farther than twelve cells has no influence.
    """
    order, start = voxel_cells(points, spacing)
    count = np.diff(start, append=len(points)).astype(np.float64)
    means = np.add.reduceat(points[order], start, axis=0) / count[:, None]
    return means, np.asarray(count / _density(means, count, spacing))


def _density(points: Float64Array, count: Float64Array, spacing: float) -> Float64Array:
    """Points a square of the spacing, around each of the means; smoothed over places a few cells apart."""
    order, start = voxel_cells(points, _COARSE * spacing)
    size = np.diff(start, append=len(points))
    places = np.add.reduceat(points[order], start, axis=0) / size[:, None]
    reach = _SMOOTH * spacing
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(places), reach, output_type="ndarray")
    weight, row, column = 1 - (pairs["v"] / reach) ** 2, pairs["i"], pairs["j"]
    there = np.bincount(column, weights=weight * count[row], minlength=len(places)) / _WINDOW
    here = np.bincount(row, weights=weight * there[column], minlength=len(points))
    # The mean of a coarse cell may lie farther than the window from a point of it, as √3 · 3 cells are more than 4.
    own = np.empty(len(points))
    own[order] = np.repeat(np.maximum(there, 1 / _WINDOW), size)
    total = np.bincount(row, weights=weight, minlength=len(points))
    return np.asarray(np.where(total > 0, here / np.maximum(total, np.finfo(np.float64).tiny), own))


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
