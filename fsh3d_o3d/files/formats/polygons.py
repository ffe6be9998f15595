"""Polygons into triangles: as fans where they are convex, by clipping ears where not."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import triangle_normals, triangulate

# Of a polygon's area: a smaller fold comes from rounding in single precision, not from a concave corner.
_FOLD_TOLERANCE = 1e-6
_NOTED_OVERLAP = 1e-3  # of a polygon's area, a choice: a smaller overlap that is left is not worth a note
_BLOCK = 8192  # quadrangles at a time: their coordinates, 0.8 MB, stay in the processor's cache


def cut_polygons(
    source: Source, vertices: Float64Array, polygons: IntArray, starts: IntArray, counts: IntArray
) -> IntArray:
    """Cut polygons into triangles of the same sense: every side stays, no corner is added.

    The fan around the first corner is right for what is convex. Where it folds back over itself, seen along the
    polygon's normal (Newell's: the sum of the fan's vector areas), a quadrangle is cut along its other diagonal, and a
    larger polygon by clipping its ears in the plane of that normal. Triangles of a polygon that crosses itself overlap.

    Args:
        source: The file, for notes.
        vertices: (v, 3) positions.
        polygons: (m,) vertex indices, one polygon after another, possibly with other values between them.
        starts: (p,) where each polygon begins in ``polygons``.
        counts: (p,) vertices of each polygon; those of one or two have no area and give no triangle.

    Returns:
        (Σ max(0, counts − 2), 3) triangles in the order of the polygons.
    """
    if len(counts) and counts.min() < 1:
        raise GeometryReadError(f"a face with {counts.min()} vertices")
    triangles = polygons[_fan(starts, counts)]
    if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
        return triangles  # an error further on
    positions = _of_size_one(vertices)
    candidates = np.flatnonzero(_may_fold(positions, polygons, starts, counts))
    if not len(candidates):
        return triangles
    first = np.cumsum(np.maximum(counts - 2, 0)) - np.maximum(counts - 2, 0)
    fans = counts[candidates] - 2
    folded, normals = _folded(positions, triangles[_ranges(first[candidates], fans)], fans, _FOLD_TOLERANCE)
    if len(folded):
        chosen, fans = candidates[folded], fans[folded]
        rows = _ranges(first[chosen], fans)
        corners = polygons[_ranges(starts[chosen], counts[chosen])]
        triangles[rows] = corners[_cut_folded(positions, corners, counts[chosen], normals)]
        overlapping, _ = _folded(positions, triangles[rows], fans, _NOTED_OVERLAP)
        if len(overlapping):
            source.note(f"{len(overlapping)} of {len(counts)} polygons cross themselves: their triangles overlap")
    return triangles


def _of_size_one(vertices: Float64Array) -> Float64Array:
    """Return positions divided by the largest coordinate: products of four of them neither over- nor underflow."""
    largest = np.abs(vertices).max()
    return vertices / largest if np.isfinite(largest) and largest > 0 else vertices


def _may_fold(positions: Float64Array, polygons: IntArray, starts: IntArray, counts: IntArray) -> NDArray[np.bool_]:
    """(p,) which polygons' fans have to be looked at: all of five corners and more, and folded quadrangles.

    A quadrangle's fan is right if its two triangles face the same side, which is quickly found out.
    """
    result = counts > 4
    four = np.flatnonzero(counts == 4)
    columns = [np.ascontiguousarray(positions[:, axis]) for axis in range(3)]
    for block in range(0, len(four), _BLOCK):
        quads = four[block : block + _BLOCK]
        corners = polygons[starts[quads] + np.arange(4)[:, None]]
        away = [column[corners] for column in columns]
        for coordinate in away:
            coordinate[1:] -= coordinate[0]
        x, y, z = away
        agreement = (y[1] * z[2] - z[1] * y[2]) * (y[2] * z[3] - z[2] * y[3])
        agreement += (z[1] * x[2] - x[1] * z[2]) * (z[2] * x[3] - x[2] * z[3])
        agreement += (x[1] * y[2] - y[1] * x[2]) * (x[2] * y[3] - y[2] * x[3])
        result[quads] = agreement < 0
    return result


def _folded(
    positions: Float64Array, triangles: IntArray, fans: IntArray, tolerance: float
) -> tuple[IntArray, Float64Array]:
    """Return which polygons have triangles that face against their normal, and the normals (f, 3) of those."""
    areas = triangle_normals(positions[triangles])
    first = np.cumsum(fans) - fans
    normals = np.add.reduceat(areas, first, axis=0)
    against = np.minimum(_dot(areas, np.repeat(normals, fans, axis=0)), 0)
    folded = np.flatnonzero(-np.add.reduceat(against, first) > tolerance * _dot(normals, normals))
    return folded, normals[folded]


def _cut_folded(positions: Float64Array, corners: IntArray, counts: IntArray, normals: Float64Array) -> IntArray:
    """Return (Σ counts − 2, 3) places in ``corners``: the triangles of polygons whose fans are not right."""
    starts = np.cumsum(counts) - counts
    plane = _in_their_planes(positions[corners], starts, counts, normals)
    fans = counts - 2
    first = np.cumsum(fans) - fans
    result = _fan(starts, counts)
    four = np.flatnonzero(counts == 4)
    other = result.copy()
    for place, turned in enumerate(((1, 2, 3), (1, 3, 0))):
        other[first[four] + place] = starts[four, None] + np.array(turned)
    for polygon in np.flatnonzero(counts > 4).tolist():  # the library takes one at a time, in microseconds
        start = starts[polygon]
        triangles = triangulate(plane[start : start + counts[polygon]])
        if triangles is not None and len(triangles) == fans[polygon]:
            other[first[polygon] : first[polygon] + fans[polygon]] = start + triangles
    # Where a polygon crosses itself nothing is right, and the fan may cover less.
    better = _covered(plane, other, first) < _covered(plane, result, first)
    return cast(IntArray, np.where(np.repeat(better, fans)[:, None], other, result))


def _in_their_planes(points: Float64Array, starts: IntArray, counts: IntArray, normals: Float64Array) -> Float64Array:
    """Return the corners (m, 2) of polygons against the clock, each polygon of about size one around its first."""
    normals = normals / np.sqrt(_dot(normals, normals))[:, None]
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, least)
    across /= np.sqrt(_dot(across, across))[:, None]
    up = np.cross(normals, across)
    away = points - np.repeat(points[starts], counts, axis=0)
    plane = np.stack([_dot(away, np.repeat(axis, counts, axis=0)) for axis in (across, up)], axis=1)
    size = np.maximum.reduceat(np.abs(plane).max(axis=1), starts)
    return cast(Float64Array, plane / np.repeat(size, counts)[:, None])


def _fan(starts: IntArray, counts: IntArray) -> IntArray:
    """Return (Σ max(0, counts − 2), 3) places: each polygon's fan around its first corner."""
    if len(counts) and counts[0] > 2 and (counts == counts[0]).all():  # the same in half the time
        step = np.arange(counts[0] - 2)
        fan = np.stack([0 * step, step + 1, step + 2], axis=1)
        return cast(IntArray, (starts[:, None] + fan.ravel()).reshape(-1, 3))
    fans = np.maximum(counts - 2, 0)
    corner = np.repeat(starts, fans)
    step = np.arange(len(corner)) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack([corner, corner + step + 1, corner + step + 2], axis=1)


def _covered(plane: Float64Array, triangles: IntArray, first: IntArray) -> Float64Array:
    """Return twice the area that each polygon's triangles cover, counted as often as they cover it."""
    a, b, c = (plane[triangles[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    return cast(Float64Array, np.add.reduceat(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]), first))


def _dot(u: Float64Array, v: Float64Array) -> Float64Array:
    # Not a matrix product: its rounding may depend on the place in the array, and equal corners must stay equal.
    return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1] + u[:, 2] * v[:, 2]


def _ranges(starts: IntArray, counts: IntArray) -> IntArray:
    """Return ``starts[i]``, ``starts[i] + 1`` … for ``counts[i]`` places, one range after another."""
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return cast(IntArray, np.repeat(starts, counts) + step)
