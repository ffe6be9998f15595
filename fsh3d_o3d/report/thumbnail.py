"""Pictures of meshes and point clouds without a graphics card: rays or splats, shaded in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, integer, real_array
from fsh3d_o3d.geometry import MeshArrays, from_any
from fsh3d_o3d.report.colors import ORIGINAL_COLOR, error_colors
from fsh3d_o3d.report.images import encode_png, side_by_side
from fsh3d_o3d.report.rasterise import mesh_fragments, point_fragments
from fsh3d_o3d.report.shading import picture
from fsh3d_o3d.report.view import DEFAULT_DIRECTION, Raster, View

__all__ = ["encode_png", "error_colors", "render_thumbnail", "side_by_side"]

_MOST_PIXELS = 4096  # a side: drawn at twice that; twice as many would take four times the memory
_MOST_POINTS_WITHOUT_NORMALS = 300_000  # more do not show in a thumbnail, and normals take time


def render_thumbnail(
    geometry: Any,
    *,
    width: int = 512,
    height: int = 512,
    direction: Any = DEFAULT_DIRECTION,
    colors: Any = None,
    normals: Any = None,
    color: Any = ORIGINAL_COLOR,
    background: Any = (1.0, 1.0, 1.0),
    around: Any = None,
    occlusion: bool = True,
) -> NDArray[np.uint8]:
    """Return a shaded picture of a mesh or a point cloud as (height, width, 3) uint8 sRGB.

    The projection is parallel and fits the bounding sphere. Meshes are seen along rays through four places in each
    pixel, points as discs in a depth buffer. Both sides of a surface are lit alike. Coordinates of any size and offset
    will do. The same input gives the same picture.

    Args:
        geometry: What ``from_any`` takes.
        width: Pixels across, 1 … 4096.
        height: Pixels down, 1 … 4096.
        direction: (3,) from the geometry towards the viewer, of any length; z is up (y, when looking along z).
        colors: (v, 3) sRGB in [0, 1] for vertices or points; default: the geometry's own.
        normals: (v, 3) of vertices or points, of any length; default: the geometry's own. Without any, triangles are
            flat and points take the normal of their neighbourhood.
        color: (3,) sRGB in [0, 1] where there are no ``colors``.
        background: (3,) sRGB in [0, 1], or None for a transparent one: the picture is then (height, width, 4), straight
            alpha.
        around: Another geometry to fit instead, so that two pictures have the same place and scale.
        occlusion: Whether hollows in a mesh are darker (takes twice as long).

    Raises:
        TypeError: Not a geometry, or not numbers.
        ValueError: A size, colour, normal or direction of the wrong shape or range.
        GeometryError: An empty geometry, or one without extent.
    """
    arrays = from_any(geometry)
    width = integer(width, "width", minimum=1, maximum=_MOST_PIXELS)
    height = integer(height, "height", minimum=1, maximum=_MOST_PIXELS)
    count = len(arrays.vertices if isinstance(arrays, MeshArrays) else arrays.points)
    vectors = arrays.normals if normals is None else _per_vertex(normals, "normals", count)
    tints = np.clip(arrays.colors, 0, 1) if arrays.colors is not None else _color(color, "color")[None]
    if colors is not None:
        tints = _per_vertex(colors, "colors", count)
        if tints.min() < 0 or tints.max() > 1:
            raise ValueError(f"colors must be within [0, 1], got {tints.min():g} … {tints.max():g}")
    paper = None if background is None else _color(background, "background")
    view = View.of(arrays if around is None else from_any(around), direction)
    raster = Raster(2 * width, 2 * height)
    turned = None if vectors is None else view.directions(vectors)
    if isinstance(arrays, MeshArrays):
        vertices = view.points(arrays.vertices)
        fragments = mesh_fragments(
            vertices, arrays.triangles, raster, normals=turned, colors=tints, occlusion=occlusion
        )
    else:
        points = view.points(arrays.points)
        if turned is None and count > _MOST_POINTS_WITHOUT_NORMALS:
            kept = np.sort(np.random.default_rng(0).choice(count, _MOST_POINTS_WITHOUT_NORMALS, replace=False))
            points, tints = points[kept], tints if len(tints) == 1 else tints[kept]
        fragments = point_fragments(points, raster, normals=turned, colors=tints)
    return picture(fragments, width, height, paper)


def _per_vertex(value: Any, name: str, count: int) -> Float64Array:
    array = real_array(value, name, finite=name == "colors")
    if array.shape != (count, 3):
        raise ValueError(f"{name} must have shape (v, 3) = ({count}, 3), got {array.shape}")
    return array.astype(np.float64)


def _color(value: Any, name: str) -> Float64Array:
    array = real_array(value, name).astype(np.float64)
    if array.shape != (3,) or array.min() < 0 or array.max() > 1:
        raise ValueError(f"{name} must be three numbers within [0, 1], got {np.asarray(value).tolist()}")
    return array
