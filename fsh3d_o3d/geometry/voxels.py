"""Points averaged in the cells of a cubic lattice: a surface sampled at one spacing, whatever the density was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value

_LARGEST_CELL = 2.0**62  # number of a cell along an axis that int64 still holds
_LARGEST_KEY = 2**62  # cells in the box around all times points, which one int64 numbers
_COARSE = 3.0  # cells: the lattice on which densities and normals are found; a choice
_SMOOTH = 3.0  # cells: radius of the window in which points make a density or a normal, a choice

_WINDOW = np.pi / 2 * _SMOOTH**2  # squares of the spacing: the integral of the window over a plane


def voxel_means(points: Float64Array, spacing: float) -> Float64Array:
    """Return the means (m, 3) of the points (n, 3) in each cell of a lattice through the origin, in the cells' order.

    A mean depends on the points of its own cell and on nothing else.
    """
    order, start = voxel_cells(points, spacing)
    count = np.diff(start, append=len(points))
    return np.asarray(_sums(points, order, start) / count[:, None])


@value
class ThinnedSurface:
    """A surface as points at one spacing, with the area that each stands for and the normal there."""

    points: Float64Array
    """(n, 3) means of the cells of a lattice."""
    areas: Float64Array
    """(n,) in squares of the spacing."""
    normals: Float64Array
    """(n, 3) unit normals up to their sign: where the points around spread least."""
    spacing: float
    """Edge of the cells."""

    def __len__(self) -> int:
        return len(self.points)

    def coarser(self, spacing: float) -> ThinnedSurface:
        """The same surface at a larger spacing."""
        order, start = voxel_cells(self.points, spacing)
        area = np.add.reduceat(self.areas[order], start)
        means = _sums(self.points * self.areas[:, None], order, start) / area[:, None]
        around = _Around.of(means, spacing)
        return ThinnedSurface(means, area * (self.spacing / spacing) ** 2, around.normals(), spacing)


def thinned_surface(points: Float64Array, spacing: float) -> ThinnedSurface:
    """Average points (n, 3) of any density in cells of a lattice through the origin.

    A cell that the surface only grazes holds few points: their number over the density around tells the area, whether
    the points lie dense or sparse. What lies farther than twelve cells has no influence.
    """
    order, start = voxel_cells(points, spacing)
    count = np.diff(start, append=len(points)).astype(np.float64)
    means = _sums(points, order, start) / count[:, None]
    around = _Around.of(means, spacing)
    return ThinnedSurface(means, count / around.density(count), around.normals(), spacing)


@dataclass(frozen=True, eq=False)
class _Around:
    """Which points lie around places a few cells apart: quantities that vary slowly are found there."""

    points: Float64Array
    """(n, 3)."""
    own: IntArray
    """(n,) the place in whose cell of the coarse lattice a point lies."""
    place: IntArray
    """(p,) of pairs."""
    point: IntArray
    """(p,) of pairs."""
    window: Float64Array
    """(p,) from 1 at the place to 0 a few cells from it."""

    @classmethod
    def of(cls, points: Float64Array, spacing: float) -> _Around:
        order, start = voxel_cells(points, _COARSE * spacing)
        size = np.diff(start, append=len(points))
        places = _sums(points, order, start) / size[:, None]
        own = np.empty(len(points), dtype=np.int64)
        own[order] = np.repeat(np.arange(len(places)), size)
        reach = _SMOOTH * spacing
        trees = (cKDTree(array, balanced_tree=False, compact_nodes=False) for array in (places, points))
        pairs = next(trees).sparse_distance_matrix(next(trees), reach, output_type="ndarray")
        place, point = np.ascontiguousarray(pairs["i"]), np.ascontiguousarray(pairs["j"])
        return cls(points, own, place, point, 1 - (pairs["v"] / reach) ** 2)

    def density(self, count: Float64Array) -> Float64Array:
        """Points a square of the spacing (n,), where each mean stands for ``count`` points."""
        there = self._at_places(self.window * count[self.point]) / _WINDOW
        total = np.bincount(self.point, self.window, len(self.points))
        smooth = np.bincount(self.point, self.window * there[self.place], len(self.points))
        # The mean of a coarse cell may lie farther than the window from a point of it.
        alone = np.maximum(there, 1 / _WINDOW)[self.own]
        return np.asarray(np.where(total > 0, smooth / np.maximum(total, np.finfo(np.float64).tiny), alone))

    def normals(self) -> Float64Array:
        """Unit vectors (n, 3) along which the points in the window of the own place spread least."""
        near = np.take((self.points - self.points[0]).T, self.point, axis=1)
        weighted = self.window * near
        total = np.maximum(self._at_places(self.window), np.finfo(np.float64).tiny)
        mean = np.stack([self._at_places(row) for row in weighted], axis=1) / total[:, None]
        scatter = np.empty((len(mean), 3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            scatter[:, i, j] = scatter[:, j, i] = (
                self._at_places(weighted[i] * near[j]) / total - mean[:, i] * mean[:, j]
            )
        return np.asarray(np.linalg.eigh(scatter)[1][:, :, 0][self.own])

    def _at_places(self, values: Float64Array) -> Float64Array:
        """Sums over the points around each place."""
        return np.asarray(np.bincount(self.place, values, int(self.own.max()) + 1), dtype=np.float64)


def voxel_cells(points: Float64Array, spacing: float) -> tuple[IntArray, IntArray]:
    """Group points (n, 3) by their cells: an order (n,) of the points, and where in it each cell begins (m,)."""
    rows = np.floor(np.ascontiguousarray(points.T) / spacing)
    cell = np.clip(rows, -_LARGEST_CELL, _LARGEST_CELL).astype(np.int64)
    cell -= cell.min(axis=1)[:, None]
    size = [int(extent) + 1 for extent in cell.max(axis=1)]
    bits = len(points).bit_length()
    if size[0] * size[1] * size[2] < _LARGEST_KEY >> bits:
        key = (cell[2] * size[1] + cell[1]) * size[0] + cell[0]
        # The index within the key: sorting numbers is faster than sorting indices by them.
        key = np.sort((key << bits) | np.arange(len(points)))
        order = key & ((1 << bits) - 1)
        key >>= bits
        first = key[1:] != key[:-1]
    else:
        order = np.lexsort(cell)
        cell = cell[:, order]
        first = (cell[:, 1:] != cell[:, :-1]).any(axis=0)
    return order, np.flatnonzero(np.concatenate(([True], first)))


def _sums(points: Float64Array, order: IntArray, start: IntArray) -> Float64Array:
    """Sums (m, 3) of the points of each cell."""
    return np.ascontiguousarray(np.add.reduceat(np.take(points.T, order, axis=1), start, axis=1).T)
