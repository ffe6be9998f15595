"""A picture of two shapes before and after they are aligned."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry import MeshArrays, PointArrays, area_samples, bare, from_any
from fsh3d_o3d.report.colors import ORIGINAL_COLOR
from fsh3d_o3d.report.thumbnail import render_thumbnail, side_by_side

__all__ = ["alignment_picture"]

_SOURCE_COLOR = (0.87, 0.52, 0.18)  # beside the blue-grey of originals
_OVERLAY_POINTS = 25_000  # of each shape: enough to cover it, few enough that both show


def alignment_picture(source: Any, target: Any, aligned: Any, *, size: int = 360) -> NDArray[np.uint8]:
    """Return target, source as it came, source aligned, and both over each other: (h, w, 3) uint8 with captions.

    The target and the aligned source have the same place, direction and scale. Where both colours mix in the last
    picture, the surfaces lie within each other's roughness.

    Args:
        source: Mesh or point cloud, as ``from_any`` takes it.
        target: The same.
        aligned: The source in its new place.
        size: Side of each picture in pixels.

    Raises:
        TypeError: Not geometries.
        GeometryError: Empty, or without extent.
    """
    first, second, moved = (_plain(geometry) for geometry in (source, target, aligned))
    images = [
        render_thumbnail(second, width=size, height=size, color=ORIGINAL_COLOR),
        render_thumbnail(first, width=size, height=size, color=_SOURCE_COLOR),
        render_thumbnail(moved, width=size, height=size, color=_SOURCE_COLOR, around=second),
        render_thumbnail(_overlay(second, moved), width=size, height=size, around=second),
    ]
    return side_by_side(images, ["target", "source as given", "source aligned", "both"])


def _plain(geometry: Any) -> MeshArrays | PointArrays:
    """A geometry without its own colours, which would hide whose it is."""
    return bare(from_any(geometry))


def _overlay(target: MeshArrays | PointArrays, source: MeshArrays | PointArrays) -> PointArrays:
    parts = [_samples(geometry) for geometry in (target, source)]
    colors = [
        np.tile(color, (len(part), 1)) for part, color in zip(parts, (ORIGINAL_COLOR, _SOURCE_COLOR), strict=True)
    ]
    return PointArrays(np.concatenate(parts), None, np.concatenate(colors))


def _samples(geometry: MeshArrays | PointArrays) -> Float64Array:
    if isinstance(geometry, MeshArrays):
        return area_samples(geometry, _OVERLAY_POINTS)[0]
    if len(geometry.points) <= _OVERLAY_POINTS:
        return geometry.points
    return geometry.points[np.random.default_rng(0).choice(len(geometry.points), _OVERLAY_POINTS, replace=False)]
