"""The cubic grid on which a field in a ball is decoded."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value

_USUAL = (64, 256)  # points along an edge that a usual resolution stays within: 256³ take 4 GB, 512³ would 34


@value
class ShellVolume:
    """A field on a cubic grid: value [i, j, k] belongs to the point origin + spacing (i, j, k)."""

    values: Float64Array
    """(n, n, n), indexed by x, y, z. Read-only."""
    origin: Float64Array
    """(3,) where [0, 0, 0] lies, in the units of the input. Read-only."""
    spacing: float
    """Distance of neighbours along an axis, in the units of the input."""

    def __post_init__(self) -> None:
        for array in (self.values, self.origin):
            array.setflags(write=False)


def cube_resolution(points_per_side: object | None, bandwidth: int, shells: int) -> int:
    """Points along an edge, if not given enough for the bandwidth and the shells.

    Raises:
        MemoryEstimateError: The grid would not fit in memory.
    """
    low, high = _USUAL
    usual = max(low, min(high, max(2 * shells, 4 * bandwidth)))
    n = usual if points_per_side is None else check.integer(points_per_side, "points_per_side", minimum=8, maximum=4096)
    check.memory(250.0 * n**3, f"a grid of {n}³ points")
    return n


def cube_points(n: int, reach: float) -> Float64Array:
    """The points (n³, 3) of the grid from −reach to reach along each axis, the last axis fastest."""
    axis = np.linspace(-reach, reach, n)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
