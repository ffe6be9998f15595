"""The solid a triangle soup stands for: triangles turned outward, small holes closed, and what is inside.

Three steps, each of which leaves a clean mesh alone. Neighbouring triangles are wound alike, patch by patch; a patch
is turned so that its front is the side that more rays leave for infinity (Takayama et al. 2014, "A simple method for
correcting facet orientations in polygon meshes based on ray casting"); boundary loops that are small beside their
patch are closed by a fan. Inside is where the generalised winding number (Jacobson et al. 2013) exceeds one half. It is
the mean over directions of the signed crossings of a ray, and where the surface is closed any single ray gives it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import (
    BoolArray,
    EdgeTable,
    UnitScene,
    components,
    even_places,
    points_at,
    triangle_areas,
    triangle_normals,
)
from fsh3d_o3d.sphere import fibonacci_grid

_FAN_SHARE = 0.25  # of a patch's area: larger openings are the shape's own
_ORIENTATION_RAYS = 40_000  # over all triangles, at least one each; a choice, time grows in proportion
_MOST_RAYS = 64  # from a triangle, however few there are
_RAY_OFFSET = 1e-4  # of rays from the surface they start on, in the unit cube: some hundred float32 steps
_CLOSED_VOTES, _OPEN_VOTES = 3, 32  # rays a point: of closed surfaces a median, of open ones a mean
_CHUNK = 2**17  # rays at once, so that the lists of their hits stay small; a choice


@dataclass(frozen=True, eq=False)
class Solid:
    """Triangles in the unit cube, wound outward, and whether they bound a volume."""

    vertices: Float64Array
    """(v, 3) positions of order one."""
    triangles: IntArray
    """(t, 3) indices, no corner twice."""
    closed: bool
    """Every edge is run through as often in one direction as in the other: the winding number is a whole number."""


def solid_of(vertices: Float64Array, triangles: IntArray) -> Solid:
    """Return the solid of welded triangles (t, 3) of vertices (v, 3) in the unit cube."""
    table = EdgeTable(triangles)
    patch, flips = _patches(table)
    if flips.any() or not table.balanced or _volumes(vertices, triangles, patch).min() <= 0:
        triangles = _turned(triangles, flips)
        triangles = _turned(triangles, _seen_from_behind(vertices, triangles, patch)[patch])
        vertices, triangles = _with_fans(vertices, triangles, patch)
        table = EdgeTable(triangles)
    return Solid(vertices, triangles, table.balanced)


def inside(solid: Solid, points: Float64Array) -> BoolArray:
    """Return which points (n, 3) of the unit cube have a winding number above one half."""
    scene, normals = UnitScene(solid.vertices, solid.triangles), triangle_normals(solid.vertices[solid.triangles])
    votes = _CLOSED_VOTES if solid.closed else _OPEN_VOTES
    # The poles of the grid look along no axis: rays along an axis graze the faces of boxes.
    directions = fibonacci_grid(votes).directions @ _tilt()
    result = np.empty(len(points), dtype=np.bool_)
    for start in range(0, len(points), _CHUNK):
        part = points[start : start + _CHUNK]
        counts = np.stack([_winding(scene, normals, part, direction) for direction in directions])
        # A ray through an edge may count it twice or not at all; where all should agree the median forgives one.
        number = np.median(counts, axis=0) if solid.closed else counts.mean(axis=0)
        result[start : start + _CHUNK] = number > 0.5
    return result


def _winding(scene: UnitScene, normals: Float64Array, points: Float64Array, direction: Float64Array) -> Float64Array:
    """Return how often the surface is left minus entered along a ray from each point, (n,)."""
    ray, triangle = scene.crossings(points, direction)
    weights = np.sign(normals @ direction)[triangle]
    return np.bincount(ray, weights=weights, minlength=len(points)).astype(np.float64, copy=False)


def _patches(table: EdgeTable) -> tuple[IntArray, BoolArray]:
    """The patch (t,) each triangle belongs to, and which (t,) to turn over to wind every patch alike.

    Patches hang together by edges of exactly two triangles. Of the two windings the one that turns over fewer is
    taken; a patch with one side only (Möbius) stays as it is.
    """
    pairs = table.pairs()
    count = len(table.triangles)
    one, other = pairs[:, 0] // 3, pairs[:, 1] // 3
    # Two copies of each triangle, as given and turned over; consistent copies are linked.
    shift = np.where(table.opposite(pairs), 0, count)
    number, label = components(
        np.concatenate((one, one + count)), np.concatenate((other + shift, other + count - shift)), 2 * count
    )
    size = np.bincount(label[:count], minlength=number)
    kept, turned = size[label[:count]], size[label[count:]]
    flips = (turned > kept) | ((turned == kept) & (label[count:] < label[:count]))
    patch = np.unique(np.minimum(label[:count], label[count:]), return_inverse=True)[1].reshape(-1)
    return patch.astype(np.int64), np.asarray(flips)


def _seen_from_behind(vertices: Float64Array, triangles: IntArray, patch: IntArray) -> BoolArray:
    """Which patches (p,) let more rays escape from their backs than from their fronts."""
    scene = UnitScene(vertices, triangles)
    normals = triangle_normals(vertices[triangles])
    area = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(area, 1e-300)[:, None]
    each = int(np.clip(_ORIENTATION_RAYS // len(triangles), 1, _MOST_RAYS))
    owner = np.repeat(np.arange(len(triangles)), each)
    number = np.arange(len(owner))
    directions = fibonacci_grid(4096).directions[(number * 1597) % 4096]  # coprime: neighbours look far apart
    directions *= np.where(np.einsum("ij,ij->i", directions, normals[owner]) < 0, -1.0, 1.0)[:, None]
    start = points_at(vertices[triangles[owner]], even_places(number + 0.5))
    lift = _RAY_OFFSET * normals[owner]
    front = np.isinf(scene.cast(start + lift, directions)[0])
    back = np.isinf(scene.cast(start - lift, -directions)[0])
    balance = np.bincount(patch[owner], weights=area[owner] * (front * 1.0 - back))
    return np.asarray(balance < 0)


def _with_fans(vertices: Float64Array, triangles: IntArray, patch: IntArray) -> tuple[Float64Array, IntArray]:
    """Close boundary loops by fans about their centroids where the fan is small beside the patch."""
    table = EdgeTable(triangles)
    border = table.order[table.first[table.faces == 1]]
    if border.size == 0:
        return vertices, triangles
    start, end = triangles.ravel()[border], triangles[:, (1, 2, 0)].ravel()[border]
    label = components(start, end, len(vertices))[1][start]
    loop = np.unique(label, return_inverse=True)[1].reshape(-1)
    length = np.linalg.norm(vertices[end] - vertices[start], axis=1)
    total = np.bincount(loop, weights=length)
    middle = (vertices[start] + vertices[end]) / 2
    tips = np.stack([np.bincount(loop, weights=length * middle[:, k]) / total for k in range(3)], axis=1)
    fan = 2 * triangle_areas(np.stack((tips[loop], vertices[start], vertices[end]), axis=1))
    patch_area = np.bincount(patch, weights=2 * triangle_areas(vertices[triangles]))
    # A loop may run along several patches; the largest counts.
    largest = np.zeros(len(total))
    np.maximum.at(largest, loop, patch_area[patch[border // 3]])
    small = (np.bincount(loop, weights=fan) <= _FAN_SHARE * largest)[loop]
    caps = np.column_stack((end, start, len(vertices) + loop))[small]
    return np.concatenate((vertices, tips)), np.concatenate((triangles, caps))


def _turned(triangles: IntArray, flips: NDArray[np.bool_]) -> IntArray:
    return np.where(flips[:, None], triangles[:, (0, 2, 1)], triangles)


def _volumes(vertices: Float64Array, triangles: IntArray, patch: IntArray) -> Float64Array:
    """Signed volume (p,) of each patch, times six."""
    triple_products = np.einsum("ij,ij->i", vertices[triangles[:, 0]], triangle_normals(vertices[triangles]))
    return np.asarray(np.bincount(patch, weights=triple_products), dtype=np.float64)


@functools.cache
def _tilt() -> Float64Array:
    """A fixed rotation with no axis or plane of symmetry in common with usual shapes."""
    q, r = np.linalg.qr(np.array([[0.41, -0.83, 0.37], [0.62, 0.55, 0.29], [-0.71, 0.13, 0.94]]))
    rotation: Float64Array = q * np.sign(np.diag(r))
    return rotation
