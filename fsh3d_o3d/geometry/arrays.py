"""Meshes and clouds as arrays, with what belongs to their vertices and points.

Everything below the public functions works on ``MeshArrays`` and ``PointArrays``; Open3D objects exist at the edges.
Their arrays are copies of what was given, and nothing in the package writes into them. They are not locked against
their owner, because ``Vector3dVector`` takes no read-only array.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError

RESERVED_NAMES = ("positions", "normals", "colors", "indices", "texture_uvs")
"""What attributes must not be called, because a geometry has fields for it."""


@value
class MeshArrays:
    """A triangle mesh as arrays of its own, with what belongs to its vertices.

    Example:
        >>> directions, triangles = fsh.icosphere(2)
        >>> mesh = fsh.MeshArrays(directions, triangles[:10], attributes={"height": directions[:, 2]})
        >>> smaller, kept = mesh.compact()  # without the vertices that no triangle uses
        >>> len(smaller.vertices) == len(smaller.attributes["height"]) < len(mesh.vertices)
        True
    """

    vertices: Float64Array
    """(v, 3) positions, finite."""
    triangles: IntArray
    """(t, 3) vertex indices, within range, t >= 1."""
    normals: Float64Array | None = None
    """(v, 3) normals at the vertices as given (not normalised), or None."""
    colors: Float64Array | None = None
    """(v, 3) colours in [0, 1], or None."""
    texture_uvs: Float64Array | None = None
    """(t, 3, 2) texture coordinates of the corners of the triangles, or None."""
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """Further values (v,) or (v, k) at the vertices, by name."""

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
        for name in ("normals", "colors"):
            object.__setattr__(self, name, _beside(getattr(self, name), name, vertices.shape, "the vertices"))
        corners = (len(triangles), 3, 2)
        object.__setattr__(self, "texture_uvs", _beside(self.texture_uvs, "texture_uvs", corners, "the triangles"))
        object.__setattr__(self, "attributes", _attributes(self.attributes, len(vertices)))

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
        kept = np.flatnonzero(used)
        return rearranged(self, kept, (np.cumsum(used) - 1)[self.triangles]), kept


@value
class PointArrays:
    """A point cloud as arrays of its own, with what belongs to its points.

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
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """Further values (n,) or (n, k) at the points, by name."""

    def __post_init__(self) -> None:
        points = _points(self.points, "points")
        object.__setattr__(self, "points", points)
        for name in ("normals", "colors"):
            object.__setattr__(self, name, _beside(getattr(self, name), name, points.shape, "the points"))
        object.__setattr__(self, "attributes", _attributes(self.attributes, len(points)))

    @property
    def diagonal(self) -> float:
        """Length of the bounding-box diagonal."""
        return _diagonal(self.points)


def bare(geometry: MeshArrays | PointArrays) -> MeshArrays | PointArrays:
    """Return positions and triangles of a mesh alone, positions and normals of a cloud."""
    if isinstance(geometry, MeshArrays):
        return MeshArrays(geometry.vertices, geometry.triangles)
    return PointArrays(geometry.points, geometry.normals)


def rearranged(
    mesh: MeshArrays,
    kept: IntArray,
    triangles: IntArray,
    sources: IntArray | NDArray[np.bool_] | None = None,
    *,
    vertices: Float64Array | None = None,
) -> MeshArrays:
    """Return the mesh of some of its vertices, with all that belongs to them.

    Args:
        mesh: The mesh.
        kept: (u,) which vertices.
        triangles: (s, 3) indices of those.
        sources: Which (s,) of the mesh's triangles they are, corner by corner; None: all of them in their order.
        vertices: (u, 3) where those vertices are now, if not where they were.
    """
    uvs = mesh.texture_uvs
    return MeshArrays(
        mesh.vertices[kept] if vertices is None else vertices,
        triangles,
        None if mesh.normals is None else mesh.normals[kept],
        None if mesh.colors is None else mesh.colors[kept],
        uvs if uvs is None or sources is None else uvs[sources],
        {name: values[kept] for name, values in mesh.attributes.items()},
    )


def turned_over(mesh: MeshArrays, which: NDArray[np.bool_]) -> MeshArrays:
    """Return the mesh with some of its triangles (t,) wound the other way round."""
    order = (0, 2, 1)
    uvs = mesh.texture_uvs
    return replace(
        mesh,
        triangles=np.where(which[:, None], mesh.triangles[:, order], mesh.triangles),
        texture_uvs=None if uvs is None else np.where(which[:, None, None], uvs[:, order], uvs),
    )


def selected(cloud: PointArrays, kept: IntArray | NDArray[np.bool_]) -> PointArrays:
    """Return some of the points, with all that belongs to them."""
    return PointArrays(
        cloud.points[kept],
        None if cloud.normals is None else cloud.normals[kept],
        None if cloud.colors is None else cloud.colors[kept],
        {name: values[kept] for name, values in cloud.attributes.items()},
    )


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


def _beside(value: Any, name: str, shape: tuple[int, ...], what: str) -> Float64Array | None:
    if value is None:
        return None
    array = np.array(check.unmasked(value, name), dtype=np.float64, order="C")
    if array.shape != shape:
        raise GeometryError(f"{name} must have shape {shape} like {what}, got {array.shape}")
    return array


def _attributes(value: Any, count: int) -> Mapping[str, Float64Array]:
    if not isinstance(value, Mapping):
        raise TypeError(f"attributes must be a mapping of names to arrays, got {type(value).__name__}")
    result = {}
    for name, given in value.items():
        if not isinstance(name, str) or not name.isprintable() or not name.strip() or name in RESERVED_NAMES:
            raise GeometryError(
                f"an attribute must have a printable name other than {', '.join(RESERVED_NAMES)}, got {name!r}"
            )
        array = np.array(check.unmasked(given, f"attribute {name!r}"), dtype=np.float64, order="C")
        if array.ndim not in (1, 2) or len(array) != count or array.size == 0:
            raise GeometryError(
                f"attribute {name!r} must have shape ({count},) or ({count}, k), a row for each vertex or point, "
                f"got {array.shape}"
            )
        result[name] = array
    return MappingProxyType(result)


def _diagonal(points: Float64Array) -> float:
    # Scaled first so that coordinates near the limits of float64 do not overflow in the square.
    extent = points.max(axis=0) / 2 - points.min(axis=0) / 2
    largest = float(extent.max())
    return 2 * largest * float(np.linalg.norm(extent / largest)) if largest > 0 else 0.0
