"""Objects of trimesh as arrays, without importing it: who has one has imported it."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import RESERVED_NAMES, MeshArrays, PointArrays


def arrays_of_trimesh(geometry: Any) -> MeshArrays | PointArrays | None:
    """Return a ``Trimesh``, a ``PointCloud`` or a ``Scene`` of trimesh as arrays; None for anything else.

    A scene becomes one mesh, each part where its transforms put it. Colours of faces become those of their corners on
    average, textures are sampled at the vertices.

    Raises:
        GeometryError: Empty, not finite, or a scene without a mesh.
    """
    trimesh: Any = sys.modules.get("trimesh")
    if trimesh is None:
        return None
    if isinstance(geometry, trimesh.Scene):
        meshes = [part for part in geometry.dump() if isinstance(part, trimesh.Trimesh)]
        if not meshes:
            raise GeometryError("the trimesh scene holds no mesh")
        geometry = trimesh.util.concatenate(meshes)
    if isinstance(geometry, trimesh.PointCloud):
        colors = _fractions(np.asarray(geometry.colors), len(geometry.vertices))
        return PointArrays(np.asarray(geometry.vertices), colors=colors)
    if not isinstance(geometry, trimesh.Trimesh):
        return None
    count = len(geometry.vertices)
    given = {str(name): np.asarray(array) for name, array in geometry.vertex_attributes.items()}
    # trimesh computes normals when they are asked for; those that came with the file are kept in its cache.
    normals = np.asarray(geometry.vertex_normals) if "vertex_normals" in geometry._cache else None
    uvs = getattr(geometry.visual, "uv", None)
    triangles = np.asarray(geometry.faces)
    return MeshArrays(
        np.asarray(geometry.vertices),
        triangles,
        normals,
        _colors(geometry.visual, count),
        None if uvs is None or len(uvs) != count or not len(triangles) else np.asarray(uvs)[:, :2][triangles],
        {
            name: array if array.ndim < 3 else array.reshape(count, -1)
            for name, array in given.items()
            if name not in RESERVED_NAMES and array.dtype.kind in "fiub" and len(array) == count and array.size
        },
    )


def _colors(visual: Any, count: int) -> Float64Array | None:
    if not visual.defined:
        return None
    if visual.kind == "texture":
        material = visual.material
        if getattr(material, "image", None) is None and getattr(material, "baseColorTexture", None) is None:
            return None
        visual = visual.to_color()
    return _fractions(np.asarray(visual.vertex_colors), count)


def _fractions(colors: Any, count: int) -> Float64Array | None:
    """RGBA (n, 4) in eight bits as (n, 3) in [0, 1]."""
    if colors.ndim != 2 or colors.shape[0] != count or colors.shape[1] < 3:
        return None
    return np.asarray(colors[:, :3] / 255.0)
