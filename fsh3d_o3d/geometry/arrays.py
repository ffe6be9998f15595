"""Open3D geometry in and out: legacy and tensor objects become arrays, and arrays become objects again.

Everything below the public functions works on ``MeshArrays`` and ``PointArrays``; Open3D objects exist at the edges.
Their arrays are copies of what was given, and nothing in the package writes into them. They are not locked against
their owner, because ``Vector3dVector`` takes no read-only array.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError

GeometryKind = Literal["legacy", "tensor"]
GEOMETRY_KINDS: tuple[GeometryKind, ...] = ("legacy", "tensor")
"""Both kinds of Open3D geometry."""


@value
class MeshArrays:
    """A triangle mesh as arrays of its own.

    Example:
        >>> directions, triangles = fsh.icosphere(2)
        >>> mesh = fsh.MeshArrays(directions, triangles[:10])
        >>> len(mesh.compact()[0].vertices) < len(mesh.vertices)
        True
    """

    vertices: Float64Array
    """(v, 3) positions, finite."""
    triangles: IntArray
    """(t, 3) vertex indices, within range, t >= 1."""

    def __post_init__(self) -> None:
        vertices = _points(self.vertices, "mesh vertices")
        triangles = np.array(check.unmasked(self.triangles, "mesh triangles"), dtype=np.int64, order="C")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise GeometryError(f"mesh triangles must have shape (t, 3), got {triangles.shape}")
        if len(triangles) == 0:
            raise GeometryError(f"the mesh has no triangles ({len(vertices)} vertices)")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise GeometryError(
                f"mesh triangles refer to vertices {triangles.min()} … {triangles.max()}, "
                f"but there are vertices 0 … {len(vertices) - 1}"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    @property
    def diagonal(self) -> float:
        """Length of the bounding-box diagonal of the vertices that triangles use."""
        return _diagonal(self.used_vertices)

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which vertices (v,) triangles use."""
        used = np.zeros(len(self.vertices), dtype=np.bool_)
        used[self.triangles] = True
        return used

    @property
    def used_vertices(self) -> Float64Array:
        """The vertices (u, 3) that triangles use."""
        used = self.used
        return self.vertices if used.all() else self.vertices[used]

    @property
    def gathered_vertices(self) -> Float64Array:
        """All vertices (v, 3), those that no triangle uses moved onto one that is used.

        An unused vertex may lie anywhere; so it can neither overflow nor widen a box.
        """
        used = self.used
        return self.vertices if used.all() else np.where(used[:, None], self.vertices, self.vertices[used.argmax()])

    def compact(self) -> tuple[MeshArrays, IntArray]:
        """Return the mesh without the vertices that no triangle uses, and which (u,) of its vertices those left are."""
        used = self.used
        return MeshArrays(self.vertices[used], (np.cumsum(used) - 1)[self.triangles]), np.flatnonzero(used)


@value
class PointArrays:
    """A point cloud as arrays of its own.

    Example:
        >>> cloud = fsh.PointArrays(fsh.icosphere(2)[0])
        >>> cloud.points.shape
        (42, 3)
    """

    points: Float64Array
    """(n, 3) positions, finite, n >= 1."""
    normals: Float64Array | None = None
    """(n, 3) normals as given (not normalised), or None."""
    colors: Float64Array | None = None
    """(n, 3) colours in [0, 1], or None."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _points(self.points, "points"))
        for name in ("normals", "colors"):
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(check.unmasked(value, name), dtype=np.float64, order="C")
            if array.shape != self.points.shape:
                raise GeometryError(f"{name} must have shape {self.points.shape} like the points, got {array.shape}")
            object.__setattr__(self, name, array)

    @property
    def diagonal(self) -> float:
        """Length of the bounding-box diagonal."""
        return _diagonal(self.points)


def geometry_arrays(geometry: Any) -> tuple[MeshArrays | PointArrays, GeometryKind]:
    """Return an Open3D mesh or point cloud, legacy or tensor, as arrays and the kind it was.

    ``MeshArrays`` and ``PointArrays`` pass through (kind ``"legacy"``). A mesh without triangles is an error, not a
    point cloud.

    Raises:
        TypeError: Not an Open3D triangle mesh or point cloud.
        GeometryError: Empty, not finite, or with triangles out of range.
    """
    if isinstance(geometry, (MeshArrays, PointArrays)):
        return geometry, "legacy"
    o3d = open3d()
    if isinstance(geometry, o3d.geometry.TriangleMesh):
        return MeshArrays(np.asarray(geometry.vertices), np.asarray(geometry.triangles)), "legacy"
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
        return MeshArrays(_tensor(geometry.vertex, "positions"), _tensor(geometry.triangle, "indices")), "tensor"
    if isinstance(geometry, o3d.t.geometry.PointCloud):
        normals = _tensor(geometry.point, "normals") if "normals" in geometry.point else None
        colors = _unit_range(_tensor(geometry.point, "colors")) if "colors" in geometry.point else None
        return PointArrays(_tensor(geometry.point, "positions"), normals, colors), "tensor"
    raise TypeError(
        "geometry must be an open3d.geometry or open3d.t.geometry TriangleMesh or PointCloud, got "
        f"{type(geometry).__module__}.{type(geometry).__name__}"
    )


def vertex_attributes(geometry: Any) -> tuple[Float64Array | None, Float64Array | None]:
    """Return the normals and the colours in [0, 1] of vertices or points, (v, 3) each; None for what there is not.

    Takes what ``geometry_arrays`` takes; lengths and shapes are as given.
    """
    if isinstance(geometry, MeshArrays):
        return None, None
    o3d = open3d()
    if isinstance(geometry, o3d.geometry.TriangleMesh):
        return (
            np.asarray(geometry.vertex_normals) if geometry.has_vertex_normals() else None,
            np.asarray(geometry.vertex_colors) if geometry.has_vertex_colors() else None,
        )
    if isinstance(geometry, o3d.t.geometry.TriangleMesh):
        found = {name: _tensor(geometry.vertex, name) for name in ("normals", "colors") if name in geometry.vertex}
        normals, colors = found.get("normals"), found.get("colors")
        return (
            None if normals is None else normals.astype(np.float64),
            None if colors is None else _unit_range(colors).astype(np.float64),
        )
    arrays, _ = geometry_arrays(geometry)
    return (arrays.normals, arrays.colors) if isinstance(arrays, PointArrays) else (None, None)


def chosen_kind(kind: GeometryKind | None, own: GeometryKind) -> GeometryKind:
    """Return ``kind``, or ``own`` where it is None.

    Raises:
        ValueError: It is neither ``"legacy"`` nor ``"tensor"``.
    """
    if kind is None:
        return own
    check.choice(kind, "kind", GEOMETRY_KINDS)
    return kind


def open3d_mesh(
    mesh: MeshArrays,
    kind: GeometryKind = "legacy",
    *,
    normals: Float64Array | None = None,
    colors: Float64Array | None = None,
) -> Any:
    """Return a mesh as a legacy or tensor ``TriangleMesh``; ``normals``, ``colors`` per vertex (v, 3)."""
    o3d = open3d()
    if kind == "legacy":
        legacy = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(mesh.vertices),
            o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
        )
        if normals is not None:
            legacy.vertex_normals = o3d.utility.Vector3dVector(np.array(normals))
        if colors is not None:
            legacy.vertex_colors = o3d.utility.Vector3dVector(np.array(colors))
        return legacy
    tensor = o3d.t.geometry.TriangleMesh()
    tensor.vertex.positions = o3d.core.Tensor(mesh.vertices)
    tensor.triangle.indices = o3d.core.Tensor(mesh.triangles)
    if normals is not None:
        tensor.vertex.normals = o3d.core.Tensor(np.array(normals))
    if colors is not None:
        tensor.vertex.colors = o3d.core.Tensor(np.array(colors))
    return tensor


def open3d_point_cloud(cloud: PointArrays, kind: GeometryKind = "legacy") -> Any:
    """Return a cloud as a legacy or tensor ``PointCloud`` with its normals and colours."""
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
    if cloud.normals is not None:
        tensor.point.normals = o3d.core.Tensor(cloud.normals)
    if cloud.colors is not None:
        tensor.point.colors = o3d.core.Tensor(cloud.colors)
    return tensor


def _points(value: Any, name: str) -> Float64Array:
    array = np.array(check.unmasked(value, name), dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != 3:
        raise GeometryError(f"{name} must have shape (n, 3), got {array.shape}")
    if len(array) == 0:
        raise GeometryError(f"there are no {name}: the geometry is empty")
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        raise GeometryError(
            f"{name} must be finite, but {len(array) - finite.sum()} of {len(array)} are NaN or infinite"
        )
    return array


def _diagonal(points: Float64Array) -> float:
    # Scaled first so that coordinates near the limits of float64 do not overflow in the square.
    extent = points.max(axis=0) / 2 - points.min(axis=0) / 2
    largest = float(extent.max())
    return 2 * largest * float(np.linalg.norm(extent / largest)) if largest > 0 else 0.0


def _unit_range(colors: Any) -> Any:
    """Colours in [0, 1]: integers are divided by the largest of their type."""
    return colors / np.iinfo(colors.dtype).max if colors.dtype.kind in "ui" else colors


def _tensor(attributes: Any, name: str) -> Any:
    if name not in attributes:
        raise GeometryError(f"the tensor geometry has no {name}: it is empty")
    return attributes[name].cpu().numpy()
