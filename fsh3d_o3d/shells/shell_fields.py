"""Fields of a surface on concentric shells: what a descriptor transforms, (fields, shells, directions).

Lengths are in RMS radii of the surface, the origin is its area centroid. Two routes lead to a field: ``"voxel"``
blurs the surface's area or measures distances on a grid and interpolates; ``"exact"`` takes the closest point.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from fsh3d_o3d._validation import Float64Array, choice, integer, number
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import Surface, UnitScene, nearest_distances, point_triangle_distance
from fsh3d_o3d.shells.voxel_fields import VoxelGrid

Route = Literal["voxel", "exact"]
Distance = Literal["soft", "nearest"]


@value
class ShellFields:
    """Which fields are sampled on which shells; checked when made."""

    shells: int
    """S: radii are (i + ½)/S of ``radius``."""
    radius: float
    """Outer radius, at least 1. Area beyond is left out on the voxel route."""
    route: Route
    """``"voxel"`` or ``"exact"``."""
    distance: Distance
    """``"soft"``: soft minimum over the area, voxel route only. ``"nearest"``: to the closest point."""
    widths: tuple[float, ...]
    """σ of one field exp(−d²/2σ²) each, d being the distance."""
    smoothing: float
    """Width of the soft minimum."""
    normal_width: float | None
    """σ of the field of normals, the mean of (n·r)² times exp(−d²/2σ²), or None for no such field."""
    normal_smoothing: float
    """Width of the average in the field of normals, which is on the voxel grid on both routes."""
    voxels: int
    """Nodes along each side of the grid, which spans the outer radius."""

    def __post_init__(self) -> None:
        integer(self.shells, "shells", minimum=1, maximum=1024)
        number(self.radius, "radius", minimum=1, maximum=100)
        choice(self.route, "route", ("voxel", "exact"))
        choice(self.distance, "distance", ("soft", "nearest"))
        integer(self.voxels, "voxels", minimum=8, maximum=256)
        if self.route == "exact" and self.distance == "soft":
            raise ValueError('distance="soft" exists on the voxel route only; the exact route needs distance="nearest"')
        if not isinstance(self.widths, tuple):
            raise TypeError(f"widths must be a tuple of numbers, got {type(self.widths).__name__}")
        lengths = [("widths", width) for width in self.widths]
        lengths += [("smoothing", self.smoothing), ("normal_smoothing", self.normal_smoothing)]
        if self.normal_width is not None:
            lengths.append(("normal_width", self.normal_width))
        for name, length in lengths:
            number(length, name, minimum=1e-3, maximum=100)
        if self.count == 0:
            raise ValueError("there must be a field: give widths, or a normal_width")

    @property
    def count(self) -> int:
        """Number of fields: one a width, then the field of normals."""
        return len(self.widths) + (self.normal_width is not None)

    @property
    def radii(self) -> Float64Array:
        """(S,) radii of the shells."""
        return np.asarray((np.arange(self.shells) + 0.5) / self.shells * self.radius)


class ShellSampler:
    """A plan: fields of any surface on the same shells at the same directions. May be used from several threads.

    Args:
        fields: Which fields, which shells.
        directions: (n, 3) unit vectors.
    """

    def __init__(self, fields: ShellFields, directions: Float64Array) -> None:
        self.fields = fields
        self._points = (fields.radii[:, None, None] * directions).reshape(-1, 3)
        needed = fields.route == "voxel" or fields.normal_width is not None
        self._grid = VoxelGrid(self._points, fields.radius, fields.voxels) if needed else None

    def sample(self, surface: Surface) -> Float64Array:
        """Return the fields (fields, S, n): every width, then the normals.

        Raises:
            GeometryError: None of the surface lies within the shells.
        """
        wanted, grid = self.fields, self._grid
        soft = wanted.distance == "soft" or wanted.normal_width is not None
        deposit = grid.deposit(surface) if grid is not None and soft else None
        values = []
        if wanted.widths:
            if grid is None or wanted.route == "exact":
                square = squared_distances(surface, self._points)
            elif deposit is not None and wanted.distance == "soft":
                square = grid.squared_soft_distances(deposit, wanted.smoothing)
            else:
                square = grid.squared_distances(surface)
            values += [np.exp(square * (-0.5 / width**2)) for width in wanted.widths]
        if grid is not None and deposit is not None and wanted.normal_width is not None:
            values.append(grid.radial_normals(deposit, wanted.normal_smoothing, wanted.normal_width))
        return np.stack(values).reshape(len(values), wanted.shells, -1)


def squared_distances(surface: Surface, points: Float64Array) -> Float64Array:
    """Return the squared distance (n,) from points to the closest point of the surface, in float64.

    For clouds it is the distance to the nearest point.
    """
    if surface.triangles is None:
        return nearest_distances(points, surface.vertices) ** 2
    scene = UnitScene(surface.vertices, surface.triangles)
    return np.asarray(point_triangle_distance(points, scene.corners[scene.closest(points)]) ** 2)
