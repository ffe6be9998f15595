"""The cameras: of the thumbnails, orthographic and fitted to a bounding sphere; and of plotly on a page.

The view space of thumbnails has x to the right, y up, z towards the viewer, and the bounding sphere as its unit sphere.
Points go there in float64, so that what follows may work in float32 whatever the size and place of the geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsh3d_o3d._validation import Float64Array, point
from fsh3d_o3d.geometry import MeshArrays, PointArrays, UnitCube

DEFAULT_DIRECTION = (1.0, -1.5, 0.8)
"""From the geometry towards the viewer: three quarters from the front, a little from above."""
TOWARDS_VIEWER = np.array(DEFAULT_DIRECTION) / np.linalg.norm(DEFAULT_DIRECTION)
"""From the geometry to where plotly's camera stands at first, of length one."""
_FIELD = math.radians(45)  # of view of plotly's camera
_AROUND = 1.05  # of the distance from which a ball just fits: a little paper around it
_MARGIN = 1.04  # of the bounding sphere in the shorter side of the picture


@dataclass(frozen=True, eq=False)
class View:
    """A direction to look from and a bounding sphere to fit."""

    cube: UnitCube
    """Brings the geometry into the unit cube."""
    radius: float
    """Radius of the bounding sphere about the origin, in the unit cube."""
    axes: Float64Array
    """(3, 3) rows: right, up, towards the viewer."""

    @classmethod
    def of(cls, geometry: MeshArrays | PointArrays, direction: Any) -> View:
        """Return the view of a geometry from ``direction`` (3,), z up where that can be told.

        Raises:
            GeometryError: The geometry has no extent.
            ValueError: The direction is zero or not finite.
        """
        towards = point(direction, "direction")
        largest = float(np.abs(towards).max())
        if largest == 0:
            raise ValueError("direction must not be zero")
        towards = towards / largest
        towards /= np.linalg.norm(towards)
        upright = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
        right = np.cross(upright, towards)
        right /= np.linalg.norm(right)
        used = positions(geometry)
        cube = UnitCube.around(used)
        radius = float(np.sqrt(np.square(cube.to_unit(used)).sum(axis=1).max()))
        return cls(cube=cube, radius=radius, axes=np.stack((right, np.cross(towards, right), towards)))

    def points(self, points: Float64Array) -> Float64Array:
        """Return points (n, 3) in view space."""
        return np.asarray(self.cube.to_unit(points) @ self.axes.T / self.radius)

    def directions(self, vectors: Float64Array) -> Float64Array:
        """Return vectors (n, 3) in view space, unit length; NaN where they have none."""
        largest = np.abs(vectors).max(axis=1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = vectors / largest  # first, so that the square neither overflows nor vanishes
            return np.asarray(scaled @ self.axes.T / np.linalg.norm(scaled, axis=1, keepdims=True))


@dataclass(frozen=True)
class Raster:
    """The pixels that look at view space."""

    width: int
    """Pixels across."""
    height: int
    """Pixels down."""

    @property
    def scale(self) -> float:
        """Pixels in a unit of view space."""
        return min(self.width, self.height) / (2 * _MARGIN)

    def centers(self) -> Float64Array:
        """Return the pixels' centres (height · width, 2) in view space, rows from the top."""
        x = (np.arange(self.width) + 0.5 - self.width / 2) / self.scale
        y = (self.height / 2 - np.arange(self.height) - 0.5) / self.scale
        return np.stack([axis.ravel() for axis in np.meshgrid(x, y)], axis=1)

    def pixels(self, points: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return column and row (n,) of points of view space, as fractions of pixels."""
        return points[:, 0] * self.scale + self.width / 2, self.height / 2 - points[:, 1] * self.scale


def camera_eye(radius: float) -> dict[str, float]:
    """Return where plotly's camera sees a ball about the origin whole; both in sides of the cube that it shows."""
    return xyz(_AROUND * radius / math.sin(_FIELD / 2) * TOWARDS_VIEWER)


def xyz(vector: Float64Array) -> dict[str, float]:
    """Return a vector (3,) as plotly takes it."""
    return dict(zip("xyz", vector.tolist(), strict=True))


def positions(geometry: MeshArrays | PointArrays) -> Float64Array:
    """Return the points, or the vertices that triangles use, (n, 3)."""
    if isinstance(geometry, PointArrays):
        return geometry.points
    return geometry.used_vertices
