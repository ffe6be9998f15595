"""Where a surface is, as a hashed lattice of cells: thousands of points are looked up in a millisecond.

``Occupancy.of(points, cell)``, then ``occupancy.shares(poses, probes)``: the share of probes that each pose takes to
the surface, for hundreds of poses.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.registration.fit import Poses

_FACTORS = np.array([73856093, 19349663, 83492791])  # Teschner et al. 2003; lattices of any extent into one table
_TABLE = 2**20  # entries of one byte, so that the table stays in the cache; a few in a hundred are full by chance
_FARTHEST = 2.0**38  # cells; farther points count as this far, so that the products with the factors fit int64


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Cells that points lie in or beside."""

    table: NDArray[np.bool_]
    """Whether a cell of that hash is occupied."""
    cell: float
    """Edge of a cell."""

    @classmethod
    def of(cls, points: Float64Array, cell: float) -> Occupancy:
        """Mark the cells of points (n, 3) and those that share a face with them.

        What is marked lies within two cells of a point; all that is nearer than half a cell along an axis is.
        """
        own = _cells(points, cell)
        table = np.zeros(_TABLE, dtype=np.bool_)
        for axis, step in itertools.product(range(3), (-1, 0, 1)):
            table[(own + step * _FACTORS[axis]) % _TABLE] = True
        return cls(table, cell)

    def shares(self, poses: Poses, probes: Float64Array) -> Float64Array:
        """The share (k,) of probes (m, 3) of the source that lie on the surface in each pose."""
        return np.asarray(self.table[_cells(poses.apply(probes), self.cell) % _TABLE].mean(axis=1))


def _cells(points: Float64Array, cell: float) -> IntArray:
    """Hashes (…) of the cells of points (…, 3), not yet wrapped to the table: they add up."""
    lattice = np.clip(np.floor(points / cell), -_FARTHEST, _FARTHEST).astype(np.int64)
    return np.asarray(lattice @ _FACTORS)
