"""Geometry as it comes from cameras: points that were not seen are left out, and counted."""

from __future__ import annotations

from typing import Any

import numpy as np

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import GeometryKind, MeshArrays, PointArrays, geometry_arrays


def finite_arrays(geometry: Any, name: str) -> tuple[MeshArrays | PointArrays, GeometryKind, int]:
    """Return geometry as arrays, its kind, and how many points of a cloud were left out: those NaN or infinite.

    Raises:
        TypeError: Not a geometry; the message begins with ``name``.
        GeometryError: Empty, or no finite point; the message begins with ``name``.
    """
    try:
        given, dropped = _finite(geometry)
        return *geometry_arrays(given), dropped
    except GeometryError as error:
        raise GeometryError(f"{name}: {error}") from None
    except TypeError as error:
        raise TypeError(f"{name}: {error}") from None


def _finite(geometry: Any) -> tuple[Any, int]:
    """A cloud without its points that are not finite, if some are, and how many those were."""
    o3d = open3d()
    points = None
    if isinstance(geometry, np.ndarray) and geometry.ndim == 2 and geometry.dtype.kind == "f":
        points = geometry
    elif isinstance(geometry, o3d.geometry.PointCloud):
        points = np.asarray(geometry.points)
    elif isinstance(geometry, o3d.t.geometry.PointCloud) and "positions" in geometry.point:
        points = geometry.point["positions"].cpu().numpy()
    if points is None:
        return geometry, 0
    finite = np.isfinite(points).all(axis=1)
    if finite.all():
        return geometry, 0
    if not finite.any():
        raise GeometryError(f"there are no points that are finite: all {len(points)} are NaN or infinite")
    dropped = int(np.count_nonzero(~finite))
    if isinstance(geometry, np.ndarray):
        return geometry[finite], dropped
    if isinstance(geometry, o3d.geometry.PointCloud):
        return geometry.select_by_index(np.flatnonzero(finite).tolist()), dropped
    return geometry.select_by_mask(o3d.core.Tensor(finite, o3d.core.bool, geometry.device)), dropped
