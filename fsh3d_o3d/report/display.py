"""Geometry small enough for a web page, and arrays as plotly reads them."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import MeshArrays, PointArrays, UnitCube
from fsh3d_o3d.report.colors import css_color
from fsh3d_o3d.report.rasterise import estimated_normals, unit
from fsh3d_o3d.report.view import positions

MOST_TRIANGLES = 80_000
"""Triangles of a mesh on a page: some 2 MB, and quick to turn without a graphics card."""
MOST_POINTS = 60_000
"""Points of a cloud on a page, a choice: they are drawn faster than triangles, but hide nothing."""
_QUADRIC_FROM = 250_000  # triangles that edge collapse manages in seconds; larger meshes are clustered first
_CLUSTERINGS = 12  # a bound: the cells grow by a tenth or more each time


@dataclass(frozen=True, eq=False)
class Displayed:
    """A mesh or a cloud as shown: in the unit cube, perhaps with fewer elements."""

    points: Float64Array
    """(n, 3) in the unit cube."""
    triangles: IntArray | None
    """(t, 3), or None for a cloud."""
    source: IntArray
    """(n,) the vertex or point of the original geometry that each stands for (the nearest, where they moved)."""
    total: int
    """Triangles of the original geometry, or its points if it is a cloud."""

    @property
    def shown(self) -> int:
        """Triangles shown, or points of a cloud."""
        return len(self.points if self.triangles is None else self.triangles)

    def note(self) -> str:
        """Return how much of the geometry is shown, in words."""
        what = "points" if self.triangles is None else "triangles"
        if self.shown == self.total:
            return f"{self.total:,} {what}"
        return f"shown with {self.shown:,} of {self.total:,} {what}"


def displayed(geometry: MeshArrays | PointArrays, cube: UnitCube, most: int | None = None) -> Displayed:
    """Return a geometry for a page, with at most ``most`` triangles or points (by default the constants above)."""
    if isinstance(geometry, PointArrays):
        return _thinned(cube.to_unit(geometry.points), MOST_POINTS if most is None else most)
    limit = MOST_TRIANGLES if most is None else most
    total = len(geometry.triangles)
    used = np.unique(geometry.triangles)
    points = cube.to_unit(geometry.vertices[used])
    triangles = np.searchsorted(used, geometry.triangles)
    if total <= limit:
        return Displayed(points, triangles, used, total)
    fewer, triangles = _decimated(points, triangles, limit)
    if len(triangles) == 0 or len(triangles) > limit:  # as with many loose triangles: every so many of them
        keep = np.linspace(0, total - 1, limit).astype(np.int64)
        kept, triangles = np.unique(geometry.triangles[keep], return_inverse=True)
        return Displayed(cube.to_unit(geometry.vertices[kept]), triangles.reshape(-1, 3), kept, total)
    nearest = KDTree(points).query(fewer, workers=-1)[1]
    return Displayed(fewer, triangles, used[nearest], total)


def shaded_points(shape: Displayed, cloud: PointArrays, color: Any, light: Float64Array) -> Float64Array:
    """Return colours (n, 3) of the points shown, darker where they look away from ``light`` (3,).

    plotly does not shade markers, and a cloud without shading is a silhouette. Normals are the cloud's, or those of
    the neighbourhood, turned away from the middle.
    """
    base = np.asarray(color)[None] if cloud.colors is None else cloud.colors[shape.source]
    if cloud.normals is None:
        normal = estimated_normals(shape.points)
        outward = np.einsum("nk,nk->n", normal, shape.points - np.median(shape.points, axis=0))
        normal = np.where(outward[:, None] < 0, -normal, normal)
    else:
        normal = unit(cloud.normals[shape.source])
    cosine = np.nan_to_num(normal @ unit(light[None])[0])
    return cast(Float64Array, np.clip(base, 0, 1) * (0.62 + 0.38 * cosine)[:, None])


def geometry_json(shape: Displayed, colors: Float64Array | None) -> dict[str, Any]:
    """Return the part of a plotly trace that holds the geometry; ``colors`` (n, 3) in [0, 1], or None."""
    data: dict[str, Any] = {name: packed(shape.points[:, k], "f4") for k, name in enumerate("xyz")}
    if shape.triangles is not None:
        kind = "u2" if len(shape.points) <= 2**16 else "u4"
        data |= {name: packed(shape.triangles[:, k], kind) for k, name in enumerate("ijk")}
    if colors is not None:
        rounded = np.round(np.clip(colors, 0, 1) * 31) / 31  # few different strings, which compress and parse well
        palette, index = np.unique(rounded, axis=0, return_inverse=True)
        data["palette"] = [css_color(color) for color in palette]
        data["color"] = packed(index.ravel(), "u2")
    return data


def packed(values: Any, kind: str) -> dict[str, str]:
    """Return an array (n,) as plotly.js reads typed arrays: ``f4``, ``u2`` or ``u4``, little-endian, in base 64."""
    array = np.ascontiguousarray(values, dtype=f"<{kind}")
    return {"dtype": kind, "bdata": base64.b64encode(array.tobytes()).decode("ascii")}


def _thinned(points: Float64Array, most: int) -> Displayed:
    total = len(points)
    kept = np.arange(total)
    if total > most:  # at random rather than every so many: scans come in rows
        kept = np.sort(np.random.default_rng(0).choice(total, most, replace=False))
    return Displayed(points[kept], None, kept, total)


def _decimated(points: Float64Array, triangles: IntArray, most: int) -> tuple[Float64Array, IntArray]:
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    if len(triangles) > _QUADRIC_FROM:
        mesh = _clustered(mesh, 2 * most)
    simple = mesh
    if len(mesh.triangles) > most:
        # Soup has no edges to collapse; vertices at the same place are one here.
        mesh.remove_duplicated_vertices()
        simple = mesh.simplify_quadric_decimation(most)
    if not 0 < len(simple.triangles) <= most:
        simple = _clustered(mesh, most)
    simple.remove_unreferenced_vertices()
    return _arrays(simple.vertices, np.float64), _arrays(simple.triangles, np.int64)


def _clustered(mesh: Any, most: int) -> Any:
    """Return a mesh with its vertices merged in cells, which grow until at most ``most`` triangles are left."""
    cell = math.sqrt(max(float(mesh.get_surface_area()), 1e-12) / most)
    simple = mesh
    for _ in range(_CLUSTERINGS):
        simple = mesh.simplify_vertex_clustering(cell)
        if len(simple.triangles) <= most:
            break
        cell *= 1.1 * math.sqrt(len(simple.triangles) / most)
    return simple


def _arrays(vector: Any, kind: Any) -> NDArray[Any]:
    return np.array(np.asarray(vector), dtype=kind).reshape(-1, 3)


def common_cube(first: MeshArrays | PointArrays, second: MeshArrays | PointArrays) -> tuple[UnitCube, float]:
    """Return the unit cube about two geometries, and the largest coordinate of either in it."""
    one, two = positions(first), positions(second)
    cube = UnitCube.around(one, two)
    reach = max(float(np.abs(cube.to_unit(points)).max()) for points in (one, two))
    return cube, reach
