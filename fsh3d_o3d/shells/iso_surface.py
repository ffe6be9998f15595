"""Closed iso-surfaces of fields on a cubic grid."""

from __future__ import annotations

import numpy as np
import scipy

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import EdgeTable, MeshArrays, component_areas

# Of the field's usual change across a cell. Values closer to zero are moved this far from it, on their side, so that no
# vertex falls onto a corner of the grid, where triangles would collapse.
_ZERO_MARGIN = 1e-2
_ATTEMPTS = 4  # each with four times the margin: after the last the surface would move by more than half a cell


def zero_surface(values: Float64Array) -> tuple[MeshArrays, Float64Array]:
    """Return the surface where a field (n, n, n), negative inside, is zero, and its outward normals (v, 3).

    Vertices are in units of the grid, (0, 0, 0) its first corner. What reaches the end of the grid is closed there. The
    mesh is manifold and wound outward.

    Raises:
        GeometryError: The field is nowhere negative, or not finite.
    """
    marching_cubes = import_installed("skimage.measure").marching_cubes  # here: half a second to import

    if not np.isfinite(values).all():
        raise GeometryError("the field is not finite")
    if values.min() >= 0:
        raise GeometryError(
            "the field has no inside at this resolution: keep more degrees and shells, use a finer grid, or another "
            "level"
        )
    scale = float(np.median(np.abs(np.diff(values, axis=0)))) or float(np.abs(values).max())
    padded = np.pad(values, 1, constant_values=max(float(values.max()), scale))
    clearance = _ZERO_MARGIN * scale
    for _ in range(_ATTEMPTS):
        clear = np.where(np.abs(padded) < clearance, np.where(padded < 0, -clearance, clearance), padded)
        vertices, triangles = marching_cubes(clear, 0.0, gradient_direction="descent")[:2]
        mesh = MeshArrays(vertices.astype(np.float64) - 1, triangles)
        if _is_manifold(mesh):
            break
        # Two sheets that touch in one cell: moved apart by letting the values near zero belong to the outside.
        clearance *= 4
        padded = np.where(np.abs(padded) < clearance, clearance, padded)
    else:
        raise GeometryError("the iso-surface touches itself at this resolution: use another one")
    return mesh, _normals(values, mesh.vertices)


def without_specks(mesh: MeshArrays, normals: Float64Array, smallest: float) -> tuple[MeshArrays, Float64Array]:
    """Return the mesh without the components whose share of its area is below ``smallest``; the largest stays."""
    part, area = component_areas(mesh)
    kept = (area >= min(smallest * area.sum(), area.max()))[part]
    result, source = MeshArrays(mesh.vertices, mesh.triangles[kept]).compact()
    return result, normals[source]


def _is_manifold(mesh: MeshArrays) -> bool:
    table = EdgeTable(mesh.triangles)
    return bool((table.faces == 2).all()) and table.balanced and table.fans() == len(np.unique(mesh.triangles))


def _normals(values: Float64Array, places: Float64Array) -> Float64Array:
    """Directions of steepest ascent (v, 3), interpolated from central differences."""
    parts: tuple[Float64Array, ...] = tuple(np.gradient(values))
    slope = np.stack([scipy.ndimage.map_coordinates(part, places.T, order=1, mode="nearest") for part in parts], axis=1)
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300))
