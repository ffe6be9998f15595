"""A surface in its own frame: area centroid at the origin, RMS radius one, exact moments, even samples."""

from __future__ import annotations

import functools

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.cloud_density import density_corrected
from fsh3d_o3d.geometry.rays import UnitCube
from fsh3d_o3d.geometry.triangles import even_places

# Twice a triangle's area is noise where it is below its longest edge times the rounding of its corners.
_ROUNDING = 4 * np.finfo(np.float64).eps
_NO_AREA = "the mesh has no area: all its triangles are degenerate, or too small for their distance from the origin"


@value
class Surface:
    """A mesh or point cloud moved to its area centroid and scaled to unit RMS radius, with samples of its area."""

    points: Float64Array
    """(n, 3) samples spread by area."""
    normals: Float64Array
    """(n, 3) normals at the samples: of any length and either sign, zero where unknown."""
    weights: Float64Array
    """(n,) shares of the area, summing to 1."""
    covariance: Float64Array
    """(3, 3) second moments of the area, trace 1."""
    vertices: Float64Array
    """(v, 3) the mesh's vertices, or the cloud's points."""
    triangles: IntArray | None
    """(t, 3) the mesh's triangles with area, or None for a cloud."""
    centroid: Float64Array
    """(3,) centroid of the area, in the coordinates of the geometry."""
    rms_radius: float
    """Root mean square distance of the area from its centroid, in the units of the geometry."""

    def whitened(self, power: float, floor: float) -> Surface:
        """The surface stretched along its principal axes by C^(−power/2), at unit RMS radius again.

        Power 1 gives a shape whose axes are alike, 0 the shape as it is. Eigenvalues below ``floor`` of the largest
        count as that, so that a flat shape stays one. Samples keep their shares of the area before the stretch.
        """
        if power == 0:
            return self
        value, axes = np.linalg.eigh(self.covariance)
        stretch = np.sqrt(np.maximum(value, floor * value[-1])) ** power
        matrix = (axes / stretch) @ axes.T
        matrix /= np.sqrt(np.trace(matrix @ self.covariance @ matrix))
        return Surface(
            points=self.points @ matrix,
            normals=self.normals @ ((axes * stretch) @ axes.T),  # covectors: by the inverse
            weights=self.weights,
            covariance=matrix @ self.covariance @ matrix,
            vertices=self.vertices @ matrix,
            triangles=self.triangles,
            centroid=self.centroid,
            rms_radius=self.rms_radius,
        )


def surface_of(geometry: MeshArrays | PointArrays, samples: int) -> Surface:
    """Return a geometry in its own frame.

    A mesh's moments are exact integrals over its triangles, so they do not depend on how it is triangulated, on the
    order of vertices, or on repeated and unused ones; its ``samples`` are stratified by area in the order of the
    triangles. A cloud's points are weighted by the area each stands for (``density_corrected``).

    Raises:
        GeometryError: No extent, or no area.
    """
    return _mesh_surface(geometry, samples) if isinstance(geometry, MeshArrays) else _cloud_surface(geometry)


def _mesh_surface(mesh: MeshArrays, samples: int) -> Surface:
    vertices = mesh.gathered_vertices
    cube = UnitCube.around(vertices)
    # One row a coordinate: gathering and multiplying contiguous rows is several times faster than (t, 3) columns.
    rows = np.ascontiguousarray(cube.to_unit(vertices).T)
    a, b, c = (np.take(rows, mesh.triangles[:, k], axis=1) for k in range(3))
    e, f = b - a, c - a
    normal = np.stack([e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]])
    area = np.sqrt(_squares(normal))
    longest = functools.reduce(np.maximum, (_squares(edge) for edge in (e, f, c - b)))
    resolution = _ROUNDING * (1 + float(np.abs(cube.origin).max() / cube.scale))
    area[area <= resolution * np.sqrt(longest)] = 0
    total = np.cumsum(area)
    if total[-1] <= 0:
        raise GeometryError(_NO_AREA)
    share = area / total[-1]
    middle = a + (e + f) / 3
    centroid = middle @ share
    middle -= centroid[:, None]
    # ∫ x xᵀ over a triangle is its area times (g gᵀ + (2 e eᵀ + 2 f fᵀ − e fᵀ − f eᵀ)/36), g its middle, e and f edges.
    mixed = (e * share) @ f.T
    covariance = (middle * share) @ middle.T
    covariance += (2 * (e * share) @ e.T + 2 * (f * share) @ f.T - mixed - mixed.T) / 36
    rms = _rms(covariance)
    # One sample in each of equal shares of the area, within the triangles by a Kronecker sequence.
    index = np.arange(samples)
    chosen = np.searchsorted(total, (index + 0.5) / samples * total[-1])
    u, v = even_places(index, 0.5)
    points = np.take(a, chosen, axis=1) - centroid[:, None]
    points += u * np.take(e, chosen, axis=1) + v * np.take(f, chosen, axis=1)
    return Surface(
        points=np.ascontiguousarray((points / rms).T),
        normals=np.ascontiguousarray(np.take(normal, chosen, axis=1).T),
        weights=np.full(samples, 1 / samples),
        covariance=covariance / rms**2,
        vertices=np.ascontiguousarray(((rows - centroid[:, None]) / rms).T),
        triangles=mesh.triangles if area.all() else mesh.triangles[area > 0],
        centroid=cube.from_unit(centroid),
        rms_radius=rms * cube.scale,
    )


def _cloud_surface(cloud: PointArrays) -> Surface:
    cube = UnitCube.around(cloud.points)
    points, normals, weights = density_corrected(cube.to_unit(cloud.points), cloud.normals)
    centroid = weights @ points
    points = points - centroid
    covariance = (points * weights[:, None]).T @ points
    rms = _rms(covariance)
    points = points / rms
    return Surface(
        points=points,
        normals=normals,
        weights=weights,
        covariance=covariance / rms**2,
        vertices=points,
        triangles=None,
        centroid=cube.from_unit(centroid),
        rms_radius=rms * cube.scale,
    )


def _rms(covariance: Float64Array) -> float:
    rms = float(np.sqrt(np.trace(covariance)))
    if not rms > 0:
        raise GeometryError("all of the surface's area lies in one point")
    return rms


def _squares(rows: Float64Array) -> Float64Array:
    return np.asarray(rows[0] * rows[0] + rows[1] * rows[1] + rows[2] * rows[2])
