"""The solid that a triangle soup encloses, on a grid: all vertices that cannot be reached from outside.

Outside begins where the grid's end can be reached without coming nearer to the surface than a grid cell is wide: cracks
and holes up to that width do not leak. From there it grows a few steps through edges of the grid that do not cross the
surface, up to the surface itself and into its creases. What remains is the solid: closed bodies, whatever lies within
them, and of sheets with outside on both sides the vertices nearest to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.closing.kuhn_grid import NEIGHBORS, flat_offsets, structure
from fsh3d_o3d.geometry import BoolArray, UnitScene, closest_points

REACH = 2.0
"""Distances are exact below this many grid cells."""
_SEALED = 0.88  # of a cell: just above half of its diagonal, the longest edge, so that a sheet seals its two sides
_GROWTH_STEPS = 2  # through edges that do not cross the surface: enough from _SEALED to the surface
_COARSEST_BLOCK = 16  # vertices along an edge, a power of two; a choice
_DISTANCE_ERROR = 1e-3  # cells, more than float32 gets wrong on grids of thousands of cells


@dataclass(frozen=True, eq=False)
class Enclosure:
    """The solid on a grid."""

    kept: BoolArray
    """(nx, ny, nz) vertices that are not outside."""
    distance: Float64Array
    """(nx, ny, nz) distance to the surface in cells, exact below ``REACH``, ``REACH`` beyond."""
    thin: BoolArray
    """(nx, ny, nz) kept vertices that are there for a sheet, not for a solid."""


def enclose(scene: UnitScene, shape: tuple[int, int, int]) -> Enclosure:
    """Return the solid of a surface given in units of the grid, whose vertices are at 0 … n − 1 along each axis.

    The surface must stay three cells clear of the ends of the grid.
    """
    distance, touched = _near_surface(scene, shape)
    parts = scipy.ndimage.label(distance > _SEALED, structure())[0]
    outside = np.asarray(parts == parts[0, 0, 0])
    flat, reach = outside.ravel(), distance.ravel()
    grid = _Edges(scene, reach, shape)
    front = np.flatnonzero(reach <= _SEALED)
    grown = np.zeros(0, dtype=np.int64)
    for _ in range(_GROWTH_STEPS):
        start, end = grid.edges(front[~flat[front]], flat)
        new = np.unique(start[~grid.crossed(start, end)])
        flat[new] = True
        grown = np.concatenate((grown, new))
    # Where an edge between two vertices of the outside crosses the surface, there is a sheet: it keeps the nearer end.
    start, end = grid.edges(grown, flat)
    cut = grid.crossed(start, end)
    start, end = start[cut], end[cut]
    # A wire may cross no edge. It keeps the vertices in whose unit cubes it runs, unless they touch a solid.
    thin = touched & outside & ~scipy.ndimage.binary_dilation(~outside, structure())
    thin.ravel()[np.where(reach[start] <= reach[end], start, end)] = True
    return Enclosure(~outside | thin, distance, thin)


class _Edges:
    """Edges of the grid, and whether they cross a surface."""

    def __init__(self, scene: UnitScene, distance: Float64Array, shape: tuple[int, int, int]) -> None:
        self._scene = scene
        self._distance = distance
        self._shape = shape
        self._offsets = flat_offsets(NEIGHBORS, shape)

    def edges(self, vertices: IntArray, mask: BoolArray) -> tuple[IntArray, IntArray]:
        """Return the edges from vertices (flat indices) to those of their neighbours that are in the mask."""
        ends = vertices[:, None] + self._offsets
        row, column = np.nonzero(mask[ends])
        return vertices[row], ends[row, column]

    def crossed(self, start: IntArray, end: IntArray) -> BoolArray:
        """Return which edges cross the surface."""
        low, high = np.minimum(start, end), np.maximum(start, end)  # one answer for both directions
        origin = np.stack(np.unravel_index(low, self._shape), axis=1).astype(np.float64)
        along = np.stack(np.unravel_index(high, self._shape), axis=1) - origin
        length = np.linalg.norm(along, axis=1)
        crossed = self._distance[start] + self._distance[end] <= length + _DISTANCE_ERROR
        which = np.flatnonzero(crossed)
        crossed[which] = self._scene.cast(origin[which], along[which])[0] <= 1
        return np.asarray(crossed)


def _near_surface(scene: UnitScene, shape: tuple[int, int, int]) -> tuple[Float64Array, BoolArray]:
    """Distances up to ``REACH``, and the vertices whose unit cubes hold their closest point of the surface.

    By halving the blocks of vertices that the surface may be near.
    """
    size = _COARSEST_BLOCK
    axes = (np.arange(0, n, size) for n in shape)
    blocks = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    while size > 1:
        middle = blocks.astype(np.float64) + (size - 1) / 2
        away = np.linalg.norm(closest_points(scene, middle) - middle, axis=1)
        near = blocks[away <= REACH + np.sqrt(3) / 2 * (size - 1) + _DISTANCE_ERROR]
        size //= 2
        halves = size * np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        blocks = (near[:, None] + halves).reshape(-1, 3)
        blocks = blocks[(blocks < shape).all(axis=1)]
    away = closest_points(scene, blocks.astype(np.float64)) - blocks
    distance, touched = np.full(shape, REACH), np.zeros(shape, dtype=np.bool_)
    distance[tuple(blocks.T)] = np.minimum(np.linalg.norm(away, axis=1), REACH)
    touched[tuple(blocks.T)] = np.abs(away).max(axis=1) <= 0.5 + _DISTANCE_ERROR
    return distance, touched
