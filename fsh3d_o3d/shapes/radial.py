"""Star-shaped surfaces as one function on the sphere: the distance from a centre."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError, GeometryReadError
from fsh3d_o3d.geometry import (
    GEOMETRY_KINDS,
    GeometryKind,
    MeshArrays,
    PointArrays,
    chosen_kind,
    fibonacci_triangulation,
    geometry_arrays,
    open3d_mesh,
    open3d_point_cloud,
    sphere_mesh,
)
from fsh3d_o3d.radial import Behaviour, cloud_center, fit_radial_cloud, sample_radial, star_center
from fsh3d_o3d.shapes import storage
from fsh3d_o3d.sphere import (
    SphericalGrid,
    SphericalHarmonicTransform,
    degree_energies,
    evaluate,
    evaluate_gradient,
    fibonacci_grid,
    filter_coefficients,
    grid_from_directions,
    grid_size,
    rotate_coefficients,
    truncate,
)

CenterName = Literal["auto", "best", "centroid"]
Triangulation = Literal["icosphere", "fibonacci"]

_FEWEST_POINTS = 10_242
_USUAL_POINTS = 400_000


@dataclass(frozen=True, eq=False)
class RadialShape:
    """A closed surface r(ω) = Σ c_lm Y_lm(ω) about a centre, as b² coefficients in the units of the input."""

    coefficients: Float64Array
    """(b²,) of the radial function; real orthonormal harmonics, index l² + l + m. Read-only."""
    center: Float64Array
    """(3,) where r is measured from. Read-only."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    def __post_init__(self) -> None:
        coefficients, _ = check.coefficients(self.coefficients)
        if coefficients.ndim != 1:
            raise ValueError(f"coefficients must have shape (b²,), got {coefficients.shape}")
        coefficients = np.array(coefficients, dtype=np.float64)
        center = check.point(self.center, "center")
        check.choice(self.kind, "kind", GEOMETRY_KINDS)
        for name, array in (("coefficients", coefficients), ("center", center)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def from_geometry(
        cls,
        geometry: Any,
        bandwidth: int = 64,
        center: object | CenterName | None = None,
        *,
        oversampling: float | None = None,
        behaviour: Behaviour = "error",
        cloud_method: Literal["least_squares", "resample"] = "least_squares",
        smoothness: float | None = None,
        threads: int | None = None,
    ) -> RadialShape:
        """Encode a mesh or point cloud as a radial function.

        A mesh is sampled by rays in the 4b²·``oversampling`` directions of a Fibonacci grid and transformed with
        analytic weights. A cloud is fitted robustly: noise is averaged, outliers are given up, holes are filled
        smoothly.

        Args:
            geometry: Open3D triangle mesh or point cloud, legacy or tensor (or ``MeshArrays``, ``PointArrays``).
            bandwidth: b; the shape has b² coefficients.
            center: (3,), or for meshes ``"centroid"`` (of the volume), ``"best"`` (the middle of the points that see
                the whole surface, or else the one that sees most), or ``"auto"``/None: the centroid where it sees
                all, else the best. For clouds a (3,), or None for a robust estimate.
            oversampling: For meshes, directions in units of 4b²; 1.5 if not given.
            behaviour: For meshes, what to do with directions that meet the surface more than once or never:
                ``"error"``, ``"outermost"`` or ``"innermost"``.
            cloud_method: For clouds, ``"least_squares"`` (fits the coefficients to the points) or ``"resample"``
                (robust local radii on the grid, then the transform).
            smoothness: For clouds, weight of the bending energy; chosen from the data if not given.
            threads: Number of threads, or None for all that the process may use. Does not change the result.

        Raises:
            NotStarShapedError: A mesh that rays from the centre meet several times or never; says how far from
                star-shaped it is and what would fit.
            CoverageError: A cloud that leaves too much of the sphere empty.
            GeometryError: Empty, not finite, or without extent.
            ValueError, TypeError: Another argument is out of range or of the wrong type.
        """
        b = check.bandwidth(bandwidth)
        arrays, kind = geometry_arrays(geometry)
        if isinstance(arrays, PointArrays):
            if isinstance(center, str) and center != "auto":
                raise ValueError(f'center must be a (3,) point or "auto" for point clouds, got {center!r}')
            middle = (
                cloud_center(arrays) if center is None or isinstance(center, str) else check.point(center, "center")
            )
            fit = fit_radial_cloud(arrays, b, middle, method=cloud_method, smoothness=smoothness, threads=threads)
            return cls(fit.coefficients, middle, kind)
        size = grid_size(b, oversampling)
        check.memory(600.0 * size + 2000.0 * b * b, f"a radial function of bandwidth {b} on {size} directions")
        grid = fibonacci_grid(size)
        middle = _mesh_center(arrays, center)
        radii = sample_radial(arrays, grid.directions, middle, behaviour=behaviour).radii
        transform = SphericalHarmonicTransform(b, grid=grid, threads=threads)
        return cls(np.asarray(transform.forward(radii), dtype=np.float64), middle, kind)

    @property
    def bandwidth(self) -> int:
        """b: degrees 0 … b − 1."""
        return int(np.sqrt(len(self.coefficients)) + 0.5)

    @property
    def volume(self) -> float:
        """The enclosed volume, ∫ r³/3 dω, exact for the band-limited function."""
        # r³ has degree 3(b − 1); a grid of bandwidth 1.5 b integrates it.
        transform = SphericalHarmonicTransform(max(1, -(-3 * self.bandwidth // 2)))
        scale = np.abs(self.coefficients).max(initial=0.0)
        if scale == 0:
            return 0.0
        radii = evaluate(self.coefficients / scale, transform.grid)
        return float(transform.weights @ radii**3 / 3 * scale**3)

    def radius(self, directions: object) -> Float64Array:
        """Return r at unit vectors (m, 3), in the units of the input, (m,)."""
        return np.asarray(evaluate(self.coefficients, directions), dtype=np.float64)

    def mesh_arrays(
        self, resolution: int | None = None, triangulation: Triangulation = "icosphere"
    ) -> tuple[MeshArrays, Float64Array]:
        """Return the surface as arrays: a closed, outward-oriented mesh of genus 0, and its vertex normals (v, 3).

        See ``to_triangle_mesh``.
        """
        check.choice(triangulation, "triangulation", ("icosphere", "fibonacci"))
        b = self.bandwidth
        usual = max(6 * b * b, min(24 * b * b, _USUAL_POINTS), _FEWEST_POINTS)
        points = usual if resolution is None else check.integer(resolution, "resolution", minimum=12, maximum=10**8)
        check.memory(600.0 * points, f"a mesh of {points} vertices")
        if triangulation == "fibonacci":
            directions, triangles = fibonacci_triangulation(fibonacci_grid(points).directions)
        else:
            directions, triangles = sphere_mesh(points)
        vertices, normals = self._surface(grid_from_directions(directions))
        return MeshArrays(vertices, triangles), normals

    def to_triangle_mesh(
        self,
        resolution: int | None = None,
        *,
        triangulation: Triangulation = "icosphere",
        kind: GeometryKind | None = None,
    ) -> Any:
        """Decode to an Open3D ``TriangleMesh`` with vertex normals from the analytic gradient.

        The mesh is closed, manifold, outward-oriented and of genus 0, with no degenerate triangle at the poles.

        Args:
            resolution: About how many vertices; 24b², within reason, if not given.
            triangulation: ``"icosphere"``: the smallest geodesic icosahedron with as many vertices, or ``"fibonacci"``:
                the Delaunay triangles of a Fibonacci grid of just as many.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.

        Raises:
            GeometryError: The radial function is not positive everywhere, as truncation of a spiky shape can make it.
        """
        mesh, normals = self.mesh_arrays(resolution, triangulation)
        return open3d_mesh(mesh, chosen_kind(kind, self.kind), normals=normals)

    def to_point_cloud(self, n: int | None = None, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``PointCloud`` of n points (6b² if not given) in Fibonacci directions, with normals.

        Raises:
            GeometryError: The radial function is not positive everywhere.
        """
        points, normals = self._surface(fibonacci_grid(6 * self.bandwidth**2 if n is None else n))
        return open3d_point_cloud(PointArrays(points, normals), chosen_kind(kind, self.kind))

    def compute_feature(self) -> Any:
        """Return the energies per degree as an Open3D ``Feature`` of shape (b, 1).

        They do not change when the input is rotated about the centre or moved, and scale with it.
        """
        feature = open3d().pipelines.registration.Feature()
        feature.data = degree_energies(self.coefficients)[:, None]
        return feature

    def truncated(self, bandwidth: int) -> RadialShape:
        """Return the shape of the degrees below ``bandwidth``: a coarser level of detail."""
        return replace(self, coefficients=np.asarray(truncate(self.coefficients, bandwidth), dtype=np.float64))

    def filtered(self, gain_per_degree: object) -> RadialShape:
        """Return the shape with each degree multiplied by a gain, (b,) or a function of the degrees.

        See ``heat_filter``, ``lanczos_filter``, ``ideal_filter``.
        """
        filtered = filter_coefficients(self.coefficients, gain_per_degree)
        return replace(self, coefficients=np.asarray(filtered, dtype=np.float64))

    def rotated(self, rotation: object) -> RadialShape:
        """Return the shape rotated about its centre by R (3, 3), exactly; see ``rotate_coefficients``.

        It decodes to what this one does with every point p at center + R (p − center).

        Raises:
            ValueError: R is not a rotation.
        """
        turned = rotate_coefficients(self.coefficients, rotation)
        return replace(self, coefficients=np.asarray(turned, dtype=np.float64))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the shape to an ``.npz`` of plain arrays; ``load_shape`` reads it back, equal to the last bit.

        Raises:
            ValueError: The name does not end in ``.npz``.
            OSError: The file cannot be written; what was there stays.
        """
        storage.write_arrays(
            path,
            type(self).__name__,
            {"coefficients": self.coefficients, "center": self.center, "geometry": np.array(self.kind)},
        )

    @classmethod
    def _from_arrays(cls, path: str | os.PathLike[str], arrays: dict[str, Any]) -> RadialShape:
        coefficients = storage.field(path, arrays, "coefficients", 1)
        storage.square_root(path, len(coefficients))
        center = storage.field(path, arrays, "center", 1)
        kind = str(arrays.get("geometry", "legacy"))
        if center.shape != (3,) or kind not in GEOMETRY_KINDS:
            raise GeometryReadError(f"{os.fspath(path)}: center or geometry is malformed")
        return cls(coefficients, center, "tensor" if kind == "tensor" else "legacy")

    def _surface(self, grid: SphericalGrid) -> tuple[Float64Array, Float64Array]:
        """Positions and outward unit normals in the directions of a grid."""
        radii = self.radius(grid)
        if radii.min() <= 0:
            raise GeometryError(
                f"the radial function is not positive in {100 * np.mean(radii <= 0):.2g} % of directions (smallest "
                f"{radii.min():.3g}, mean {radii.mean():.3g}): keep more degrees, or smooth with heat_filter"
            )
        normals = radii[:, None] * grid.directions - evaluate_gradient(self.coefficients, grid)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return self.center + radii[:, None] * grid.directions, normals


def _mesh_center(mesh: MeshArrays, center: object | CenterName | None) -> Float64Array:
    if center is None or (isinstance(center, str) and center == "auto"):
        report = star_center(mesh, "centroid")
        return report.center if report.exact else star_center(mesh, "best").center
    if isinstance(center, str):
        check.choice(center, "center", ("auto", "best", "centroid"))
        return star_center(mesh, "best" if center == "best" else "centroid").center
    return check.point(center, "center")
