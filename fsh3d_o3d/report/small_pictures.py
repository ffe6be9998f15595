"""The small picture of a model that an index keeps."""

from __future__ import annotations

from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.report.thumbnail import encode_png, render_thumbnail

__all__ = ["library_thumbnail"]

_SIDE = 96  # pixels


def library_thumbnail(geometry: MeshArrays | PointArrays) -> bytes:
    """Return a PNG of a geometry, quick to draw and some 3 KB: for ``ShapeIndex.add_files(thumbnail=…)``."""
    return encode_png(render_thumbnail(geometry, width=_SIDE, height=_SIDE, background=None, occlusion=False))
