"""Rays and closest points in the unit cube.

Open3D's ``RaycastingScene`` works in float32. Everything that uses it first moves and scales its geometry in float64
into the unit cube, asks the scene only *which* triangle is met, and computes the answer again in float64 from that
triangle. Closest triangles are found in float64, by libigl.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.triangles import triangle_normals

_GRAZING = 1e-4  # length in the unit cube, a choice: some thousand float32 steps
_TILT = 1e-6  # radians: some ten float32 steps, enough to leave an edge that a ray slipped through


@value
class UnitCube:
    """A shift and a scale that bring points into the unit cube without rounding more than the shift must."""

    origin: Float64Array
    """(3,) point that becomes the origin."""
    scale: float
    """Length that becomes one; a power of two, so that scaling is exact."""

    @classmethod
    def around(cls, *clouds: Float64Array, center: Float64Array | None = None) -> UnitCube:
        """Return what brings all (n, 3) clouds into the unit cube about ``center`` (default: that of their box)."""
        # Column by column, which is several times faster than reducing (n, 3) along its long axis.
        low = np.array([min(float(cloud[:, k].min()) for cloud in clouds) for k in range(3)])
        high = np.array([max(float(cloud[:, k].max()) for cloud in clouds) for k in range(3)])
        if np.all(low == high):
            raise GeometryError(f"the geometry has no extent: all its points are at {low.tolist()}")
        # Halved before they are added or subtracted, so that coordinates near the end of float64 do not overflow.
        middle = low / 2 + high / 2 if center is None else center
        extent = 2 * float(np.maximum(np.abs(high / 2 - middle / 2), np.abs(low / 2 - middle / 2)).max())
        exponent = math.frexp(extent)[1] if math.isfinite(extent) else 1024
        return cls(origin=middle, scale=math.ldexp(1.0, min(exponent, 1023)))

    def to_unit(self, points: Float64Array) -> Float64Array:
        """Return points (…, 3) of the geometry in the unit cube."""
        return np.asarray(points / self.scale - self.origin / self.scale)

    def from_unit(self, points: Float64Array) -> Float64Array:
        """Return points (…, 3) of the unit cube in the coordinates of the geometry."""
        return np.asarray(points * self.scale + self.origin)


def ray_casting_scene(vertices: Float64Array, triangles: IntArray) -> Any:
    """Return Open3D's ``RaycastingScene`` of triangles (t, 3) of vertices (v, 3), in float32."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return scene


def ray_tensor(origins: Float64Array, directions: Float64Array) -> Any:
    """Return rays as such a scene takes them, from origins along directions, (n, 3) each or (3,) for all alike."""
    rays = np.empty((max(np.size(origins), np.size(directions)) // 3, 6), dtype=np.float32)
    rays[:, :3] = origins
    rays[:, 3:] = directions
    return open3d().core.Tensor(rays)


class UnitScene:
    """A ray-casting scene of triangles given in the unit cube; keeps the float64 corners beside it."""

    def __init__(self, vertices: Float64Array, triangles: IntArray) -> None:
        self.vertices = np.ascontiguousarray(vertices)
        self.triangles = np.ascontiguousarray(triangles)
        self._scene = ray_casting_scene(vertices, triangles)

    def cast(self, origins: Float64Array, directions: Float64Array) -> tuple[Float64Array, IntArray]:
        """Return how far along each ray (n,) the first hit lies (inf: none) and its triangle (−1: none)."""
        answer = self._scene.cast_rays(ray_tensor(origins, directions))
        distance = answer["t_hit"].numpy().astype(np.float64)
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        return distance, np.where(np.isfinite(distance), triangle, -1)

    def count(self, origins: Float64Array, directions: Float64Array) -> IntArray:
        """Return how many times each ray (n,) crosses the surface."""
        counts: IntArray = self._scene.count_intersections(ray_tensor(origins, directions)).numpy().astype(np.int64)
        return counts

    def crossings(self, origins: Float64Array, directions: Float64Array) -> tuple[IntArray, IntArray]:
        """Return every crossing of rays with the surface: the ray (k,) and the triangle (k,)."""
        answer = self._scene.list_intersections(ray_tensor(origins, directions))
        return answer["ray_ids"].numpy().astype(np.int64), answer["primitive_ids"].numpy().astype(np.int64)

    def closest(self, points: Float64Array) -> IntArray:
        """Return the triangle (n,) closest to each point (n, 3), in float64 and whatever the number of threads."""
        triangle: IntArray = self._tree.squared_distance(self.vertices, self.triangles, np.ascontiguousarray(points))[1]
        return triangle

    @functools.cached_property
    def corners(self) -> Float64Array:
        """The triangles (t, 3, 3)."""
        return self.vertices[self.triangles]

    @functools.cached_property
    def _tree(self) -> Any:
        tree = import_installed("igl").AABB()  # here: a tenth of a second, for those who measure distances
        tree.init(self.vertices, self.triangles)
        return tree

    def radii(self, directions: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return the innermost and outermost distance (n,) from the cube's origin along each direction (NaN: none).

        The innermost hit is met by a ray from the origin, the outermost by a ray from outside towards it.
        """
        zero = np.zeros(3)
        inner, inner_triangle = self.cast(zero, directions)
        # The start is a power of two beyond the cube's corners, so that both rays round to the same float32 line.
        start = 2.0
        outer, outer_triangle = self.cast(start * directions, -directions)
        behind = outer > start
        outer = np.where(behind, np.inf, start - outer)
        outer_triangle = np.where(behind, -1, outer_triangle)

        lost = np.flatnonzero((inner_triangle < 0) & (outer_triangle < 0))
        if lost.size:  # a ray can slip between two triangles; one beside it cannot slip through the same place
            inner[lost], inner_triangle[lost] = self._cast_tilted(directions[lost])
        # Where only one of the two rays slipped through, the other one knows better.
        inner_missed = inner_triangle < 0
        outer_missed = outer_triangle < 0
        inner, inner_triangle = (
            np.where(inner_missed, outer, inner),
            np.where(inner_missed, outer_triangle, inner_triangle),
        )
        outer, outer_triangle = (
            np.where(outer_missed, inner, outer),
            np.where(outer_missed, inner_triangle, outer_triangle),
        )
        near = self._refined(directions, inner, inner_triangle)
        far = self._refined(directions, outer, outer_triangle)
        return np.minimum(near, far), np.maximum(near, far)

    def _cast_tilted(self, directions: Float64Array) -> tuple[Float64Array, IntArray]:
        axis = np.eye(3)[np.abs(directions).argmin(axis=1)]
        first = np.cross(directions, axis)
        second = np.cross(directions, first)
        distance = np.full(len(directions), np.inf)
        triangle = np.full(len(directions), -1, dtype=np.int64)
        for angle in (0.3, 2.4, 4.5):
            beside = directions + _TILT * (math.cos(angle) * first + math.sin(angle) * second)
            t, index = self.cast(np.zeros(3), beside)
            better = t < distance
            distance, triangle = np.where(better, t, distance), np.where(better, index, triangle)
        return distance, triangle

    def _refined(self, directions: Float64Array, distance: Float64Array, triangle: IntArray) -> Float64Array:
        """Return each hit's distance from the float64 plane of its triangle; NaN where there is no hit."""
        corners = self.corners[np.maximum(triangle, 0)]
        normal = triangle_normals(corners)
        along = np.einsum("ij,ij->i", normal, directions)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = np.einsum("ij,ij->i", normal, corners[:, 0]) / along
            # float32 misplaces a hit by a few of its steps, and by 1/cosine as many along the ray. Where that comes to
            # more than this the ray grazes the plane, and the float32 hit is at least on the triangle.
            trusted = (np.abs(exact - distance) <= _GRAZING) & (exact > 0)
        return np.where(triangle < 0, np.nan, np.where(trusted, exact, distance))
