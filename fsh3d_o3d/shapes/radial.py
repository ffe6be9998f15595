"""Star-shaped surfaces as one function on the sphere: the distance from a centre."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import (
    GEOMETRY_KINDS,
    GeometryKind,
    MeshArrays,
    PointArrays,
    chosen_kind,
    geometry_arrays,
    open3d_mesh,
    open3d_point_cloud,
    values_near,
    with_point_values,
    with_values,
)
from fsh3d_o3d.radial import Behaviour, cloud_center, fit_radial_cloud, sample_radial, star_center
from fsh3d_o3d.shapes import attributes as _attributes
from fsh3d_o3d.shapes.decoding import Triangulation, decoding_sphere, usual_resolution
from fsh3d_o3d.shapes.shape import HarmonicShape, feature_of
from fsh3d_o3d.sphere import (
    SphericalGrid,
    SphericalHarmonicTransform,
    degree_energies,
    evaluate,
    evaluate_gradient,
    fibonacci_grid,
    grid_from_directions,
    grid_size,
)

CenterName = Literal["auto", "best", "centroid"]


@value
class RadialShape(HarmonicShape):
    """A closed surface r(ω) = Σ c_lm Y_lm(ω) about a centre, as b² coefficients in the units of the input.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> shape = fsh.RadialShape.from_geometry(mesh, bandwidth=16)
        >>> shape.bandwidth, shape.coefficients.shape
        (16, (256,))
        >>> print(f"{shape.volume:.2f}, {mesh.get_volume():.2f}")
        1.93, 1.93
        >>> shape.to_triangle_mesh(1000)
        TriangleMesh with 1002 points and 2000 triangles.
    """

    coefficients: Float64Array
    """(b²,) of the radial function; real orthonormal harmonics, index l² + l + m. Read-only."""
    center: Float64Array
    """(3,) where r is measured from. Read-only."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """Coefficients (b²,) or (k, b²) of what belongs to the surface by name; ``"colors"`` (3, b²) are colours in [0, 1].
    Read-only."""

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
        object.__setattr__(
            self, "attributes", _attributes.checked_coefficients(self.attributes, self.coefficients.shape)
        )

    @classmethod
    def from_geometry(
        cls,
        geometry: Any,
        bandwidth: int = 64,
        center: object | CenterName | None = None,
        *,
        attributes: Mapping[str, Any] | None = None,
        carry: bool = True,
        oversampling: float | None = None,
        behaviour: Behaviour = "error",
        smoothness: float | None = None,
        threads: int | None = None,
    ) -> RadialShape:
        """Encode a mesh or point cloud as a radial function.

        A mesh is sampled by rays in the 4b²·``oversampling`` directions of a Fibonacci grid and transformed with
        analytic weights. A cloud is fitted robustly: noise is averaged, outliers are given up, holes are filled
        smoothly. Colours and all other attributes of vertices and points become functions on the sphere, too.

        Args:
            geometry: Mesh or point cloud, as ``from_any`` takes it.
            bandwidth: b; the shape has b² coefficients.
            center: (3,), or for meshes ``"centroid"`` (of the volume), ``"best"`` (the middle of the points that see
                the whole surface, or else the one that sees most), or ``"auto"``/None: the centroid where it sees
                all, else the best. For clouds a (3,), or None for a robust estimate.
            attributes: Further values (v,) or (v, k) at the vertices or points by name, to be carried along.
            carry: Whether the geometry's own colours, texture coordinates and attributes are carried along.
            oversampling: For meshes, directions in units of 4b²; 1.5 if not given.
            behaviour: For meshes, what to do with directions that meet the surface more than once or never:
                ``"error"``, ``"outermost"`` or ``"innermost"``.
            smoothness: For clouds, weight of the bending energy; chosen from the data if not given.
            threads: Number of threads, or None for all that the process may use. Does not change the result.

        Raises:
            NotStarShapedError: A mesh that rays from the centre meet several times or never; says how far from
                star-shaped it is and what would fit.
            CoverageError: A cloud that leaves too much of the sphere empty.
            GeometryError: Empty, not finite, or without extent.
            ValueError, TypeError: Another argument is out of range or of the wrong type.

        Example:
            >>> horn = fsh.read_geometry("samples/horn.off")  # rays from its centre meet it several times, or never
            >>> fsh.RadialShape.from_geometry(horn, bandwidth=8, center="centroid")
            Traceback (most recent call last):
                ...
            fsh3d_o3d.errors.NotStarShapedError: ...
            >>> cloud = fsh.read_geometry("samples/stone_cloud.xyzn")
            >>> print(f"{fsh.RadialShape.from_geometry(cloud, bandwidth=9).volume:.1f}")
            4.3
        """
        b = check.bandwidth(bandwidth)
        arrays, kind = geometry_arrays(geometry)
        source = _attributes.carried_values(arrays, attributes, carry=carry)
        if isinstance(arrays, PointArrays):
            if isinstance(center, str) and center != "auto":
                raise ValueError(f'center must be a (3,) point or "auto" for point clouds, got {center!r}')
            middle = (
                cloud_center(arrays) if center is None or isinstance(center, str) else check.point(center, "center")
            )
            fit = fit_radial_cloud(arrays, b, middle, smoothness=smoothness, threads=threads)
            sphere = SphericalHarmonicTransform(b, threads=threads)
            radii = np.asarray(evaluate(fit.coefficients, sphere.grid), dtype=np.float64)
            return cls(fit.coefficients, middle, kind, _carried(source, sphere, radii, middle))
        size = grid_size(b, oversampling)
        check.memory(600.0 * size + 2000.0 * b * b, f"a radial function of bandwidth {b} on {size} directions")
        grid = fibonacci_grid(size)
        middle = _mesh_center(arrays, center)
        radii = sample_radial(arrays, grid.directions, middle, behaviour=behaviour).radii
        transform = SphericalHarmonicTransform(b, grid=grid, threads=threads)
        coefficients = np.asarray(transform.forward(radii), dtype=np.float64)
        return cls(coefficients, middle, kind, _carried(source, transform, radii, middle))

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

    def evaluate(self, directions: object, *, threads: int | None = None) -> Float64Array:
        """Return r at unit vectors (m, 3), in the units of the input, (m,).

        Example:
            >>> shape.evaluate([[0, 0, 1], [0, 0, -1]]).round(1)  # from the centre up and down
            array([0.4, 0.8])
        """
        return np.asarray(evaluate(self.coefficients, directions, threads=threads), dtype=np.float64)

    def attribute(self, name: str, directions: object) -> Float64Array:
        """Return an attribute at unit vectors (m, 3): (m,) or (m, k) as it was given. Colours are clipped to [0, 1].

        Raises:
            ValueError: There is no such attribute.

        Example:
            >>> ball = fsh.read_geometry("samples/coloured_ball.pcd")
            >>> colored = fsh.RadialShape.from_geometry(ball, bandwidth=8)
            >>> colored.attribute("colors", [[0, 0, 1], [0, 0, -1]]).shape
            (2, 3)
        """
        values = evaluate(_attributes.attribute_of(self.attributes, name), directions)
        return _attributes.shown(name, np.asarray(values, dtype=np.float64).T)

    def mesh_arrays(
        self, resolution: int | None = None, *, triangulation: Triangulation = "icosphere"
    ) -> tuple[MeshArrays, Float64Array]:
        """Return the surface as arrays: a closed, outward-oriented mesh of genus 0, and its vertex normals (v, 3).

        The mesh has them too, and the colours and other attributes that the shape carries.

        See ``to_triangle_mesh``.

        Example:
            >>> arrays, normals = shape.mesh_arrays(1000)
            >>> arrays.vertices.shape, arrays.triangles.shape, normals.shape
            ((1002, 3), (2000, 3), (1002, 3))
        """
        points = usual_resolution(self.bandwidth) if resolution is None else resolution
        directions, triangles = decoding_sphere(points, triangulation)
        sphere = grid_from_directions(directions)
        vertices, normals = self._surface(sphere)
        return with_values(MeshArrays(vertices, triangles), self._values(sphere), normals=normals), normals

    def to_triangle_mesh(
        self,
        resolution: int | None = None,
        *,
        triangulation: Triangulation = "icosphere",
        kind: GeometryKind | None = None,
    ) -> Any:
        """Decode to an Open3D ``TriangleMesh`` with vertex normals from the analytic gradient.

        The mesh is closed, manifold, outward-oriented and of genus 0, with no degenerate triangle at the poles. It has
        the colours and texture coordinates that the shape carries, and a tensor mesh all other attributes too.

        Args:
            resolution: About how many vertices; 24b², within reason, if not given.
            triangulation: ``"icosphere"``: the smallest geodesic icosahedron with as many vertices, or ``"fibonacci"``:
                the Delaunay triangles of a Fibonacci grid of just as many.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.

        Raises:
            GeometryError: The radial function is not positive everywhere, as truncation of a spiky shape can make it.

        Example:
            >>> shape.to_triangle_mesh(1000, triangulation="fibonacci")
            TriangleMesh with 1000 points and 1996 triangles.
            >>> shape.to_triangle_mesh(1000).is_watertight()
            True
        """
        mesh, _ = self.mesh_arrays(resolution, triangulation=triangulation)
        return open3d_mesh(mesh, chosen_kind(kind, self.kind))

    def to_point_cloud(self, n: int = 10_000, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``PointCloud`` of n points in Fibonacci directions, with normals and attributes.

        Raises:
            GeometryError: The radial function is not positive everywhere.

        Example:
            >>> shape.to_point_cloud(500)
            PointCloud with 500 points.
        """
        sphere = fibonacci_grid(n)
        points, normals = self._surface(sphere)
        return open3d_point_cloud(
            with_point_values(points, normals, self._values(sphere)), chosen_kind(kind, self.kind)
        )

    def compute_feature(self) -> Any:
        """Return the energies per degree as an Open3D ``Feature`` of shape (b, 1).

        They do not change when the input is rotated about the centre or moved, and scale with it.

        Example:
            >>> shape.compute_feature().data.shape
            (16, 1)
        """
        return feature_of(degree_energies(self.coefficients)[:, None])

    def _values(self, sphere: SphericalGrid) -> dict[str, Float64Array]:
        return {name: self.attribute(name, sphere) for name in self.attributes}

    def _surface(self, grid: SphericalGrid) -> tuple[Float64Array, Float64Array]:
        """Positions and outward unit normals in the directions of a grid."""
        radii = self.evaluate(grid)
        if radii.min() <= 0:
            raise GeometryError(
                f"the radial function is not positive in {100 * np.mean(radii <= 0):.2g} % of directions (smallest "
                f"{radii.min():.3g}, mean {radii.mean():.3g}): keep more degrees, or smooth with heat_filter"
            )
        normals = radii[:, None] * grid.directions - evaluate_gradient(self.coefficients, grid)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return self.center + radii[:, None] * grid.directions, normals


def _carried(
    source: MeshArrays | PointArrays, transform: SphericalHarmonicTransform, radii: Float64Array, center: Float64Array
) -> dict[str, Float64Array]:
    """Return the coefficients of what the source has where r(ω)ω is closest to it."""
    directions = transform.grid.directions
    values = values_near(source, center + radii[:, None] * directions)
    return {name: np.asarray(transform.forward(array.T), dtype=np.float64) for name, array in values.items()}


def _mesh_center(mesh: MeshArrays, center: object | CenterName | None) -> Float64Array:
    if center is None or (isinstance(center, str) and center == "auto"):
        report = star_center(mesh, "centroid")
        return report.center if report.exact else star_center(mesh, "best").center
    if isinstance(center, str):
        check.choice(center, "center", ("auto", "best", "centroid"))
        return star_center(mesh, "best" if center == "best" else "centroid").center
    return check.point(center, "center")
