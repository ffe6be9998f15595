"""How far from star-shaped a surface is, seen from a centre, and where the best centre lies."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from fsh3d_o3d._validation import Float64Array, point
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import (
    EdgeTable,
    MeshArrays,
    UnitCube,
    UnitScene,
    area_samples,
    geometry_arrays,
    oriented,
    solid_volume,
    weld,
)
from fsh3d_o3d.radial.star_kernel import FacePlanes, kernel_center
from fsh3d_o3d.sphere import fibonacci_grid

_SEED = 20  # of the area samples: fixed, so that the same mesh gives the same report
_DIRECTIONS = 4096  # of the report's rays: fractions are right to 0.8 % (standard error at one half)
_SAMPLES = 8192  # of the area: fractions are right to 0.6 %
_COARSE_SAMPLES = 1024  # to tell candidates apart before the best are looked at closely
_COARSE_DIRECTIONS = 256  # the same, for the share of directions that meet the surface: right to 3 %
_CLEARANCE = 0.01  # distance from the surface, in the unit cube, below which a candidate's score falls in proportion
_FINALISTS = 4  # candidates looked at closely, a choice: coarse samples may order near equals wrongly
_LATTICE = 8  # interior candidates: the inner ones of a lattice of this many points along each side of the bounding box
_REACHED = 1e-4  # a ray that ends within this fraction of its length before a sample has reached it
# Hits along one direction closer than this, in units of the largest coordinate seen from the centre, are one hit.
SAME_HIT = 1e-5


@value
class StarReport:
    """How much of a surface a centre sees."""

    center: Float64Array
    """(3,) the centre."""
    exact: bool
    """The surface is closed and star-shaped: the centre lies strictly on the inner side of every face's plane, and the
    faces cover the sphere once. Strict: one sliver with a wrong normal fails it."""
    inside_fraction: float
    """Fraction of the area whose planes have the centre on their inner side; 0 for surfaces that cannot be oriented."""
    visible_area: float
    """Fraction of the area that straight lines from the centre reach, by ray casting."""
    missed: float
    """Fraction of directions from the centre that never meet the surface."""
    multiple: float
    """Fraction of directions from the centre whose first and last meeting with the surface differ."""
    clearance: float | None
    """Signed distance from the centre to the nearest face plane, negative where the centre is outside one; None for
    surfaces that cannot be oriented."""
    kernel_radius: float | None
    """Radius of the largest ball in the kernel, the set of centres that see everything; negative where the kernel is
    empty, None where it was not looked for."""


def star_report(mesh: MeshArrays, center: Float64Array) -> StarReport:
    """Return how star-shaped a surface is, seen from ``center`` (3,); ``kernel_radius`` is left None.

    Vertices are welded and faces oriented first. The ray tests use fixed samples: 8192 on the surface, 4096 directions.

    Raises:
        ValueError: The centre is not a finite (3,) vector.
        GeometryError: The mesh has no extent or no area.
    """
    return _StarTests(mesh).report(point(center, "center"), None)


def star_center(mesh: Any, method: Literal["best", "centroid"] | Float64Array = "best") -> StarReport:
    """Choose a centre for radial functions and report how star-shaped the surface is, seen from there.

    Args:
        mesh: Triangle mesh, as ``from_any`` takes it: a closed surface, or an open one, of which only ray tests tell.
        method: ``"best"``: the centre of the largest ball in the kernel, found by a cutting-plane linear programme over
            the planes of all faces; where the kernel is empty, or slivers with wrong normals empty it, the point that
            sees most area without touching the surface, searched among the centroids, the point least outside of any
            plane and points inside, then refined. ``"centroid"``: of the enclosed volume, of the surface where it
            encloses none. A (3,) array: that point.

    Raises:
        TypeError: Not a triangle mesh.
        ValueError: Another method, or a centre that is not a finite (3,) vector.
        GeometryError: The mesh has no extent or no area.

    Example:
        >>> report = fsh.star_center(fsh.read_geometry("samples/gem.stl"))
        >>> report.exact, report.visible_area
        (True, 1.0)
    """
    arrays, _ = geometry_arrays(mesh)
    if not isinstance(arrays, MeshArrays):
        raise TypeError("a point cloud has no surface to see: star_center takes triangle meshes")
    if not isinstance(method, str):
        return star_report(arrays, method)
    surface = _StarTests(arrays)
    if method == "centroid":
        return surface.report(surface.cube.from_unit(surface.centroids()[0]), None)
    if method != "best":
        raise ValueError(f"method must be 'best', 'centroid' or a (3,) array, got {method!r}")
    return surface.best()


def visible_area(mesh: MeshArrays, center: Float64Array) -> float:
    """Return the fraction of a mesh's area that straight lines from ``center`` (3,) reach."""
    surface = _StarTests(mesh)
    return float(surface.visible(surface.cube.to_unit(point(center, "center"))[None], _SAMPLES)[0])


class _StarTests:
    """A mesh in the unit cube, with what the tests share: scene, face planes, area samples."""

    def __init__(self, mesh: MeshArrays) -> None:
        welded = weld(mesh)
        turned = oriented(welded)
        self.mesh = turned or welded
        self.cube = UnitCube.around(self.mesh.vertices)
        vertices = self.cube.to_unit(self.mesh.vertices)
        self.unit = MeshArrays(vertices, self.mesh.triangles)
        self.scene = UnitScene(vertices, self.mesh.triangles)
        self.planes = FacePlanes.of(vertices[self.mesh.triangles])
        if not np.isfinite(self.planes.offsets).any():
            raise GeometryError("the mesh has no area: all its triangles are degenerate")
        self.oriented = turned is not None
        self.closed = self.oriented and bool((EdgeTable(self.mesh.triangles).faces == 2).all())
        self._samples: dict[int, tuple[Float64Array, Float64Array]] = {}

    def visible(self, centers: Float64Array, count: int) -> Float64Array:
        """Return the fraction of ``count`` area samples that each centre (m, 3) sees."""
        if count not in self._samples:
            points, triangles = area_samples(self.unit, count, seed=_SEED)
            self._samples[count] = points, self.planes.of_triangles(triangles)
        points, planes = self._samples[count]
        rays = points - centers[:, None]  # reach their samples at distance 1
        distance, _ = self.scene.cast(
            np.repeat(centers, count, axis=0),
            rays.reshape(-1, 3),
        )
        seen = distance.reshape(len(centers), count) >= 1 - _REACHED
        if self.closed:  # then inside and outside differ, and a surface seen from behind is not seen from the centre
            seen &= centers @ planes[:, :3].T <= planes[:, 3]
        return np.asarray(seen.mean(axis=1))

    def report(self, center: Float64Array, kernel_radius: float | None) -> StarReport:
        """Return the report on a centre given in the coordinates of the mesh."""
        here = self.cube.to_unit(center)
        distance = self.planes.distance(here)
        inside = float(self.planes.area[distance > 0].sum() / self.planes.area.sum()) if self.oriented else 0.0
        clearance = float(distance.min())
        around = UnitCube.around(self.mesh.vertices, center=center)
        vertices = around.to_unit(self.mesh.vertices)
        near, far = UnitScene(vertices, self.mesh.triangles).radii(fibonacci_grid(_DIRECTIONS).directions)
        return StarReport(
            center=center,
            exact=self.closed and clearance > 0 and _covers_once(vertices[self.mesh.triangles]),
            inside_fraction=inside,
            visible_area=float(self.visible(here[None], _SAMPLES)[0]),
            missed=float(np.isnan(near).mean()),
            multiple=float((far - near > SAME_HIT).mean()),
            clearance=clearance * self.cube.scale if self.oriented else None,
            kernel_radius=kernel_radius,
        )

    def centroids(self) -> list[Float64Array]:
        """Return the centroid of the enclosed volume, if there is one, and that of the surface."""
        corners = self.unit.vertices[self.unit.triangles]
        surface = self.planes.area @ corners.mean(axis=1) / self.planes.area.sum()
        volume, solid = solid_volume(corners) if self.closed else (0.0, None)
        return [surface] if solid is None or volume <= 0 else [solid, surface]

    def best(self) -> StarReport:
        """Return the report on the kernel's centre, or on the point that sees most area."""
        radius, candidates = None, self.centroids()
        if self.closed:
            kernel, unit_radius = kernel_center(self.planes)
            radius = unit_radius * self.cube.scale
            if unit_radius > 0:
                report = self.report(self.cube.from_unit(kernel), radius)
                if report.exact:
                    return report
            candidates.append(kernel)
        candidates += list(self._interior())
        center = self._most_visible(np.array(candidates))
        return self.report(self.cube.from_unit(center), radius)

    def _interior(self) -> Float64Array:
        low, high = self.unit.vertices.min(axis=0), self.unit.vertices.max(axis=0)
        steps = (np.arange(_LATTICE) + 0.5) / _LATTICE
        lattice = low + (high - low) * np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        # A skew direction, so that rays do not run along faces and edges that are parallel to the axes.
        skew = np.broadcast_to(np.array([0.5257, 0.3217, 0.7875]), lattice.shape)
        return np.asarray(lattice[self.scene.count(lattice, skew) % 2 == 1])

    def _most_visible(self, candidates: Float64Array) -> Float64Array:
        coarse = self._score(candidates, _COARSE_SAMPLES)
        finalists = candidates[np.argsort(-coarse, kind="stable")[:_FINALISTS]]
        scores = self._score(finalists, _SAMPLES)
        best, score = finalists[scores.argmax()], float(scores.max())
        # Compass search: 26 neighbours at a step that halves when none is better.
        offsets = np.stack(np.meshgrid(*3 * [np.arange(-1, 2)], indexing="ij"), axis=-1).reshape(-1, 3)
        offsets = offsets[offsets.any(axis=1)] / np.linalg.norm(offsets[offsets.any(axis=1)], axis=1)[:, None]
        step = 0.5 / _LATTICE
        while step > 1e-3:
            around = best + step * offsets
            promising = around[np.argsort(-self._score(around, _COARSE_SAMPLES), kind="stable")[:_FINALISTS]]
            scores = self._score(promising, _SAMPLES)
            if scores.max() > score:
                best, score = promising[scores.argmax()], float(scores.max())
            else:
                step /= 2
        return np.asarray(best)

    def _score(self, centers: Float64Array, count: int) -> Float64Array:
        """Return the visible area times the fraction of directions that meet the surface times the room around.

        The second factor is 1 inside a closed surface; an open one is best seen from far off, where few directions meet
        it. The third keeps away from the surface itself, where radii would vary wildly. The area whose planes face a
        centre breaks ties.
        """
        visible = self.visible(centers, count)
        directions = fibonacci_grid(_COARSE_DIRECTIONS).directions
        distance, _ = self.scene.cast(
            np.repeat(centers, len(directions), axis=0), np.tile(directions, (len(centers), 1))
        )
        distance = distance.reshape(len(centers), -1)
        met = np.isfinite(distance).mean(axis=1)
        room = np.minimum(distance.min(axis=1) / _CLEARANCE, 1.0)
        planes = self._samples[count][1]
        facing = (centers @ planes[:, :3].T < planes[:, 3]).mean(axis=1) if self.oriented else 0.0
        return np.asarray(visible * met * room + 0.01 * facing)


def _covers_once(corners: Float64Array) -> bool:
    """Return whether the solid angles of triangles (t, 3, 3) about the origin sum to one sphere."""
    a, b, c = np.moveaxis(corners / np.linalg.norm(corners, axis=2)[..., None], 1, 0)
    # Van Oosterom and Strackee (1983)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = 1 + np.einsum("ij,ij->i", a, b) + np.einsum("ij,ij->i", b, c) + np.einsum("ij,ij->i", c, a)
    turns = float(np.arctan2(volume, rest).sum()) / (2 * np.pi)
    return abs(turns - 1) < 0.5
