"""Fields around a surface, sampled in space: signed distance, occupancy, and a Gaussian of the distance."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import (
    BoolArray,
    MeshArrays,
    PointArrays,
    Progress,
    UnitCube,
    UnitScene,
    geometry_arrays,
    measure_mesh,
    nearest_distances,
    open3d_point_cloud,
    point_triangle_distance,
    triangle_areas,
    triangle_normals,
    weld,
)
from fsh3d_o3d.shells.winding_number import Solid, inside, solid_of
from fsh3d_o3d.sphere import resolve_threads, run_all

FieldName = Literal["signed_distance", "occupancy", "gaussian_distance"]

FIELDS: tuple[FieldName, ...] = ("gaussian_distance", "occupancy", "signed_distance")
_CHUNK = 2**15  # points at a time, so that their triangles stay in the cache
_SAME_SIDE = 0.99  # of two points' distances together: a shorter step does not meet the surface; 1 % for float32
_FELT = 6.0  # widths: beyond, a Gaussian is below 2e-8, less than float32 tells beside 1, and counts as 0
_POISSON_DEPTH = 8  # 256 cells across: finer than 64 shells to either side
_CELLS = 32  # in the farthest distance of a cloud, to even out its density; a choice


@dataclass(frozen=True, eq=False)
class VolumeField:
    """A surface in a frame of its own, ready to be sampled anywhere."""

    field: FieldName
    """What is sampled."""
    center: Float64Array
    """(3,) the frame's origin, in the units of the input."""
    scale: float
    """Length of the frame's unit in the units of the input."""
    reach: float
    """Farthest point of the surface from the origin, in the frame."""
    width: float
    """Length of the field's transition, in the frame; see ``volume_field``."""
    solid: Solid | None
    """The surface; None for a cloud without normals."""
    points: Float64Array | None
    """(n, 3) the cloud in the frame, if distances are to points."""

    def sample(self, points: object, *, threads: int | None = None, progress: Progress | None = None) -> Float64Array:
        """Return the field at points (…, 3) of the frame, (…,) float64.

        Distances are float64. Points (…, m, 3) are best given as paths of m:
        neighbours on a path that are nearer to each other than to the surface are on the same side of it. ``progress``
        is told the share that is done.
        """
        paths = check.real_array(points, "points").astype(np.float64)
        if paths.ndim < 2 or paths.shape[-1] != 3 or paths.size == 0:
            raise ValueError(f"points must have shape (…, 3) with at least two axes, got {paths.shape}")
        distance = self._distance(paths.reshape(-1, 3), resolve_threads(threads), progress).reshape(paths.shape[:-1])
        if self.field == "gaussian_distance":
            return np.asarray(np.exp(-0.5 * (distance / self.width) ** 2))
        assert self.solid is not None
        signed = np.where(_inside_paths(self.solid, paths, distance), -distance, distance)
        if self.field == "signed_distance" and self.width == math.inf:
            return signed
        soft = np.tanh(signed / self.width)
        return np.asarray(self.width * soft if self.field == "signed_distance" else (1 - soft) / 2)

    def _distance(self, positions: Float64Array, threads: int, progress: Progress | None) -> Float64Array:
        if self.points is not None:
            return nearest_distances(positions, self.points, farthest=_FELT * self.width, progress=progress)
        assert self.solid is not None
        scene = UnitScene(self.solid.vertices, self.solid.triangles)
        done = itertools.count(1)

        def measured(part: Float64Array) -> Float64Array:
            distance = point_triangle_distance(part, scene.corners[scene.closest(part)])
            if progress is not None:
                progress(next(done) / len(parts))
            return distance

        parts = [positions[start : start + _CHUNK] for start in range(0, len(positions), _CHUNK)]
        return np.concatenate(run_all([functools.partial(measured, part) for part in parts], threads))


def _inside_paths(solid: Solid, paths: Float64Array, distance: Float64Array) -> BoolArray:
    """Which points (…, m) of paths (…, m, 3) are inside, asking once for each run on one side of the surface."""
    if not solid.closed:  # where the winding number is no whole number it may pass one half anywhere
        return inside(solid, paths.reshape(-1, 3)).reshape(distance.shape)
    step = np.linalg.norm(np.diff(paths, axis=-2), axis=-1)
    new = np.ones(distance.shape, dtype=np.bool_)
    # A step that meets the surface is no shorter than the two distances together. What float32 may have got wrong about
    # them is left aside.
    new[..., 1:] = step >= _SAME_SIDE * (distance[..., 1:] + distance[..., :-1])
    run = np.cumsum(new.ravel()) - 1
    flat = distance.ravel()
    # Asked at each run's point farthest from the surface, where rays graze least.
    order = np.lexsort((-flat, run))
    first = order[np.searchsorted(run, np.arange(run[-1] + 1))]
    return np.asarray(inside(solid, paths.reshape(-1, 3)[first])[run].reshape(distance.shape))


def volume_field(
    geometry: Any,
    field: FieldName = "signed_distance",
    *,
    center: object | None = None,
    scale: float | None = None,
    width: float | None = None,
) -> VolumeField:
    """Return a field of a surface, in a frame where the surface is of order one.

    ``signed_distance`` is w tanh(d/w) of the distance d, negative inside: equal to d near the surface, and without its
    kinks where two parts of the surface are equally far. ``occupancy`` is (1 − tanh(d/w))/2: 1 inside, 0 outside.
    ``gaussian_distance`` is exp(−d²/2w²) and does not ask for an inside.

    Meshes may be soups: patches are turned outward by what is seen from outside, openings smaller than a quarter of
    their patch are closed, and inside is where the winding number exceeds one half, so that overlapping and nested
    parts count once. A closed part inside another that is wound inward is a cavity.

    Args:
        geometry: Mesh or point cloud, as ``from_any`` takes it. Clouds need
            normals (any sign, as long as they agree) unless the field is ``gaussian_distance``.
        field: ``"signed_distance"``, ``"occupancy"`` or ``"gaussian_distance"``.
        center: (3,) origin of the frame; the centroid of the area, or of a cloud's occupied cells, if not given.
        scale: The frame's unit; the farthest distance of the surface from the centre if not given.
        width: w in units of ``scale``; 0.1 for distances (``math.inf``: the signed distance itself), 0.02 for
            occupancy.

    Raises:
        GeometryError: Empty, not finite, without extent or area, without normals where they are needed, or a surface
            that encloses nothing where an inside is needed.
        ValueError, TypeError: Another argument is out of range or of the wrong type.
    """
    check.choice(field, "field", FIELDS)
    softness = _width(field, width)
    size = None if scale is None else check.number(scale, "scale", minimum=0, exclusive=True)
    arrays = geometry_arrays(geometry)[0]
    middle = None if center is None else check.point(center, "center")
    mesh = weld(arrays) if isinstance(arrays, MeshArrays) else None
    positions = arrays.points if isinstance(arrays, PointArrays) else weld(arrays).vertices
    cube = UnitCube.around(positions)
    unit = cube.to_unit(positions)
    if middle is None:
        own = _cell_centroid(unit) if mesh is None else measure_mesh(MeshArrays(unit, mesh.triangles)).area_centroid
    else:
        own = cube.to_unit(middle)
    farthest = float(np.linalg.norm(unit - own, axis=1).max())
    length = farthest if size is None else size / cube.scale
    local = (unit - own) / length
    solid = None
    if mesh is not None:
        _require_area(local, mesh.triangles)
        solid = solid_of(local, mesh.triangles)
    elif field != "gaussian_distance":
        assert isinstance(arrays, PointArrays)
        solid = _cloud_solid(local, arrays.normals, field)
    if solid is not None and field != "gaussian_distance":
        _require_inside(solid)
    return VolumeField(
        field=field,
        center=cube.from_unit(own),
        scale=length * cube.scale,
        reach=farthest / length,
        width=softness,
        solid=solid,
        points=local if solid is None else None,
    )


def _width(field: FieldName, width: float | None) -> float:
    if width is None:
        return 0.02 if field == "occupancy" else 0.1
    if field == "signed_distance" and width == math.inf:
        return math.inf
    return check.number(width, "width", minimum=1e-6)


def _require_area(vertices: Float64Array, triangles: IntArray) -> None:
    # Of order one: below this the triangles are thinner than float64 tells from lines.
    if triangle_areas(vertices[triangles]).sum() <= 5e-15:
        raise GeometryError("the mesh has no area: all its triangles are degenerate")


def _require_inside(solid: Solid) -> None:
    """Refuse surfaces with nothing behind their triangles: sheets and scattered triangles."""
    corners = solid.vertices[solid.triangles]
    normals = triangle_normals(corners)
    area = np.linalg.norm(normals, axis=1)
    some = np.argsort(-area, kind="stable")[:4096]
    middle = corners[some].sum(axis=1) / 3
    probes = middle - 1e-3 * normals[some] / np.maximum(area[some], 1e-300)[:, None]
    if not inside(solid, probes).any():
        raise GeometryError(
            "the surface encloses nothing: it is an open sheet, or triangles that do not hang together; "
            'use field="gaussian_distance", which needs no inside'
        )


def _cloud_solid(points: Float64Array, normals: Float64Array | None, field: str) -> Solid:
    if normals is None:
        raise GeometryError(
            f'field="{field}" needs to know inside from outside, but the cloud has no normals: estimate them '
            '(estimate_normals, orient_normals_consistent_tangent_plane), or use field="gaussian_distance"'
        )
    length = np.linalg.norm(normals, axis=1)
    if len(points) < 10 or not np.all(np.isfinite(length)) or np.count_nonzero(length) < 0.5 * len(length):
        raise GeometryError(
            f"a solid needs at least 10 points with finite normals, got {len(points)} points, "
            f"{np.count_nonzero((length > 0) & np.isfinite(length))} with one"
        )
    use = length > 0
    cloud = open3d_point_cloud(PointArrays(points[use], normals[use] / length[use, None]))
    # One thread: the result must not depend on their number.
    poisson = open3d().geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=_POISSON_DEPTH, n_threads=1)
    triangles = np.asarray(poisson[0].triangles)
    if len(triangles) == 0:
        raise GeometryError("no closed surface fits the cloud's points and normals; are the normals consistent?")
    surface = weld(MeshArrays(np.asarray(poisson[0].vertices), triangles))
    return solid_of(surface.vertices, surface.triangles)


def _cell_centroid(points: Float64Array) -> Float64Array:
    """Mean of the occupied cells' means, so that dense parts of a cloud do not pull."""
    cell = np.floor(points * _CELLS).astype(np.int64) + _CELLS
    key = (cell[:, 0] * 4 * _CELLS + cell[:, 1]) * 4 * _CELLS + cell[:, 2]
    index = np.unique(key, return_inverse=True)[1].reshape(-1)
    count = np.bincount(index)
    return np.array([np.mean(np.bincount(index, weights=points[:, k]) / count) for k in range(3)])
