"""Scans as they come: Open3D geometry with points that were not seen, and where cameras stood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import GeometryKind, MeshArrays, PointArrays, area_samples, evenly_thinned
from fsh3d_o3d.registration.finite import finite_arrays

_FRAME_POINTS = 4096  # spread by area, of which centre and size are taken; a choice


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan without points that were not seen."""

    geometry: MeshArrays | PointArrays
    """As given, in its own units."""
    kind: GeometryKind
    """Kind of Open3D geometry that it was."""
    dropped: int
    """Points that were NaN or infinite."""
    center: Float64Array
    """(3,) of its area."""
    rms_radius: float
    """Root mean square distance of its area from there."""

    def in_units(self, unit: float) -> MeshArrays | PointArrays:
        """The scan about its centre, with ``unit`` for length one."""
        if isinstance(self.geometry, MeshArrays):
            return MeshArrays((self.geometry.gathered_vertices - self.center) / unit, self.geometry.triangles)
        return PointArrays((self.geometry.points - self.center) / unit, self.geometry.normals, self.geometry.colors)


@dataclass(frozen=True, eq=False)
class Frames:
    """From the scans' frames in common units, where poses are found, back to those in which they were given."""

    scans: list[Scan]
    """All of them."""
    unit: float
    """Length one, in the units of the scans."""

    def given(self, source: int, target: int, pose: Float64Array) -> Float64Array:
        """A pose (4, 4) from one scan's frame to another's, as the scans were given."""
        result = pose.copy()
        first, second = self.scans[source].center, self.scans[target].center
        result[:3, 3] = second + self.unit * pose[:3, 3] - pose[:3, :3] @ first
        return result


def scan_of(cloud: Any, name: str) -> Scan:
    """Return a scan of Open3D geometry or arrays.

    Raises:
        TypeError: Not a triangle mesh or point cloud; the message begins with ``name``.
        GeometryError: No finite point, or no extent; the message begins with ``name``.
    """
    geometry, kind, dropped = finite_arrays(cloud, name)
    if isinstance(geometry, MeshArrays):
        points = area_samples(geometry, _FRAME_POINTS)[0] if _has_area(geometry) else geometry.used_vertices
    else:
        points = evenly_thinned(PointArrays(geometry.points), _FRAME_POINTS).points
    center = points.mean(axis=0)
    rms = float(np.sqrt(np.mean(np.square(points - center).sum(axis=1))))
    if not rms > 0 or not _has_area(geometry):
        raise GeometryError(f"{name}: it has no extent; leave it out")
    return Scan(geometry, kind, dropped, center, rms)


def viewpoints_of(viewpoints: Any, count: int) -> list[Float64Array | None]:
    """Return a viewpoint (3,) for each scan, or None for each.

    Raises:
        ValueError: Neither (3,) nor (n, 3), or not finite.
    """
    if viewpoints is None:
        return [None] * count
    array = check.real_array(viewpoints, "viewpoints").astype(np.float64)
    if array.shape == (3,):
        array = np.tile(array, (count, 1))
    if array.shape != (count, 3):
        raise ValueError(f"viewpoints must have shape (3,) or (n, 3) = ({count}, 3), got {array.shape}")
    return list(array)


def _has_area(geometry: MeshArrays | PointArrays) -> bool:
    if isinstance(geometry, PointArrays):
        return True
    try:
        area_samples(geometry, 1)
    except GeometryError:
        return False
    return True
