"""What alignment needs of one geometry, found when it is first asked for and kept."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.descriptors import LocalHarmonics, local_harmonics
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, Surface, voxel_means
from fsh3d_o3d.registration.finite import finite_arrays
from fsh3d_o3d.registration.fit import Side
from fsh3d_o3d.registration.settling import Ground
from fsh3d_o3d.registration.surface import plain_surface, resolved_surface

T = TypeVar("T")

_MESH_SAMPLES = 4  # times the option's samples on a mesh that is looked at as a scan is
_COARSE = 0.1  # RMS radii, edge of the cubes that are counted to know the area; a few hundred on most shapes
_NODES = 1500  # of the smaller surface: the details that a pose needs, at a tenth of the time of all points
_WIDEST = 0.06  # RMS radii of the smaller surface; a wider spacing hides how closely surfaces fit
_MOST_NODES = 60_000  # of the larger surface; more take seconds
_ALIKE = 0.05  # of the longest extent; noise of 1 % and lost details change extents by up to half as much
_LEVEL = np.sqrt(2)  # ratio of spacings that are told apart, so that a prepared target finds again what it has kept


class Prepared:
    """One geometry on its way to be aligned. What is kept pickles with it."""

    def __init__(self, geometry: MeshArrays | PointArrays, samples: int, name: str, dropped: int = 0) -> None:
        self.geometry = geometry
        self.samples = samples
        self.name = name
        self.dropped = dropped
        self._kept: dict[tuple[Any, ...], Any] = {}

    @classmethod
    def of(cls, geometry: Any, samples: int, name: str) -> Prepared:
        """Prepare what was given; points that are not finite are left out and counted.

        Raises:
            TypeError: Not a geometry; the message begins with ``name``.
            GeometryError: Empty, or no finite point; the message begins with ``name``.
        """
        arrays, _, dropped = finite_arrays(geometry, name)
        return cls(arrays, samples, name, dropped)

    @functools.cached_property
    def plain(self) -> Surface:
        """The surface by its plain area, in its own frame."""
        try:
            return plain_surface(self.geometry, self.samples)
        except GeometryError as error:
            raise GeometryError(f"{self.name}: {error}") from None

    @functools.cached_property
    def resolved(self) -> Surface:
        """The surface by its resolved area, in its own frame."""
        return resolved_surface(self.plain)

    @functools.cached_property
    def points(self) -> Float64Array:
        """(n, 3) points of the cloud, or on the mesh, about ``center``."""
        return self._located[0]

    @property
    def center(self) -> Float64Array:
        """(3,) mean of the points, in the geometry's coordinates."""
        return self._located[1]

    @functools.cached_property
    def _located(self) -> tuple[Float64Array, Float64Array]:
        if isinstance(self.geometry, MeshArrays):
            surface = plain_surface(self.geometry, _MESH_SAMPLES * self.samples)
            return surface.points * surface.rms_radius, surface.centroid
        center = self.geometry.points.mean(axis=0)
        return self.geometry.points - center, center

    @functools.cached_property
    def size(self) -> float:
        """Root mean square distance of the points from their mean."""
        size = float(np.sqrt(np.mean(np.einsum("ij,ij->i", self.points, self.points))))
        if not size > 0:
            raise GeometryError(f"{self.name}: the cloud has no extent: all points are the same")
        return size

    @functools.cached_property
    def _coarse(self) -> Float64Array:
        return voxel_means(self.points, _COARSE * self.size)

    @property
    def area(self) -> float:
        """About the area of the surface, in units of the geometry squared."""
        return len(self._coarse) * (_COARSE * self.size) ** 2

    @functools.cached_property
    def extents(self) -> Float64Array:
        """(3,) standard deviations of the area along its principal axes, the shortest first."""
        variance = np.linalg.eigvalsh(np.cov(self._coarse.T)) if len(self._coarse) > 1 else np.zeros(3)
        return np.asarray(np.sqrt(np.maximum(variance, 0)))

    @property
    def closest_spacing(self) -> float:
        """How closely points can be thinned before gaps between them show."""
        return float(np.sqrt(self.area / len(self.points)))

    def side(self, unit: float, spacing: float) -> Side:
        """The surface thinned to ``spacing``, both in ``unit`` as are the side's coordinates."""
        return self._once(("side", unit, spacing), lambda: Side.thinned(self.points / unit, spacing))

    def ground(self, unit: float, spacing: float) -> Ground:
        """The surface as rough poses settle on it."""
        side = self.side(unit, spacing)
        return self._once(("ground", unit, spacing), lambda: Ground.of(side.nodes, side.normals, spacing))

    def harmonics(self, unit: float, radius: float, keypoints: int) -> LocalHarmonics:
        """Local harmonics at about so many key points."""
        return self._once(
            ("harmonics", unit, radius, keypoints),
            lambda: local_harmonics(self.points / unit, radius, keypoints=keypoints),
        )

    def _once(self, key: tuple[Any, ...], make: Callable[[], T]) -> T:
        if key not in self._kept:
            self._kept[key] = make()
        kept: T = self._kept[key]
        return kept


def common_spacing(source: Prepared, target: Prepared, scale: float) -> float:
    """A spacing in units of the target at which both surfaces, the source ``scale`` times as large, can be thinned.

    The smaller one gets about ``_NODES`` nodes, but none finer than points of either one resolve. It is one of a ladder
    that depends on the target alone.
    """
    areas = source.area * scale**2, target.area
    spacing = min(np.sqrt(min(areas) / _NODES), _WIDEST * min(source.size * scale, target.size))
    least = source.closest_spacing * scale, target.closest_spacing, np.sqrt(max(areas) / _MOST_NODES)
    spacing = max(spacing, *least)
    return float(target.size * _LEVEL ** np.round(np.log(spacing / target.size) / np.log(_LEVEL)))


def alike(source: Prepared, target: Prepared, scaling: bool) -> bool:
    """Whether both may be the same shape seen whole: as long, wide and high, or in the same ratios."""
    one, other = source.extents, target.extents
    if scaling:
        one, other = one / one[-1], other / other[-1]
    return bool(np.abs(one - other).max() <= _ALIKE * max(one[-1], other[-1]))
