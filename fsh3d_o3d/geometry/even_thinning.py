"""Fewer points of a cloud, spread evenly over its surface: one mean for each occupied cube of a lattice."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.geometry.arrays import PointArrays
from fsh3d_o3d.geometry.voxels import voxel_cells

_CLOSE_ENOUGH = 0.7  # of the number of points asked for: fewer are not worth another attempt
_AIM = 0.85  # of the number asked for: the middle of what is close enough
_ATTEMPTS = 12  # sizes that are tried; counts fall with about the square of the size, so that four do
_FINEST = 1e-6  # of the diagonal; points closer together are one


def voxel_averaged(cloud: PointArrays, size: float) -> PointArrays:
    """Return the mean of the points in each cube of edge ``size``, with the means of their normals and colours.

    Normals are scaled to length one (zero where they cancel). The lattice goes through the origin, and the points are
    in the order of its cubes.
    """
    return _averaged(cloud, *voxel_cells(cloud.points, size))


def evenly_thinned(cloud: PointArrays, most: int) -> PointArrays:
    """Return at most so many points, spread by area: a mean for each occupied cube, whose size follows from that.

    A cloud with no more points is returned as it is.
    """
    if len(cloud.points) <= most:
        return cloud
    extent = cloud.diagonal
    if extent == 0:
        return _averaged(cloud, np.arange(len(cloud.points)), np.zeros(1, dtype=np.int64))
    size, best = extent / np.sqrt(most), None
    for attempt in range(10 * _ATTEMPTS):
        cells = voxel_cells(cloud.points, max(size, _FINEST * extent))
        count = len(cells[1])
        if count <= most and (best is None or count > len(best[1])):
            best = cells
        if best is not None and (len(best[1]) >= _CLOSE_ENOUGH * most or attempt >= _ATTEMPTS):
            break
        # In the end everything lies in a few heaps: coarser, until there are few enough.
        size *= np.sqrt(count / (_AIM * most)) if attempt < _ATTEMPTS else 2.0
    return _averaged(cloud, *(best or voxel_cells(cloud.points, 2 * extent)))


def _averaged(cloud: PointArrays, order: IntArray, start: IntArray) -> PointArrays:
    counts = np.diff(start, append=len(order))[:, None]
    points = np.add.reduceat(cloud.points[order], start, axis=0) / counts
    normals = colors = None
    if cloud.normals is not None:
        normals = np.add.reduceat(cloud.normals[order], start, axis=0)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1)
    if cloud.colors is not None:
        colors = np.add.reduceat(cloud.colors[order], start, axis=0) / counts
    return PointArrays(points, normals, colors)
