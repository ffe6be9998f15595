"""Colours and other values from one surface to another: what the closest point of the first has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import weld_map
from fsh3d_o3d.geometry.nearest_point import nearest_points
from fsh3d_o3d.geometry.rays import UnitCube, UnitScene
from fsh3d_o3d.geometry.triangles import corner_shares, point_triangle_offsets

COLORS = "colors"
"""The name of the values that are drawn, (…, 3) in [0, 1]."""
TEXTURE_UVS = "texture_uvs"
"""The name of texture coordinates, (…, 2)."""
_CHUNK = 2**15  # points at a time, a choice, so that their triangles stay in the cache


def values_near(geometry: MeshArrays | PointArrays, points: Float64Array) -> dict[str, Float64Array]:
    """Return what a geometry has at its points closest to ``points`` (n, 3), (n,) or (n, k) by name.

    Colours, texture coordinates and attributes: on a mesh interpolated within the closest triangle, of a cloud those
    of the nearest point. Not normals, which every surface has of its own. Without any, nothing is computed.
    """
    if isinstance(geometry, PointArrays):
        return _of_nearest_points(geometry, points)
    if geometry.colors is None and geometry.texture_uvs is None and not geometry.attributes:
        return {}
    welded, source = weld_map(replace(geometry, normals=None, colors=None, attributes={}))
    cube = UnitCube.around(welded.vertices, points)
    scene = UnitScene(cube.to_unit(welded.vertices), welded.triangles)
    places = cube.to_unit(points)
    parts = [_located(scene, places[start : start + _CHUNK]) for start in range(0, len(points), _CHUNK)]
    triangle, share = (np.concatenate(part) for part in zip(*parts, strict=True))
    corners = source[welded.triangles[triangle]]
    values = {} if geometry.colors is None else {COLORS: geometry.colors}
    result = {
        name: np.asarray(np.einsum("nk,nk...->n...", share, array[corners]))
        for name, array in {**values, **geometry.attributes}.items()
    }
    if welded.texture_uvs is not None:
        result[TEXTURE_UVS] = np.asarray(np.einsum("nk,nkc->nc", share, welded.texture_uvs[triangle]))
    return result


def with_values(
    mesh: MeshArrays, values: dict[str, Float64Array], *, normals: Float64Array | None = None
) -> MeshArrays:
    """Return positions and triangles of a mesh with values (v,) or (v, k) at its vertices by name, and normals (v, 3).

    Colours are clipped to [0, 1].
    """
    rest = dict(values)
    colors, uvs = rest.pop(COLORS, None), rest.pop(TEXTURE_UVS, None)
    return MeshArrays(
        mesh.vertices,
        mesh.triangles,
        normals,
        None if colors is None else np.clip(colors, 0, 1),
        None if uvs is None else uvs[mesh.triangles],
        rest,
    )


def with_point_values(
    points: Float64Array, normals: Float64Array | None, values: dict[str, Float64Array]
) -> PointArrays:
    """Return points (n, 3) with normals and with values (n,) or (n, k) by name; colours are clipped to [0, 1]."""
    rest = dict(values)
    colors = rest.pop(COLORS, None)
    rest.pop(TEXTURE_UVS, None)  # of surfaces
    return PointArrays(points, normals, None if colors is None else np.clip(colors, 0, 1), rest)


def with_values_of(source: MeshArrays | PointArrays, mesh: MeshArrays) -> MeshArrays:
    """Return a mesh with the colours, texture coordinates and attributes of another surface close by; its own go."""
    return with_values(mesh, values_near(source, mesh.vertices), normals=mesh.normals)


def _of_nearest_points(cloud: PointArrays, points: Float64Array) -> dict[str, Float64Array]:
    values = dict(cloud.attributes)
    if cloud.colors is not None:
        values[COLORS] = cloud.colors
    if not values:
        return {}
    cube = UnitCube.around(cloud.points, points)
    nearest = nearest_points(cube.to_unit(points), cube.to_unit(cloud.points))
    return {name: array[nearest] for name, array in values.items()}


def _located(scene: UnitScene, points: Float64Array) -> tuple[IntArray, Float64Array]:
    """Return the closest triangle (n,) of each point and the shares (n, 3) of its corners in the closest point."""
    triangle = scene.closest(points)
    corners = scene.corners[triangle]
    return triangle, corner_shares(points + point_triangle_offsets(points, corners), corners)
