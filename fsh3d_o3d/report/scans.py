"""A picture of scans in one frame, each in a colour of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.geometry import MeshArrays, PointArrays, area_samples, evenly_thinned
from fsh3d_o3d.report.thumbnail import render_thumbnail, side_by_side

__all__ = ["scans_picture"]

# Told apart by lightness as well as by hue; scans take turns.
_COLORS = np.array(
    [
        [0.27, 0.45, 0.69],
        [0.90, 0.60, 0.20],
        [0.35, 0.65, 0.40],
        [0.75, 0.30, 0.30],
        [0.60, 0.50, 0.75],
        [0.55, 0.40, 0.30],
        [0.90, 0.65, 0.80],
        [0.60, 0.60, 0.20],
    ]
)
_POINTS = 25_000  # of each scan: enough to cover it, few enough that those behind show through
_VIEWS = {"from one side": (1.0, -1.5, 0.8), "from the other": (-1.0, 1.5, 0.8), "from below": (0.3, -0.6, -1.5)}


def scans_picture(scans: Sequence[MeshArrays | PointArrays], *, size: int = 420) -> NDArray[np.uint8]:
    """Return scans that lie in one frame, seen from three sides: (h, w, 3) uint8 with captions.

    Where scans overlap their colours mix; a colour that stands off as a second skin is a scan that lies wrong.

    Args:
        scans: In one frame.
        size: Side of each view in pixels.

    Raises:
        GeometryError: Empty, or without extent.
    """
    parts = [_few(scan) for scan in scans]
    colors = [np.tile(_COLORS[number % len(_COLORS)], (len(part), 1)) for number, part in enumerate(parts)]
    cloud = PointArrays(np.concatenate(parts), None, np.concatenate(colors))
    images = [render_thumbnail(cloud, width=size, height=size, direction=view) for view in _VIEWS.values()]
    return side_by_side(images, list(_VIEWS))


def _few(scan: MeshArrays | PointArrays) -> NDArray[np.float64]:
    if isinstance(scan, MeshArrays):
        return area_samples(scan, _POINTS)[0]
    return evenly_thinned(PointArrays(scan.points), _POINTS).points
