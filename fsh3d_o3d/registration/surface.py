"""What of a surface two scans, meshings or resolutions of it have in common: its frame and its coefficients.

Area is not the same for all of them: noise crumples triangles, decimation flattens folds, soups have walls twice. So
the area that counts is that of the surface seen at a resolution, where parts closer than that are one.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, Surface, surface_of, thinned
from fsh3d_o3d.shells import ShellFields, ShellSampler, VoxelGrid
from fsh3d_o3d.sphere import SphericalHarmonicTransform

_RESOLUTION = 0.15  # RMS radii: parts closer than about twice this are seen as one
_OUTER_RADIUS = 3.0  # RMS radii from the centroid; what lies farther out is not part of the shape
_SPARSE = 0.1  # of the median density; samples in places much emptier than this count little
_STRAY = 15.9  # times the median share of a point: the bound of `density_corrected` is 16
_STRAYS_AT_MOST = 0.25  # of all points; if there are more, the cloud is just uneven
_VOXELS = 40  # along an edge of the grid: its 0.16 RMS radii are about _RESOLUTION
_SHELLS = 12  # 1/6 of an RMS radius apart, about the width of the field on them
_WIDTH = np.sqrt(2) / 8  # RMS radii, of the Gaussian of the distance, as in the published descriptor
_ROUND = 0.01  # of the norm; less than this in degrees >= 1 is what sampling leaves of a sphere


def plain_surface(geometry: MeshArrays | PointArrays, samples: int) -> Surface:
    """Return a geometry about the centroid and at unit RMS radius of its area.

    Points of a cloud that stand far from all others are gone.

    Raises:
        GeometryError: No extent, or no area.
    """
    surface = surface_of(_thinned(geometry, samples), samples)
    stray = surface.weights > _STRAY * np.median(surface.weights)
    if surface.triangles is None and 0 < np.count_nonzero(stray) <= _STRAYS_AT_MOST * len(stray):
        surface = _reweighted(surface, np.where(stray, 0.0, surface.weights))
    return surface


def resolved_surface(surface: Surface) -> Surface:
    """Return a surface about the centroid and at unit RMS radius of its resolved area.

    Samples of no weight are gone: those far out, and those alone in empty places.
    """
    density = _unit_grid().density(surface)
    usual = float(np.median(density))
    return _reweighted(surface, surface.weights * density / (density**2 + (_SPARSE * usual) ** 2))


def shell_coefficients(surface: Surface, bandwidth: int) -> Float64Array:
    """Return the coefficients (shells, b²) of the field of a surface, each shell weighing by the root of its area."""
    transform, sampler = _plan(bandwidth)
    values = sampler.sample(surface)[0] * sampler.fields.radii[:, None]
    return np.asarray(transform.forward(values), dtype=np.float64)


def is_round(coefficients: Float64Array) -> bool:
    """Whether shells (S, b²) hardly depend on direction, as those of a sphere."""
    return bool(np.linalg.norm(coefficients[:, 1:]) <= _ROUND * np.linalg.norm(coefficients))


class _DensityGrid(VoxelGrid):
    """A voxel grid that tells how much area lies around samples."""

    def density(self, surface: Surface) -> Float64Array:
        """Area (n,) under a Gaussian about each sample; zero for samples beyond the grid."""
        blurred = self._blurred(self.deposit(surface).area, _RESOLUTION)
        seen = np.einsum("ij,ij->i", surface.points, surface.points) < self.outer**2
        index, weight = self._corners(np.where(seen[:, None], surface.points, 0.0) @ self._rotation)
        return np.asarray((blurred[index] * weight).reshape(8, -1).sum(axis=0) * seen)


@functools.cache
def _unit_grid() -> _DensityGrid:
    return _DensityGrid(np.zeros((1, 3)), _OUTER_RADIUS, _VOXELS)


@functools.lru_cache(maxsize=4)
def _plan(bandwidth: int) -> tuple[SphericalHarmonicTransform, ShellSampler]:
    fields = ShellFields(
        shells=_SHELLS,
        radius=2.0,
        route="voxel",
        distance="soft",
        widths=(_WIDTH,),
        smoothing=0.1,
        normal_width=None,
        normal_smoothing=0.2,
        voxels=_VOXELS,
    )
    transform = SphericalHarmonicTransform(bandwidth)
    return transform, ShellSampler(fields, transform.grid.directions)


def _thinned(geometry: MeshArrays | PointArrays, most: int) -> MeshArrays | PointArrays:
    """A cloud of at most so many points, whatever their order and pose; a mesh is sampled anyway."""
    if isinstance(geometry, MeshArrays) or len(geometry.points) <= most:
        return geometry
    kept = thinned(geometry.points, most)
    return PointArrays(geometry.points[kept], None if geometry.normals is None else geometry.normals[kept])


def _reweighted(surface: Surface, weights: Float64Array) -> Surface:
    """The surface with other weights, in the frame that they make; samples without any are left out."""
    kept = weights > 0
    if not kept.any():
        raise GeometryError("none of the surface's area lies near its centroid")
    weights = weights[kept] / weights.sum()
    centroid = weights @ surface.points[kept]
    points = surface.points[kept] - centroid
    covariance = (points * weights[:, None]).T @ points
    rms = float(np.sqrt(np.trace(covariance)))
    if not rms > 0:
        raise GeometryError("all of the surface's area lies in one point")
    return replace(
        surface,
        points=points / rms,
        normals=surface.normals[kept],
        weights=weights,
        covariance=covariance / rms**2,
        vertices=(surface.vertices - centroid) / rms,
        centroid=surface.centroid + centroid * surface.rms_radius,
        rms_radius=surface.rms_radius * rms,
    )
