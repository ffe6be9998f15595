"""Pictures for anyone: of geometry on request, of results in a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._value import draw_values_with
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, transformed

__all__ = ["render"]

_SIDE = 160  # pixels of a picture in a notebook
_SMALL = 4000  # vertices or points of a side that such a picture is drawn from
_COLORS = ((0.79, 0.76, 0.70), (0.87, 0.52, 0.18))  # sRGB of what stays and of what was moved onto it


def render(
    geometry: Any,
    *,
    width: int = 640,
    height: int = 480,
    direction: Any = (1.0, -1.5, 0.8),
    colors: Any = None,
    color: Any = (0.79, 0.76, 0.70),
    background: Any = (1.0, 1.0, 1.0),
    around: Any = None,
) -> NDArray[np.uint8]:
    """Return a picture of geometry, drawn on the processor: no window, no graphics card, no Vulkan or EGL.

    The projection is parallel and shows everything. Both sides of a surface are lit alike, hollows are darker, and
    vertices have their own colours. The same input gives the same picture.

    Args:
        geometry: Mesh or point cloud, as ``from_any`` takes it.
        width: Pixels across, 1 … 4096.
        height: Pixels down, 1 … 4096.
        direction: (3,) from the geometry towards the viewer, of any length; z is up (y, when looking along z).
        colors: (v, 3) sRGB in [0, 1] for the vertices or points; the geometry's own if not given.
        color: (3,) sRGB in [0, 1] where there are none.
        background: (3,) sRGB in [0, 1], or None for a transparent one.
        around: Another geometry to fit instead, so that two pictures have the same place and scale.

    Returns:
        (height, width, 3) uint8, or (height, width, 4) without a background.

    Raises:
        TypeError: Not a geometry, or not numbers.
        ValueError: A size, colour or direction of the wrong shape or range.
        GeometryError: An empty geometry, or one without extent.

    Example:
        >>> picture = fsh.render("samples/gem.stl", width=320, height=240)
        >>> picture.shape, picture.dtype
        ((240, 320, 3), dtype('uint8'))
        >>> from PIL import Image
        >>> Image.fromarray(picture).save("gem.png")
    """
    # Imported here: Pillow and more, for those who draw.
    from fsh3d_o3d.report.thumbnail import render_thumbnail

    return render_thumbnail(
        geometry,
        width=width,
        height=height,
        direction=direction,
        colors=colors,
        color=color,
        background=background,
        around=around,
    )


def picture_of(value: Any) -> bytes | None:
    """Return a small PNG of what a value is about; None for what has no form, or cannot be drawn."""
    from fsh3d_o3d.report.thumbnail import encode_png, render_thumbnail

    stored = getattr(value, "thumbnail", None)  # of a hit, as it was indexed
    if isinstance(stored, bytes):
        return stored or None
    geometry = _form(value)
    if geometry is None:
        return None
    try:
        look: dict[str, Any] = {"width": _SIDE, "height": _SIDE, "background": None, "occlusion": False}
        return encode_png(render_thumbnail(geometry, **look))
    except GeometryError:
        return None


def _form(value: Any) -> MeshArrays | PointArrays | None:
    if isinstance(value, MeshArrays | PointArrays):
        return value
    try:
        if hasattr(value, "mesh_arrays"):
            small = (24,) if hasattr(value, "radii") else (_SMALL,)  # points a side of shells, vertices of others
            mesh: MeshArrays = value.mesh_arrays(*small)[0]
            return mesh
    except (GeometryError, MemoryError):  # a shape may have no surface
        return None
    for name in ("mesh", "geometry"):
        inner = getattr(value, name, None)
        if isinstance(inner, MeshArrays | PointArrays):
            return inner
    if hasattr(value, "source_points") and hasattr(value, "target_points"):  # of a registration
        moved = transformed(PointArrays(value.source_points[:_SMALL]), value.transformation)
        assert isinstance(moved, PointArrays)
        parts = (value.target_points[:_SMALL], moved.points)
        tints = [np.tile(tint, (len(part), 1)) for part, tint in zip(parts, _COLORS, strict=True)]
        return PointArrays(np.concatenate(parts), None, np.concatenate(tints))
    return None


draw_values_with(picture_of)
