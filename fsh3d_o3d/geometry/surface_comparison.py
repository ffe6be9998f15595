"""How far two surfaces are apart: RMSE, MAE, maximum and volume error, as the paper's section 4.3 uses them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from fsh3d_o3d._validation import Float64Array, integer
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.given import from_any
from fsh3d_o3d.geometry.measures import area_samples, enclosed_volume, weld
from fsh3d_o3d.geometry.nearest_point import nearest_distances
from fsh3d_o3d.geometry.rays import UnitCube, UnitScene
from fsh3d_o3d.geometry.triangles import point_triangle_distance

_CHUNK = 2**17  # points at a time, for memory; a choice


@value
class SurfaceError:
    """Distances between an original and its reconstruction."""

    rmse: float
    """Root of the mean squared distance, both sides weighing the same."""
    mae: float
    """Mean distance, both sides weighing the same."""
    maximum: float
    """Largest distance found from either side, vertices included: the Hausdorff distance, from below."""
    volume_error: float | None
    """|V_reconstruction − V_original| / V_original of the enclosed volumes; None where either encloses none."""
    diagonal: float
    """Bounding-box diagonal of the original."""

    def relative(self) -> SurfaceError:
        """Return the same errors with distances in units of the original's diagonal."""
        unit = self.diagonal
        return replace(self, rmse=self.rmse / unit, mae=self.mae / unit, maximum=self.maximum / unit, diagonal=1.0)


def surface_error(original: Any, reconstruction: Any, *, samples: int = 100_000, seed: int = 0) -> SurfaceError:
    """Measure how far a reconstruction is from the original.

    Two meshes are compared from both sides: ``samples`` points spread evenly over the area of each are measured to the
    closest point of the other; RMSE² and MAE are the means of the two sides' means. The maximum also takes all
    vertices. A mesh and a point cloud are compared from the cloud's side only, each point to the surface, because a
    cloud's gaps are not the surface's fault; two clouds from both, to the nearest point. Distances are float64
    throughout, so that equal meshes are some 1e-16 of their size apart.

    Args:
        original: Mesh or point cloud, as ``from_any`` takes it.
        reconstruction: The same.
        samples: Points on each mesh.
        seed: Of the samples; the same seed gives the same figures.

    Raises:
        TypeError: Other objects.
        GeometryError: Empty, without extent or area.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> shape = fsh.RadialShape.from_geometry(mesh, bandwidth=16)
        >>> for bandwidth in (4, 16):
        ...     error = fsh.surface_error(mesh, shape.truncated(bandwidth).to_triangle_mesh(), samples=10_000)
        ...     print(f"bandwidth {bandwidth}: RMSE {100 * error.relative().rmse:.1f} % of the diagonal")
        ...
        bandwidth 4: RMSE 1.6 % of the diagonal
        bandwidth 16: RMSE 0.2 % of the diagonal
    """
    first = from_any(original)
    second = from_any(reconstruction)
    count = integer(samples, "samples", minimum=1)
    cube = UnitCube.around(_positions(first), _positions(second))
    sides = []
    if isinstance(first, PointArrays) or isinstance(second, MeshArrays):
        sides.append(_one_side(first, second, cube, count, seed))
    if isinstance(second, PointArrays) or isinstance(first, MeshArrays):
        sides.append(_one_side(second, first, cube, count, seed))
    volume_error = None
    if isinstance(first, MeshArrays) and isinstance(second, MeshArrays):
        volume_error = _volume_error(first, second)
    mean_square, mean, largest = np.array(sides).T
    return SurfaceError(
        rmse=math.sqrt(mean_square.mean()) * cube.scale,
        mae=float(mean.mean()) * cube.scale,
        maximum=float(largest.max()) * cube.scale,
        volume_error=volume_error,
        diagonal=first.diagonal,
    )


def vertex_distances(geometry: Any, target: Any) -> Float64Array:
    """Return the distance (v,) from each vertex or point of a geometry to the closest point of another.

    Made for colour maps: one value a vertex, in the order of the vertices.

    Args:
        geometry: Mesh or point cloud, as ``from_any`` takes it.
        target: The same; distances to a cloud are to its nearest point.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> smooth = fsh.RadialShape.from_geometry(mesh, bandwidth=16).to_triangle_mesh()
        >>> distances = fsh.vertex_distances(smooth, mesh)  # for a map of colours
        >>> len(distances) == len(smooth.vertices), bool(distances.max() < 0.1)
        (True, True)
    """
    source = from_any(geometry)
    other = from_any(target)
    points = source.vertices if isinstance(source, MeshArrays) else source.points
    cube = UnitCube.around(points, _positions(other))
    return np.asarray(_distances(cube.to_unit(points), other, cube) * cube.scale)


def _positions(geometry: MeshArrays | PointArrays) -> Float64Array:
    if isinstance(geometry, PointArrays):
        return geometry.points
    return geometry.used_vertices


def _one_side(
    source: MeshArrays | PointArrays, target: MeshArrays | PointArrays, cube: UnitCube, count: int, seed: int
) -> tuple[float, float, float]:
    """Return mean square, mean and maximum of the distances from one geometry to another, in the cube."""
    if isinstance(source, PointArrays):
        measured = _distances(cube.to_unit(source.points), target, cube)
        return float(np.square(measured).mean()), float(measured.mean()), float(measured.max())
    unit = MeshArrays(cube.to_unit(source.vertices), source.triangles)
    points = np.concatenate((area_samples(unit, count, seed=seed)[0], _positions(unit)))
    measured = _distances(points, target, cube)
    sampled = measured[:count]
    return float(np.square(sampled).mean()), float(sampled.mean()), float(measured.max())


def _distances(points: Float64Array, target: MeshArrays | PointArrays, cube: UnitCube) -> Float64Array:
    if isinstance(target, PointArrays):
        return nearest_distances(points, cube.to_unit(target.points))
    try:
        target = weld(target)
    except GeometryError:
        raise GeometryError("the mesh to measure distances to has no area") from None
    scene = UnitScene(cube.to_unit(target.vertices), target.triangles)
    parts = [points[start : start + _CHUNK] for start in range(0, len(points), _CHUNK)]
    return np.concatenate([point_triangle_distance(part, scene.corners[scene.closest(part)]) for part in parts])


def _volume_error(original: MeshArrays, reconstruction: MeshArrays) -> float | None:
    before, after = enclosed_volume(original), enclosed_volume(reconstruction)
    if before is None or after is None or before == 0:
        return None
    return abs(after - before) / before
