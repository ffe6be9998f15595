"""What is known of many scans once they are registered."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import (
    GeometryKind,
    MeshArrays,
    PointArrays,
    area_samples,
    chosen_kind,
    open3d_point_cloud,
    transformed,
    triangle_normals,
    voxel_averaged,
)

__all__ = ["DropReason", "ScanPair", "ScanRegistrationResult"]

_MESH_POINTS = 4096  # at least, that stand for a scan which is a mesh; its vertices if they are more

DropReason = Literal[
    "",
    "touches too little",
    "hides what was seen",
    "slides",
    "fits in several ways",
    "loops do not close",
    "contradicts others",
]
"""Why a pair of scans was dropped."""


@value
class ScanPair:
    """Two scans that were aligned, or that touch in the end, and what became of them.

    Example:
        >>> points = np.asarray(fsh.read_geometry("samples/stone_cloud.xyzn").points)
        >>> result = fsh.register_scans([points, points[::2]])
        >>> [(pair.source, pair.target, pair.used) for pair in result.pairs]
        [(1, 0, True)]
    """

    source: int
    """Index of the scan that was moved."""
    target: int
    """Index of the scan that stayed."""
    transformation: Float64Array
    """(4, 4) that maps the source onto the target, as found for this pair alone; read-only."""
    confidence: float
    """In [0, 1]: how far this pose is believed, by its registration, by how the scans touch, and by loops."""
    overlap: tuple[float, float]
    """Share of the source in contact with the target, and of the target with the source, in this pose."""
    inlier_rmse: float
    """Root mean square distance of what is in contact, along the normals, in the scans' units."""
    used: bool
    """Whether it took part in the optimisation of all poses."""
    reason: DropReason
    """Why it was dropped; empty where it was used."""


@value
class ScanRegistrationResult:
    """Where scans lie in one frame, which could not be placed, and what was found between them.

    Example:
        >>> points = np.asarray(fsh.read_geometry("samples/stone_cloud.xyzn").points)
        >>> result = fsh.register_scans([points, points[::2] + [5, 0, 0]])
        >>> result.placed
        array([ True,  True])
        >>> bool(np.abs(result.poses[1][:3, 3] - [-5, 0, 0]).max() < 0.05)
        True
        >>> len(result.in_one_frame())
        2
    """

    poses: Float64Array
    """(n, 4, 4) rigid maps from each scan's frame to that of the first scan of its group; read-only."""
    groups: tuple[tuple[int, ...], ...]
    """Indices of scans that lie in one frame: the largest group first, each in order. A scan that goes with no other
    is a group of its own."""
    pairs: tuple[ScanPair, ...]
    """All that was tried or used, in the order of target and source."""
    loop_error: tuple[float, float]
    """Root mean square distance by which the fits of pairs disagree with the poses of scans, before and after the
    optimisation, in the scans' units; of the largest group."""
    dropped_points: IntArray
    """(n,) points of each scan that were NaN or infinite and left out; read-only."""
    scans: tuple[MeshArrays | PointArrays, ...]
    """The scans as they came, without those points."""
    kind: GeometryKind
    """Kind of Open3D geometry of the first scan."""

    @property
    def placed(self) -> NDArray[np.bool_]:
        """Which scans (n,) lie in the frame of the largest group."""
        result = np.zeros(len(self.poses), dtype=np.bool_)
        result[list(self.groups[0])] = True
        return result

    @property
    def unplaced(self) -> tuple[int, ...]:
        """Indices of the scans that do not."""
        return tuple(int(index) for index in np.flatnonzero(~self.placed))

    def in_one_frame(self, group: int = 0) -> list[MeshArrays | PointArrays]:
        """Return the scans of one of the ``groups`` in the frame of its first, in order.

        Raises:
            ValueError: There is no such group.
        """
        check.integer(group, "group", minimum=0, maximum=len(self.groups) - 1)
        return [transformed(self.scans[index], self.poses[index]) for index in self.groups[group]]

    def merged(self, voxel: float | None = None, *, group: int = 0, kind: GeometryKind | None = None) -> Any:
        """Return all points of a group in one frame, as an Open3D point cloud.

        Normals and colours are kept where all scans of the group have them. Of a mesh the area is sampled, at as many
        points as it has vertices.

        Args:
            voxel: Edge of the cubes in which points are averaged, in the scans' units; None keeps all points.
            group: Which of the ``groups``.
            kind: ``"legacy"`` or ``"tensor"``; None: like the first scan.

        Raises:
            ValueError: There is no such group, or ``voxel`` is not positive.
        """
        kind = chosen_kind(kind, self.kind)
        clouds = [_points_of(scan) for scan in self.in_one_frame(group)]
        normals = [cloud.normals for cloud in clouds if cloud.normals is not None]
        colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
        cloud = PointArrays(
            np.concatenate([cloud.points for cloud in clouds]),
            np.concatenate(normals) if len(normals) == len(clouds) else None,
            np.concatenate(colors) if len(colors) == len(clouds) else None,
        )
        if voxel is not None:
            cloud = voxel_averaged(cloud, check.number(voxel, "voxel", minimum=0, exclusive=True))
        return open3d_point_cloud(cloud, kind)

    def __repr__(self) -> str:
        used = sum(pair.used for pair in self.pairs)
        return (
            f"ScanRegistrationResult({int(self.placed.sum())} of {len(self.poses)} scans placed, "
            f"{used} of {len(self.pairs)} pairs used, loop error {self.loop_error[0]:.3g} → {self.loop_error[1]:.3g})"
        )


def _points_of(scan: MeshArrays | PointArrays) -> PointArrays:
    if isinstance(scan, PointArrays):
        return scan
    points, owner = area_samples(scan, max(_MESH_POINTS, len(scan.vertices)))
    normals = triangle_normals(scan.vertices[scan.triangles[owner]])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return PointArrays(points, normals / np.where(length > 0, length, 1))
