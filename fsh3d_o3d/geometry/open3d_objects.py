"""Open3D geometry in and out: legacy and tensor objects become arrays, and arrays become objects again."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import RESERVED_NAMES, MeshArrays, PointArrays

GeometryKind = Literal["legacy", "tensor"]
GEOMETRY_KINDS: tuple[GeometryKind, ...] = ("legacy", "tensor")
"""Both kinds of Open3D geometry."""


def arrays_of_open3d(geometry: Any) -> tuple[MeshArrays | PointArrays, GeometryKind] | None:
    """Return an Open3D mesh or point cloud with all that belongs to its vertices, and its kind; None for others.

    Raises:
        GeometryError: Empty, not finite, or with triangles out of range.
    """
    o3d = open3d()
    if isinstance(geometry, o3d.geometry.TriangleMesh):
        corners = np.asarray(geometry.triangle_uvs) if geometry.has_triangle_uvs() else None
        return (
            MeshArrays(
                np.asarray(geometry.vertices),
                np.asarray(geometry.triangles),
                np.asarray(geometry.vertex_normals) if geometry.has_vertex_normals() else None,
                np.asarray(geometry.vertex_colors) if geometry.has_vertex_colors() else None,
                None if corners is None else corners.reshape(-1, 3, 2),
            ),
            "legacy",
        )
    if isinstance(geometry, o3d.geometry.PointCloud):
        return (
            PointArrays(
                np.asarray(geometry.points),
                np.asarray(geometry.normals) if geometry.has_normals() else None,
                np.asarray(geometry.colors) if geometry.has_colors() else None,
            ),
            "legacy",
        )
    if isinstance(geometry, o3d.t.geometry.TriangleMesh):
        positions, triangles = _tensor(geometry.vertex, "positions"), _tensor(geometry.triangle, "indices")
        uvs = None
        if "texture_uvs" in geometry.triangle:
            uvs = _tensor(geometry.triangle, "texture_uvs").reshape(-1, 3, 2)
        elif "texture_uvs" in geometry.vertex and triangles.size and len(positions) > triangles.max():
            uvs = _tensor(geometry.vertex, "texture_uvs")[triangles]
        beside = _beside(geometry.vertex)
        return MeshArrays(positions, triangles, texture_uvs=uvs, **beside), "tensor"
    if isinstance(geometry, o3d.t.geometry.PointCloud):
        return PointArrays(_tensor(geometry.point, "positions"), **_beside(geometry.point)), "tensor"
    return None


def chosen_kind(kind: GeometryKind | None, own: GeometryKind) -> GeometryKind:
    """Return ``kind``, or ``own`` where it is None.

    Raises:
        ValueError: It is neither ``"legacy"`` nor ``"tensor"``.
    """
    if kind is None:
        return own
    check.choice(kind, "kind", GEOMETRY_KINDS)
    return kind


def open3d_mesh(mesh: MeshArrays, kind: GeometryKind = "legacy", *, normals: Float64Array | None = None) -> Any:
    """Return a mesh as a legacy or tensor ``TriangleMesh`` with all that it has a place for.

    A legacy mesh has none for ``attributes``. ``normals`` (v, 3) take the place of the mesh's own.
    """
    o3d = open3d()
    normals = mesh.normals if normals is None else normals
    if kind == "legacy":
        legacy = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(mesh.vertices),
            o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
        )
        if normals is not None:
            legacy.vertex_normals = o3d.utility.Vector3dVector(np.array(normals))
        if mesh.colors is not None:
            legacy.vertex_colors = o3d.utility.Vector3dVector(mesh.colors)
        if mesh.texture_uvs is not None:
            legacy.triangle_uvs = o3d.utility.Vector2dVector(mesh.texture_uvs.reshape(-1, 2))
        return legacy
    tensor = o3d.t.geometry.TriangleMesh()
    tensor.vertex.positions = o3d.core.Tensor(mesh.vertices)
    tensor.triangle.indices = o3d.core.Tensor(mesh.triangles)
    if mesh.texture_uvs is not None:
        tensor.triangle.texture_uvs = o3d.core.Tensor(mesh.texture_uvs)
    _give(tensor.vertex, normals, mesh)
    return tensor


def open3d_point_cloud(cloud: PointArrays, kind: GeometryKind = "legacy") -> Any:
    """Return a cloud as a legacy or tensor ``PointCloud`` with all that it has a place for."""
    o3d = open3d()
    if kind == "legacy":
        legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
        if cloud.normals is not None:
            legacy.normals = o3d.utility.Vector3dVector(cloud.normals)
        if cloud.colors is not None:
            legacy.colors = o3d.utility.Vector3dVector(cloud.colors)
        return legacy
    tensor = o3d.t.geometry.PointCloud()
    tensor.point.positions = o3d.core.Tensor(cloud.points)
    _give(tensor.point, cloud.normals, cloud)
    return tensor


def _give(place: Any, normals: Float64Array | None, geometry: MeshArrays | PointArrays) -> None:
    """Put what belongs to vertices or points into a ``TensorMap``."""
    values = {"normals": normals, "colors": geometry.colors, **geometry.attributes}
    for name, array in values.items():
        if array is not None:
            place[name] = open3d().core.Tensor(np.array(array))


def _beside(place: Any) -> dict[str, Any]:
    """What a ``TensorMap`` holds besides positions and texture coordinates, as the arguments of our values."""
    normals = _tensor(place, "normals") if "normals" in place else None
    colors = _unit_range(_tensor(place, "colors")) if "colors" in place else None
    attributes = {}
    for name in sorted(str(key) for key in place):
        array = _tensor(place, name)
        if name not in RESERVED_NAMES and array.size:
            attributes[name] = array if array.ndim < 3 else array.reshape(len(array), -1)
    return {"normals": normals, "colors": colors, "attributes": attributes}


def _unit_range(colors: Any) -> Any:
    """Colours in [0, 1]: integers are divided by the largest of their type."""
    return colors / np.iinfo(colors.dtype).max if colors.dtype.kind in "ui" else colors


def _tensor(attributes: Any, name: str) -> Any:
    if name not in attributes:
        raise GeometryError(f"the tensor geometry has no {name}: it is empty")
    return attributes[name].cpu().numpy()
