"""Closed surfaces of genus 0 as three functions on the sphere: position over a conformal map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import (
    GEOMETRY_KINDS,
    GeometryKind,
    MeshArrays,
    PointArrays,
    area_samples,
    chosen_kind,
    geometry_arrays,
    open3d_mesh,
    open3d_point_cloud,
    with_point_values,
    with_values,
)
from fsh3d_o3d.shapes import attributes as _attributes
from fsh3d_o3d.shapes import decoding as _decoding
from fsh3d_o3d.shapes.decoding import Triangulation
from fsh3d_o3d.shapes.map_sampling import checked_size, transform_map
from fsh3d_o3d.shapes.shape import HarmonicShape, feature_of
from fsh3d_o3d.sphere import SphericalGrid, degree_energies, filter_coefficients, grid_from_directions
from fsh3d_o3d.sphere_map import ConformalMapOption, SphericalMap, conformal_map


@value
class ConformalShape(HarmonicShape):
    """A closed surface of genus 0 as its position x(ω) = Σ c_lm Y_lm(ω) over a map onto the sphere, star-shaped or not.

    The paper's second parameterisation, after Agus et al., WISH, 2020; here over the map of ``conformal_map``.

    Example:
        >>> horn = fsh.read_geometry("samples/horn.off")  # no point sees the whole surface
        >>> shape = fsh.ConformalShape.from_geometry(horn, bandwidth=12)
        >>> shape.coefficients.shape
        (3, 144)
        >>> shape.to_triangle_mesh(1000)
        TriangleMesh with 1002 points and 2000 triangles.
    """

    coefficients: Float64Array
    """(3, b²) of x, y and z in the units of the input; real orthonormal harmonics, index l² + l + m. Read-only."""
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """Coefficients (b²,) or (k, b²) of further functions on the surface by name; ``"colors"`` (3, b²) are colours in
    [0, 1]. Read-only."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    def __post_init__(self) -> None:
        coefficients, b = check.coefficients(self.coefficients)
        if coefficients.shape != (3, b * b):
            raise ValueError(f"coefficients must have shape (3, b²), got {coefficients.shape}")
        check.choice(self.kind, "kind", GEOMETRY_KINDS)
        own = np.array(coefficients, dtype=np.float64)
        own.setflags(write=False)
        object.__setattr__(self, "coefficients", own)
        object.__setattr__(self, "attributes", _attributes.checked_coefficients(self.attributes, (b * b,)))

    @classmethod
    def from_geometry(
        cls,
        geometry: Any,
        bandwidth: int = 64,
        *,
        option: ConformalMapOption | None = None,
        attributes: Mapping[str, Any] | None = None,
        carry: bool = True,
        oversampling: float | None = None,
        threads: int | None = None,
    ) -> ConformalShape:
        """Encode a closed mesh of genus 0: map it onto the sphere, sample x, y, z there, transform.

        Args:
            geometry: Triangle mesh, as ``from_any`` takes it; see ``prepare_closed`` for those that are not closed.
            bandwidth: b; the shape has 3b² coefficients.
            option: Of the map; those that reconstruct best if not given.
            attributes: Further values (v,) or (v, k) at the vertices of the mesh by name, to be carried along.
            carry: Whether the mesh's own colours, texture coordinates and attributes are carried along.
            oversampling: Fibonacci directions in units of 4b²; 1.5 if not given. More change errors by a few
                hundredths at most, in either direction.
            threads: Number of threads, or None for all that the process may use. Does not change the result.

        Raises:
            GeometryError: Not a closed manifold of genus 0 in one piece; says what it is and what would help.
            ValueError, TypeError: Another argument is out of range, misshapen or of the wrong type.

        Example:
            >>> star = fsh.read_geometry("samples/spiky_star.glb")
            >>> heights = np.asarray(star.vertices)[:, 2]
            >>> shape = fsh.ConformalShape.from_geometry(star, bandwidth=8, attributes={"height": heights})
            >>> shape.bandwidth, list(shape.attributes)
            (8, ['height'])
        """
        b = check.bandwidth(bandwidth)
        checked_size(b, oversampling)
        mesh, kind = geometry_arrays(geometry)
        if isinstance(mesh, PointArrays):
            raise TypeError("a conformal shape is made of a triangle mesh, got a point cloud")
        colored = _attributes.carried_values(mesh, attributes, carry=carry)
        return cls.from_map(conformal_map(colored, option), b, oversampling=oversampling, threads=threads, kind=kind)

    @classmethod
    def from_map(
        cls,
        surface: SphericalMap,
        bandwidth: int = 64,
        *,
        attributes: Mapping[str, Any] | None = None,
        carry: bool = True,
        oversampling: float | None = None,
        threads: int | None = None,
        kind: GeometryKind = "legacy",
    ) -> ConformalShape:
        """Encode a surface that is mapped already; arguments as for ``from_geometry``.

        Args:
            surface: The map; any number of shapes can be made of it.
            bandwidth: b.
            attributes: Further values (v,) or (v, k) at the vertices of ``surface.mesh`` by name.
            carry: Whether the mesh's own colours, texture coordinates and attributes are carried along.
            oversampling: Fibonacci directions in units of 4b².
            threads: Number of threads.
            kind: Which Open3D objects the shape becomes.

        Example:
            >>> surface = fsh.conformal_map(star)  # once for several bandwidths
            >>> [fsh.ConformalShape.from_map(surface, bandwidth=b).coefficients.shape for b in (4, 8)]
            [(3, 16), (3, 64)]
        """
        b = check.bandwidth(bandwidth)
        size = checked_size(b, oversampling)
        colored = _attributes.carried_values(surface.mesh, attributes, carry=carry)
        assert isinstance(colored, MeshArrays)
        return cls(*transform_map(surface, colored, b, size, threads), kind)

    @property
    def center(self) -> Float64Array:
        """(3,) mean position over the sphere of the map: what the coefficients of degree 0 say."""
        return _decoding.mean_position(self.coefficients)

    @property
    def volume(self) -> float:
        """The enclosed volume, exact for the band-limited surface; parts turned inside out count as negative."""
        return _decoding.volume_side(self.coefficients) ** 3

    def evaluate(self, directions: object, *, threads: int | None = None) -> Float64Array:
        """Return positions (m, 3) at unit vectors (m, 3) on the sphere of the map, in the units of the input.

        Example:
            >>> directions = fsh.fibonacci_grid(100).directions
            >>> positions = shape.evaluate(directions)
            >>> positions.shape
            (100, 3)
        """
        return _decoding.values_at(self.coefficients, directions, threads)

    def attribute(self, name: str, directions: object) -> Float64Array:
        """Return an attribute at unit vectors (m, 3): (m,) or (m, k) as it was given. Colours are clipped to [0, 1].

        Raises:
            ValueError: There is no such attribute.

        Example:
            >>> np.allclose(shape.attribute("height", directions), positions[:, 2])
            True
        """
        return _attributes.shown(name, _decoding.values_at(_attributes.attribute_of(self.attributes, name), directions))

    def mesh_arrays(
        self, resolution: int | None = None, *, triangulation: Triangulation = "icosphere"
    ) -> tuple[MeshArrays, Float64Array]:
        """Return the surface as arrays: a closed mesh of genus 0, and its vertex normals (v, 3).

        The mesh has them too, and the colours and other attributes that the shape carries.

        See ``to_triangle_mesh``.

        Example:
            >>> arrays, normals = shape.mesh_arrays(500)
            >>> arrays.vertices.shape, normals.shape
            ((642, 3), (642, 3))
        """
        sphere, mesh = self._decoded(resolution, triangulation)
        normals = self._normals(sphere)
        return with_values(mesh, self._values(sphere), normals=normals), normals

    def to_triangle_mesh(
        self,
        resolution: int | None = None,
        *,
        triangulation: Triangulation = "icosphere",
        kind: GeometryKind | None = None,
    ) -> Any:
        """Decode to an Open3D ``TriangleMesh`` with vertex normals from the analytic gradient.

        The mesh is closed, manifold, oriented as the input and of genus 0. It has the colours and texture coordinates
        that the shape carries, and a tensor mesh all other attributes too.

        Args:
            resolution: About how many vertices; 24b², within reason, if not given.
            triangulation: Of the sphere: ``"icosphere"``, the smallest geodesic icosahedron with as many vertices, or
                ``"fibonacci"``, the Delaunay triangles of a Fibonacci grid of just as many.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.

        Example:
            >>> shape.to_triangle_mesh(500, triangulation="fibonacci")
            TriangleMesh with 500 points and 996 triangles.
        """
        mesh, _ = self.mesh_arrays(resolution, triangulation=triangulation)
        return open3d_mesh(mesh, chosen_kind(kind, self.kind))

    def level_of_detail(
        self, bandwidths: Sequence[int] | None = None, *, kind: GeometryKind | None = None
    ) -> dict[int, Any]:
        """Return Open3D meshes of the shape truncated to several bandwidths, by bandwidth.

        Args:
            bandwidths: None above the shape's own, each for a mesh of about 24b² vertices; 4, 8, 16, … if not given.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.

        Example:
            >>> list(shape.level_of_detail((2, 4, 8)))
            [2, 4, 8]
        """
        if bandwidths is None:
            bandwidths = [2**k for k in range(2, 13) if 2**k <= self.bandwidth] or [self.bandwidth]
        return {b: self.truncated(b).to_triangle_mesh(_decoding.level_resolution(b), kind=kind) for b in bandwidths}

    def to_point_cloud(self, n: int = 10_000, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``PointCloud`` of n points spread evenly over the surface, with normals, attributes.

        Example:
            >>> shape.to_point_cloud(500)
            PointCloud with 500 points.
        """
        count = check.integer(n, "n", minimum=1, maximum=10**8)
        sphere, mesh = self._decoded(None, "icosphere")
        points, triangle = area_samples(mesh, count)
        inner = _decoding.interpolation(mesh, points, triangle)
        normals = _decoding.unit_rows(inner @ self._normals(sphere))
        values = {name: np.asarray(inner @ array) for name, array in self._values(sphere).items()}
        return open3d_point_cloud(with_point_values(points, normals, values), chosen_kind(kind, self.kind))

    def compute_feature(self) -> Any:
        """Return the energies per degree, pooled over x, y and z, as an Open3D ``Feature`` of shape (b, 1).

        They do not change when the input is rotated or moved, nor when its map is rotated, and scale with it. Degree 0
        is the position and counts as 0.

        Example:
            >>> shape.compute_feature().data.shape
            (8, 1)
        """
        energies = np.hypot.reduce(degree_energies(self.coefficients), axis=0)
        energies[0] = 0
        return feature_of(energies[:, None])

    def filtered(self, gain_per_degree: object, *, keep_volume: bool = True) -> ConformalShape:
        """Return the shape with each degree multiplied by a gain, (b,) or a function of degree (``heat_filter``).

        Damping high degrees smooths, and shrinks, since all degrees but 0 hold a part of the size. ``keep_volume``
        therefore scales the result about its centre to the volume before, if either encloses any: smoothed as much as
        one likes, it tends to an ellipsoid and not to a point. Attributes are multiplied by the gains alone.

        Example:
            >>> smooth = shape.filtered(fsh.heat_filter(8, 0.05))
            >>> np.allclose(smooth.volume, shape.volume)
            True
        """
        smooth = self._changed(lambda coefficients: filter_coefficients(coefficients, gain_per_degree))
        if not keep_volume:
            return smooth
        before, after = (_decoding.volume_side(shape.coefficients) for shape in (self, smooth))
        if before <= 0 or after <= 0:
            return smooth
        return replace(smooth, coefficients=_decoding.scaled(smooth.coefficients, before / after))

    def rotated(self, rotation: object) -> ConformalShape:
        """Return the shape rotated about its centre by R (3, 3): every point p at center + R (p − center).

        Raises:
            ValueError: R is not a rotation.

        Example:
            >>> turned = shape.rotated([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
            >>> np.allclose(turned.volume, shape.volume)
            True
        """
        turned = check.rotation(rotation) @ self.coefficients
        turned[:, 0] = self.coefficients[:, 0]
        return replace(self, coefficients=turned)

    def _values(self, sphere: SphericalGrid) -> dict[str, Float64Array]:
        return {name: self.attribute(name, sphere) for name in self.attributes}

    def _decoded(self, resolution: int | None, triangulation: Triangulation) -> tuple[SphericalGrid, MeshArrays]:
        points = _decoding.usual_resolution(self.bandwidth) if resolution is None else resolution
        directions, triangles = _decoding.decoding_sphere(points, triangulation)
        sphere = grid_from_directions(directions)
        return sphere, MeshArrays(self.evaluate(sphere), triangles)

    def _normals(self, sphere: SphericalGrid) -> Float64Array:
        return _decoding.unit_normals(self.coefficients, sphere)
