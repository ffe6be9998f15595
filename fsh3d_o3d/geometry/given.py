"""Whatever holds a surface or points, as arrays: the one place that all public functions take geometry through.

A path is read by ``files/``, which stands above this folder: it says how by ``read_paths_with`` when it is loaded, as
anything does that makes files into geometry. So this folder knows that paths can be read, and not by whom.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.open3d_objects import (
    GeometryKind,
    arrays_of_open3d,
    chosen_kind,
    open3d_mesh,
    open3d_point_cloud,
)
from fsh3d_o3d.geometry.trimesh_objects import arrays_of_trimesh

_ACCEPTED = (
    "an Open3D TriangleMesh or PointCloud (legacy or tensor), a path, arrays (V, F) or (n, 3), a Trimesh, "
    "or what holds a surface here, such as a shape"
)
_MOST_WORDS = 60  # characters of a value in an error, a choice: one line of a terminal with the rest

_readers: list[Callable[[str], MeshArrays | PointArrays]] = []


def read_paths_with(reader: Callable[[str], MeshArrays | PointArrays]) -> None:
    """Say what reads a path; called by what is loaded above this folder."""
    _readers[:] = [reader]


def geometry_arrays(geometry: Any) -> tuple[MeshArrays | PointArrays, GeometryKind]:
    """Return anything that holds a surface or points as arrays, and which kind of Open3D geometry it was.

    See ``from_any`` for what is taken. What is not Open3D's counts as ``"legacy"``, shapes as what they came from. A
    mesh without triangles is an error, not a point cloud.

    Raises:
        TypeError: None of these.
        GeometryError: Empty, not finite, or with triangles out of range.
        GeometryReadError, FileNotFoundError: A path that cannot be read.
    """
    if isinstance(geometry, (MeshArrays, PointArrays)):
        return geometry, "legacy"
    if isinstance(geometry, (str, bytes, os.PathLike)):
        if not _readers:
            raise TypeError("geometry cannot be a path before fsh3d_o3d.files is imported")
        return _readers[0](os.fsdecode(geometry)), "legacy"
    if isinstance(geometry, (tuple, list, np.ndarray)):
        return _of_arrays(geometry), "legacy"
    of_trimesh = arrays_of_trimesh(geometry)
    if of_trimesh is not None:
        return of_trimesh, "legacy"
    found = arrays_of_open3d(geometry)
    if found is not None:
        return found
    if hasattr(geometry, "to_triangle_mesh") and hasattr(geometry, "kind"):
        found = arrays_of_open3d(geometry.to_triangle_mesh(kind="tensor"))  # tensor: attributes have a place there
        if found is not None:
            return found[0], chosen_kind(geometry.kind, "legacy")
    if hasattr(geometry, "__array__"):  # of PyTorch, pandas and others
        return _of_arrays(np.asarray(geometry)), "legacy"
    raise TypeError(f"geometry must be {_ACCEPTED}, got {type(geometry).__module__}.{type(geometry).__name__}")


def from_any(geometry: Any) -> MeshArrays | PointArrays:
    """Return whatever holds a surface or points as arrays.

    Every function of this package that takes geometry takes it so:

    - Open3D ``TriangleMesh`` and ``PointCloud``, legacy and tensor, with normals, colours, texture coordinates and,
      tensor, all attributes of vertices or points;
    - a path, also ``s3://…``; see ``read_geometry``;
    - ``(V, F)``: arrays (v, 3) of positions and (t, 3) of vertex indices;
    - an array (n, 3): a point cloud;
    - ``Trimesh``, ``PointCloud`` and ``Scene`` of trimesh;
    - ``MeshArrays``, ``PointArrays``, shapes, and what else has ``to_triangle_mesh`` here.

    Raises:
        TypeError: None of these.
        GeometryError: Empty, not finite, or with triangles out of range.
        GeometryReadError, FileNotFoundError: A path that cannot be read.

    Example:
        >>> vertices, triangles = fsh.icosphere(2)
        >>> fsh.from_any((vertices, triangles)).triangles.shape
        (80, 3)
        >>> fsh.from_any("samples/gem.stl").vertices.shape
        (49, 3)
    """
    return geometry_arrays(geometry)[0]


def to_open3d(geometry: Any, *, kind: GeometryKind | None = None) -> Any:
    """Return whatever holds a surface or points as an Open3D ``TriangleMesh`` or ``PointCloud``.

    Normals, colours and texture coordinates of vertices come along, and other attributes where ``kind`` is
    ``"tensor"``; legacy geometry has no place for them.

    Args:
        geometry: What ``from_any`` takes.
        kind: ``"legacy"`` or ``"tensor"``; like the input if not given, legacy where that was none of Open3D's.

    Raises:
        TypeError, GeometryError, GeometryReadError, FileNotFoundError: As for ``from_any``.
        ValueError: Another kind.

    Example:
        >>> fsh.to_open3d(fsh.icosphere(2))
        TriangleMesh with 42 points and 80 triangles.
        >>> fsh.to_open3d("samples/stone_cloud.xyzn", kind="tensor").point.positions.shape
        SizeVector[2000, 3]
    """
    arrays, own = geometry_arrays(geometry)
    chosen = chosen_kind(kind, own)
    return open3d_mesh(arrays, chosen) if isinstance(arrays, MeshArrays) else open3d_point_cloud(arrays, chosen)


def _of_arrays(given: Any) -> MeshArrays | PointArrays:
    """A pair of arrays is a mesh, one array a cloud."""
    check.unmasked(given, "geometry")
    if isinstance(given, (tuple, list)) and len(given) == 2 and all(np.ndim(part) == 2 for part in given):
        vertices, triangles = (check.real_array(part, name) for part, name in zip(given, "VF", strict=True))
        if triangles.shape[1] != 3:
            more = "; cut its polygons into triangles first" if triangles.shape[1] > 3 else ""
            raise GeometryError(f"F of (V, F) must have shape (t, 3), vertex indices, got {triangles.shape}{more}")
        if not (triangles == np.rint(triangles)).all():
            raise GeometryError("F of (V, F) must be whole numbers, the indices of vertices")
        return MeshArrays(vertices.astype(np.float64), triangles.astype(np.int64))
    try:
        points = check.real_array(given, "geometry", finite=False)
    except (TypeError, ValueError):
        shown = repr(given)
        shown = shown if len(shown) <= _MOST_WORDS else f"{shown[:_MOST_WORDS]}…"
        raise TypeError(f"geometry must be {_ACCEPTED}, got {type(given).__name__} {shown}") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(
            f"an array of points must have shape (n, 3), got {points.shape}; a mesh is a pair (V, F), normals and "
            "colours go into fsh.PointArrays"
        )
    return PointArrays(points.astype(np.float64))
