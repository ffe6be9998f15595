"""Which surface point each pixel sees: rays for meshes, splats in a depth buffer for points."""

from __future__ import annotations

import functools
import math
from typing import Any, cast

import numpy as np
import scipy

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import ray_casting_scene, ray_tensor, triangle_normals
from fsh3d_o3d.report.shading import Fragments, facing
from fsh3d_o3d.report.view import Raster
from fsh3d_o3d.sphere import fibonacci_grid

_TILE = 4  # pixels to a side that share out the directions of the occlusion rays
_RAYS = 4  # occlusion rays a pixel; the 16 pixels of a tile have 64 together
_OCCLUSION_REACH = 0.6  # of the bounding sphere's radius, beyond which nothing shuts out light
_RAY_OFFSET = 2e-3  # of the radius, off the surface, where occlusion rays begin: some facets' sagitta
_DEPTH_STEPS = 2**31  # of the depth buffer over view space
_FAR = 1e6  # pixels, where a point is surely outside of the picture
_NEIGHBOURS = 16  # of a point, for its normal


def mesh_fragments(
    vertices: Float64Array,
    triangles: IntArray,
    raster: Raster,
    *,
    normals: Float64Array | None,
    colors: Float64Array,
    occlusion: bool,
) -> Fragments:
    """Return what the pixels see of a mesh.

    Args:
        vertices: (v, 3) in view space.
        triangles: (t, 3).
        raster: The pixels.
        normals: (v, 3) in view space, not necessarily finite, or None for flat triangles.
        colors: (v, 3) or (1, 3) sRGB.
        occlusion: Whether nearby surface shuts out light.
    """
    scene = ray_casting_scene(vertices, triangles)
    above = max(2.0, float(vertices[:, 2].max()) + 1)  # the view may be fitted to another, smaller geometry
    start = np.column_stack((raster.centers(), np.full(raster.width * raster.height, above)))
    answer = scene.cast_rays(ray_tensor(start, np.array([0.0, 0.0, -1.0])))
    distance = answer["t_hit"].numpy()
    pixel = np.flatnonzero(np.isfinite(distance))
    corner = triangles[answer["primitive_ids"].numpy()[pixel].astype(np.int64)]
    uv = answer["primitive_uvs"].numpy()[pixel].astype(np.float64)
    at_hits = functools.partial(np.einsum, "kc,kcd->kd", np.column_stack((1 - uv.sum(axis=1), uv)))

    flat = facing(unit(triangle_normals(vertices[corner])))
    normal = flat
    if normals is not None:
        smooth = unit(at_hits(normals[corner]))
        # Wound or oriented the other way round, a vertex normal still tells the curvature.
        smooth *= np.where(np.einsum("kd,kd->k", smooth, flat) < 0, -1.0, 1.0)[:, None]
        normal = np.where(np.isfinite(smooth).all(axis=1, keepdims=True), smooth, flat)
    color = colors[np.zeros(len(pixel), dtype=np.int64)] if len(colors) == 1 else at_hits(colors[corner])
    place = start[pixel] - distance[pixel, None].astype(np.float64) * (0.0, 0.0, 1.0)
    openness = _openness(scene, place, flat, pixel, raster) if occlusion else np.ones(len(pixel))
    return Fragments(pixel=pixel, normal=normal, color=color, openness=openness)


def point_fragments(
    points: Float64Array, raster: Raster, *, normals: Float64Array | None, colors: Float64Array
) -> Fragments:
    """Return what the pixels see of points (n, 3) in view space, each a disc about as wide as the points are apart.

    Without normals (n, 3), they are estimated from neighbours. Colours are (n, 3) or (1, 3).
    """
    count = len(points)
    # Half of the points lie in front, on about the area of the bounding sphere's disc.
    spacing = raster.scale * math.sqrt(2 * math.pi / count)
    radius = float(np.clip(0.75 * spacing, 0.7, 0.022 * raster.scale + 1))
    reach = int(radius)
    across, down = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    inside = across**2 + down**2 <= radius**2
    column, row = (np.clip(value, -_FAR, _FAR).astype(np.int64) for value in np.floor(raster.pixels(points)))
    # One integer orders first by depth, then by index, so that the buffer tells which point won.
    depth = (np.clip((points[:, 2] + 2) / 4, 0, 1) * (_DEPTH_STEPS - 1)).astype(np.int64)
    key = (depth << 32) | np.arange(count)
    buffer = np.full(raster.width * raster.height, -1, dtype=np.int64)
    for right, below in zip(across[inside], down[inside], strict=True):  # over the pixels of a disc, not the points
        x, y = column + right, row + below
        visible = (x >= 0) & (x < raster.width) & (y >= 0) & (y < raster.height)
        np.maximum.at(buffer, y[visible] * raster.width + x[visible], key[visible])
    pixel = np.flatnonzero(buffer >= 0)
    winner = buffer[pixel] & (2**32 - 1)
    normal = estimated_normals(points) if normals is None else normals
    # Points at the back, seen through gaps, are darker.
    openness = np.clip(0.68 + 0.32 * points[winner, 2], 0, 1)
    color = colors[np.zeros(len(pixel), dtype=np.int64) if len(colors) == 1 else winner]
    return Fragments(pixel=pixel, normal=facing(normal[winner]), color=color, openness=openness)


def _openness(scene: Any, place: Float64Array, normal: Float64Array, pixel: IntArray, raster: Raster) -> Float64Array:
    """Return the cosine-weighted part of the hemisphere (k,) from which nothing nearby shuts out light.

    Each pixel of a tile sends a few rays of a common set, and a filter of a tile's size puts the set together.
    """
    row, column = np.divmod(pixel, raster.width)
    share = (row % _TILE) * _TILE + column % _TILE
    offsets = fibonacci_grid(_TILE**2 * _RAYS).directions
    start = place + _RAY_OFFSET * normal
    open_rays = np.zeros(len(pixel))
    for ray in range(_RAYS):
        towards = unit(normal + 0.999 * offsets[share + _TILE**2 * ray])  # cosine-distributed; never of length zero
        hit = scene.test_occlusions(ray_tensor(start, towards), tnear=0.0, tfar=_OCCLUSION_REACH)
        open_rays += ~hit.numpy()
    image, seen = np.zeros((2, raster.height * raster.width))
    image[pixel], seen[pixel] = open_rays / _RAYS, 1
    mean, weight = (
        scipy.ndimage.uniform_filter(value.reshape(raster.height, raster.width), 2 * _TILE, mode="constant").ravel()[
            pixel
        ]
        for value in (image, seen)
    )
    return cast(Float64Array, np.clip(mean / weight, 0, 1))


def estimated_normals(points: Float64Array) -> Float64Array:
    """Return unit normals (n, 3), of either sign, of points of order one from their neighbours; NaN for none."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(min(_NEIGHBOURS, len(points))))
    return unit(np.asarray(cloud.normals))


def unit(vectors: Float64Array) -> Float64Array:
    """Return vectors (k, 3) of length one; NaN where there is none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return cast(Float64Array, vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
