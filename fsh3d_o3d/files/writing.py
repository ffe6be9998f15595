"""Geometry into files: whole, or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from fsh3d_o3d._atomic import atomic_write_bytes as atomic_write_bytes  # in the door, for all that is written
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files.serialise import Content
from fsh3d_o3d.files.writers import CLOUD_WRITERS, MESH_WRITERS
from fsh3d_o3d.geometry import PointArrays, from_any

WRITABLE_MESH_FORMATS: tuple[str, ...] = tuple(MESH_WRITERS)
"""Extensions for meshes."""
WRITABLE_CLOUD_FORMATS: tuple[str, ...] = tuple(CLOUD_WRITERS)
"""Extensions for point clouds."""


def write_geometry(path: str | os.PathLike[str], geometry: Any) -> None:
    """Write a mesh or a point cloud; the extension names the format.

    Meshes: ``.ply .obj .off .3mf .vtp`` (float64), ``.stl .glb`` (float32). Points: ``.ply .xyz .vtp`` (float64),
    ``.pcd`` (float32), ``.las .laz`` (steps of a billionth of the cloud's extent). Vertex normals and colours are kept
    where the format has a place for them (``.stl .3mf`` have none, ``.xyz`` none for colours, ``.las .laz`` none for
    normals), texture coordinates in ``.ply .obj .glb``, all other attributes in ``.ply``; materials and the pictures of
    textures are not written. The file appears under its name only when it is complete; on any error what was there
    before stays.

    Args:
        path: The file.
        geometry: What ``from_any`` takes.

    Raises:
        ValueError: Unknown extension, or one that cannot hold this kind of geometry, or coordinates beyond float32 in
            a format that stores float32.
        TypeError: Not a geometry.
        GeometryError: Empty, not finite, or with triangles out of range.
        OSError: The folder does not exist or cannot be written, the disk is full, the path is a folder or a device.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> fsh.write_geometry("gem.ply", mesh)
        >>> fsh.read_geometry("gem.ply")
        TriangleMesh with 49 points and 94 triangles.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in MESH_WRITERS and suffix not in CLOUD_WRITERS:
        raise ValueError(
            f"{str(target)!r}: cannot write {suffix or 'a file without extension'!r}; meshes go to "
            f"{' '.join(MESH_WRITERS)}, point clouds to {' '.join(CLOUD_WRITERS)}"
        )
    surface = _surface(geometry)
    writers, what = (CLOUD_WRITERS, "point cloud") if surface.triangles is None else (MESH_WRITERS, "mesh")
    if suffix not in writers:
        raise ValueError(f"{str(target)!r}: {suffix} cannot hold a {what}; choose {' '.join(writers)}")
    atomic_write_bytes(target, writers[suffix](surface))


def _surface(geometry: Any) -> Content:
    arrays = from_any(geometry)
    if isinstance(arrays, PointArrays):
        surface = Content(arrays.points, None, arrays.normals, arrays.colors, attributes=arrays.attributes)
    else:
        surface = Content(
            arrays.vertices, arrays.triangles, arrays.normals, arrays.colors, arrays.texture_uvs, arrays.attributes
        )
    for name in ("normals", "colors"):
        values = getattr(surface, name)
        if values is not None and (values.shape != surface.points.shape or not np.isfinite(values).all()):
            raise GeometryError(f"{name} must be finite and of shape {surface.points.shape}, got {values.shape}")
    return surface
