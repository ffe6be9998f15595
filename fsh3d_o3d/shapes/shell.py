"""Solids of any topology as a field on concentric spheres, each a function on the sphere."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._progress import progress_bar
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import (
    GEOMETRY_KINDS,
    GeometryKind,
    MeshArrays,
    area_samples,
    chosen_kind,
    geometry_arrays,
    open3d_mesh,
    open3d_point_cloud,
    values_near,
    with_point_values,
    with_values,
)
from fsh3d_o3d.shapes import attributes as _attributes
from fsh3d_o3d.shapes.ball import BallFunction
from fsh3d_o3d.shapes.cube import ShellVolume, cube_points, cube_resolution
from fsh3d_o3d.shapes.shape import HarmonicShape, feature_of
from fsh3d_o3d.shells import FIELDS, FieldName, volume_field, without_specks, zero_surface
from fsh3d_o3d.sphere import (
    SphericalHarmonicTransform,
    degree_energies,
    fibonacci_grid,
    grid_size,
)

_FEWEST_SHELLS, _MOST_SHELLS = 4, 4096  # the spline needs three nodes; the upper one only catches slips
_MARGIN = 0.05  # of empty space beyond the surface, in units of its farthest distance; a choice


@value
class ShellShape(HarmonicShape):
    """A field f(r, ω) = Σ f_lm(r) Y_lm(ω) in a ball, as b² coefficients on each of S concentric spheres.

    Example:
        >>> knot = fsh.read_geometry("samples/trefoil_knot.ply")
        >>> shape = fsh.ShellShape.from_geometry(knot, bandwidth=12, shells=16, field="signed_distance")
        >>> shape.coefficients.shape
        (16, 144)
        >>> again = shape.to_triangle_mesh(32)
        >>> again.is_watertight(), again.euler_poincare_characteristic()  # 0: a torus, like the knot
        (True, 0)
    """

    coefficients: Float64Array
    """(S, b²), one row a shell; real orthonormal harmonics, index l² + l + m. Read-only."""
    radii: Float64Array
    """(S,) of the shells in units of ``scale``: h, 2h, … Sh. Read-only."""
    field: FieldName
    """``"signed_distance"``, ``"occupancy"`` or ``"gaussian_distance"``."""
    center: Float64Array
    """(3,) centre of the shells, in the units of the input. Read-only."""
    scale: float
    """Length that ``radii``, ``width`` and signed distances are in units of, in the units of the input."""
    width: float
    """w of the field (see ``volume_field``), in units of ``scale``."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""
    attributes: Mapping[str, Float64Array] = dataclasses.field(default_factory=dict)
    """Coefficients (S, b²) or (k, S, b²) of what belongs to the surface by name, continued off it by its closest point;
    ``"colors"`` (3, S, b²) are colours in [0, 1]. Read-only."""

    def __post_init__(self) -> None:
        coefficients, _ = check.coefficients(self.coefficients)
        if coefficients.ndim != 2 or len(coefficients) < _FEWEST_SHELLS:
            raise ValueError(
                f"coefficients must have shape (S, b²) with S >= {_FEWEST_SHELLS}, got {coefficients.shape}"
            )
        radii = check.values_on(self.radii, "radii", len(coefficients), "S")
        even = np.arange(1, len(coefficients) + 1) * (float(radii.ravel()[-1]) / len(coefficients))
        if radii.ndim != 1 or radii[-1] <= 0 or np.abs(radii - even).max() > 1e-9 * radii[-1]:
            raise ValueError("radii must have shape (S,) and be h, 2h, … Sh for some h > 0")
        check.choice(self.field, "field", FIELDS)
        check.choice(self.kind, "kind", GEOMETRY_KINDS)
        object.__setattr__(self, "scale", check.number(self.scale, "scale", minimum=0, exclusive=True))
        if self.width != np.inf:
            object.__setattr__(self, "width", check.number(self.width, "width", minimum=0, exclusive=True))
        center = check.point(self.center, "center")
        arrays: dict[str, FloatArray] = {"coefficients": coefficients, "radii": radii, "center": center}
        for name, array in arrays.items():
            own = np.array(array, dtype=np.float64)
            own.setflags(write=False)
            object.__setattr__(self, name, own)
        object.__setattr__(
            self, "attributes", _attributes.checked_coefficients(self.attributes, self.coefficients.shape)
        )

    @classmethod
    def from_geometry(
        cls,
        geometry: Any,
        bandwidth: int = 16,
        shells: int = 32,
        field: FieldName = "gaussian_distance",
        *,
        center: object | None = None,
        width: float | None = None,
        attributes: Mapping[str, Any] | None = None,
        carry: bool = True,
        oversampling: float | None = None,
        threads: int | None = None,
        progress: bool = False,
    ) -> ShellShape:
        """Encode a mesh of any quality or a point cloud as a field on shells.

        The field is sampled exactly in the 4b²·``oversampling`` directions of a Fibonacci grid on shells from the
        centre to a little beyond the farthest point, and each shell is transformed with analytic weights. For
        reconstruction use ``field="signed_distance"``. Colours and all other attributes of vertices and points become
        fields, too: everywhere that of the closest point of the surface.

        Args:
            geometry: Mesh or point cloud, as ``from_any`` takes it.
            bandwidth: b; each shell has b² coefficients. Details finer than about πr/b at radius r are lost.
            shells: S, at least 4. Details finer than about two S-ths of the radius are lost.
            field: ``"gaussian_distance"``, ``"occupancy"`` or ``"signed_distance"``; see ``volume_field``.
            center: (3,) centre of the shells; the centroid of the surface's area if not given.
            width: w of the field in units of the farthest distance from the centre. If not given 0.1 for distances
                and 0.02 for occupancy, but no less than what the shells resolve. ``math.inf`` keeps
                the signed distance as it is.
            attributes: Further values (v,) or (v, k) at the vertices or points by name, to be carried along.
            carry: Whether the geometry's own colours, texture coordinates and attributes are carried along.
            oversampling: Directions in units of 4b²; 1.5 if not given.
            threads: Number of threads, or None for all that the process may use. Does not change the result.
            progress: Show a bar, on a terminal or in a notebook.

        Raises:
            GeometryError: Empty, not finite, without extent or area; a cloud without normals or a surface that
                encloses nothing where the field needs an inside.
            MemoryEstimateError: The samples would not fit in memory.
            ValueError, TypeError: Another argument is out of range or of the wrong type.

        Example:
            >>> shape = fsh.ShellShape.from_geometry(knot, bandwidth=8, shells=12)  # needs no inside
            >>> shape.field, shape.coefficients.shape
            ('gaussian_distance', (12, 64))
        """
        b = check.bandwidth(bandwidth)
        count = check.integer(shells, "shells", minimum=_FEWEST_SHELLS, maximum=_MOST_SHELLS)
        check.choice(field, "field", FIELDS)
        size = grid_size(b, oversampling)
        # Per sample: position, distance, corners of the closest triangle, and the transform's own copy.
        check.memory(160.0 * size * count + 2000.0 * b * b, f"{count} shells of bandwidth {b} on {size} directions")
        if width is None:
            width = max(0.02, 1.0 / count) if field == "occupancy" else max(0.1, 2.0 / count)
        arrays, kind = geometry_arrays(geometry)
        colored = _attributes.carried_values(arrays, attributes, carry=carry)
        source = volume_field(arrays, field, center=center, width=width)
        # Room for at least a shell beyond the surface, and for the iso-surface of the Gaussian, w away from it.
        margin = max(_MARGIN, 1.5 / count) + (1.25 * source.width if field == "gaussian_distance" else 0.0)
        radii = np.arange(1.0, count + 1) * ((1 + margin) / count)
        grid = fibonacci_grid(size)
        # Out along each direction, so that neighbours share their side of the surface.
        places = grid.directions[:, None] * radii[:, None]
        with progress_bar(1.0, wanted=progress, desc="sampling") as bar:
            samples = source.sample(places, threads=threads, progress=lambda share: bar.update(share - bar.n)).T
        transform = SphericalHarmonicTransform(b, grid=grid, threads=threads)
        coefficients = np.asarray(transform.forward(samples), dtype=np.float64)
        values = values_near(colored, places.reshape(-1, 3) * source.scale + source.center)
        carried = {
            name: np.asarray(transform.forward(array.reshape(size, count, *array.shape[1:]).T), dtype=np.float64)
            for name, array in values.items()
        }
        return cls(coefficients, radii, field, source.center, source.scale, source.width, kind, carried)

    @property
    def level(self) -> float:
        """The field's value on the surface: 0 for distances, ½ for occupancy, exp(−½) (w away) for the Gaussian."""
        return {"signed_distance": 0.0, "occupancy": 0.5, "gaussian_distance": float(np.exp(-0.5))}[self.field]

    def evaluate(self, points: object, *, threads: int | None = None) -> Float64Array:
        """Return the field at points (n, 3) in the coordinates of the input, (n,).

        Signed distances are in units of ``scale``. Beyond the last shell the field is constant along each ray.

        Example:
            >>> on_surface = np.asarray(knot.vertices)[:4]
            >>> bool((shape.evaluate(on_surface) > shape.evaluate(on_surface + 0.3)).all())
            True
        """
        return self._ball()(self._local(points), threads=threads)

    def attribute(self, name: str, points: object) -> Float64Array:
        """Return an attribute at points (n, 3) in the coordinates of the input: (n,) or (n, k) as it was given.

        Colours are clipped to [0, 1].

        Raises:
            ValueError: There is no such attribute.

        Example:
            >>> heights = np.asarray(knot.vertices)[:, 2]
            >>> tall = fsh.ShellShape.from_geometry(knot, bandwidth=8, shells=12, attributes={"height": heights})
            >>> tall.attribute("height", on_surface).shape
            (4,)
        """
        return self._attribute(name, self._local(points))

    def to_volume(self, points_per_side: int | None = None, *, threads: int | None = None) -> ShellVolume:
        """Return the field on the cubic grid of ``points_per_side``³ points around the outermost shell.

        Args:
            points_per_side: Along each edge, at least 8; twice the shells or four times the bandwidth, whichever is
                more, between 64 and 256, if not given.
            threads: Number of threads, or None for all that the process may use. Does not change the result.

        Raises:
            MemoryEstimateError: The grid would not fit in memory.

        Example:
            >>> volume = shape.to_volume(24)
            >>> volume.values.shape, volume.origin.shape
            ((24, 24, 24), (3,))
        """
        n = cube_resolution(points_per_side, self.bandwidth, len(self.radii))
        reach = float(self.radii[-1])
        values = self._ball()(cube_points(n, reach), threads=threads).reshape(n, n, n)
        origin = self.center - reach * self.scale
        return ShellVolume(values, origin, 2 * reach * self.scale / (n - 1))

    def mesh_arrays(
        self,
        points_per_side: int | None = None,
        *,
        level: float | None = None,
        smallest: float = 0.0,
        threads: int | None = None,
    ) -> tuple[MeshArrays, Float64Array]:
        """Return the iso-surface as arrays: a closed, outward-oriented mesh, and its vertex normals (v, 3).

        The mesh has them too, and the colours and other attributes that the shape carries.

        See ``to_triangle_mesh``.

        Example:
            >>> arrays, normals = shape.mesh_arrays(24)
            >>> len(arrays.vertices) == len(normals)
            True
        """
        height = self.level if level is None else check.number(level, "level")
        share = check.number(smallest, "smallest", minimum=0, maximum=1)
        n = cube_resolution(points_per_side, self.bandwidth, len(self.radii))
        reach = float(self.radii[-1])
        points = cube_points(n, reach)
        sign = 1.0 if self.field == "signed_distance" else -1.0
        outside = sign * (self._ball()(points, threads=threads) - height)
        # Beyond the last shell there is nothing: the solid's intersection with the ball.
        outside = np.maximum(outside, np.linalg.norm(points, axis=1) - reach)
        mesh, normals = zero_surface(outside.reshape(n, n, n))
        if share > 0:
            mesh, normals = without_specks(mesh, normals, share)
        local = mesh.vertices * (2 * reach / (n - 1)) - reach
        surface = MeshArrays(local * self.scale + self.center, mesh.triangles)
        return with_values(surface, self._values(local), normals=normals), normals

    def to_triangle_mesh(
        self,
        points_per_side: int | None = None,
        *,
        level: float | None = None,
        smallest: float = 0.0,
        kind: GeometryKind | None = None,
        threads: int | None = None,
    ) -> Any:
        """Decode to an Open3D ``TriangleMesh``: the iso-surface of the field, of any topology.

        The mesh is closed, manifold and outward-oriented, with vertex normals from the field's gradient, the colours
        and texture coordinates that the shape carries, and, a tensor mesh, all other attributes too. A Gaussian of
        the distance has no inside; its surface is that of everything within ``width`` of the input.

        Args:
            points_per_side: Grid points along an edge of the cube around the shells; see ``to_volume``.
            level: Another value of the field than ``self.level``.
            smallest: Drop components with less than this share of the whole area; 0 keeps all.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.
            threads: Number of threads, or None for all that the process may use. Does not change the result.

        Raises:
            GeometryError: The field does not cross the level at this resolution.
            MemoryEstimateError: The grid would not fit in memory.

        Example:
            >>> shape.to_triangle_mesh(32, smallest=0.05).is_watertight()  # without crumbs
            True
        """
        mesh, _ = self.mesh_arrays(points_per_side, level=level, smallest=smallest, threads=threads)
        return open3d_mesh(mesh, chosen_kind(kind, self.kind))

    def to_point_cloud(self, n: int = 10_000, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``PointCloud`` of n points spread evenly over the iso-surface, with normals, attributes.

        Raises:
            GeometryError: The field does not cross its level.

        Example:
            >>> shape.to_point_cloud(500)
            PointCloud with 500 points.
        """
        count = check.integer(n, "n", minimum=1, maximum=10**8)
        mesh, normals = self.mesh_arrays()
        points, triangle = area_samples(mesh, count)
        facing = normals[mesh.triangles[triangle]].sum(axis=1)
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        values = self._values(self._local(points))
        return open3d_point_cloud(with_point_values(points, facing, values), chosen_kind(kind, self.kind))

    def compute_feature(self) -> Any:
        """Return the energies per degree and shell as an Open3D ``Feature`` of shape (b·S, 1), degree after degree.

        ``data.reshape(b, S)`` has a row for each degree. They do not change when the input is rotated about the centre,
        moved or scaled.

        Example:
            >>> shape.compute_feature().data.shape
            (96, 1)
        """
        return feature_of(degree_energies(self.coefficients).T)

    def _ball(self, coefficients: Float64Array | None = None) -> BallFunction:
        rows = self.coefficients if coefficients is None else coefficients
        return BallFunction(rows, float(self.radii[-1]) / len(self.radii))

    def _local(self, points: object) -> Float64Array:
        """Points (n, 3) in the frame of the shells, in units of ``scale``."""
        return np.asarray(check.vectors(points, "points") / self.scale - self.center / self.scale)

    def _attribute(self, name: str, local: Float64Array) -> Float64Array:
        coefficients = _attributes.attribute_of(self.attributes, name)
        if coefficients.ndim == 2:
            return self._ball(coefficients)(local)
        return _attributes.shown(name, np.stack([self._ball(rows)(local) for rows in coefficients], axis=1))

    def _values(self, local: Float64Array) -> dict[str, Float64Array]:
        return {name: self._attribute(name, local) for name in self.attributes}
