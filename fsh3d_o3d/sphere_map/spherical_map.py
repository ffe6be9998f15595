"""The result of mapping a closed surface to the unit sphere."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import GeometryKind, MeshArrays, chosen_kind, open3d_mesh

__all__ = ["MapMethod", "SphericalMap"]

MapMethod = Literal["flow", "untangled", "embedding"]
"""What made a map valid: the flow alone, local untangling after it, or the coarse-to-fine embedding."""


@value
class SphericalMap:
    """A one-to-one map of a closed genus-0 surface to the unit sphere, triangle by triangle."""

    mesh: MeshArrays
    """The surface as it was mapped: equal vertices merged, unused ones removed, turned outwards."""
    positions: Float64Array
    """(n, 3) unit vectors, where each vertex of ``mesh`` lies on the sphere."""
    source_vertices: IntArray
    """(n,) the vertex of the input that each vertex of ``mesh`` was: ``attribute[source_vertices]`` carries over any
    attribute of the input's vertices. The first of those that were merged; read-only."""
    flipped: int
    """Number of spherical triangles that are not positively oriented; 0 for every map that is returned."""
    degree: int
    """How many times the triangles cover the sphere; 1 for every map that is returned."""
    distortion_mean: float
    """Mean over the area of the surface of the quasi-conformal ratio σ₁/σ₂ ≥ 1; 1 where angles are kept."""
    distortion_99: float
    """The ratio that 99 % of the area does not exceed."""
    area_distortion: float
    """Root mean square over the area of the surface of log(share of the sphere / share of the surface); 0 where areas
    are kept."""
    iterations: int
    """Steps of the mean-curvature flow."""
    balance_iterations: int
    """Steps of the optimisation after it, whether of area balance or, after a fallback, of conformality alone."""
    method: MapMethod
    """What made the map valid, before any balancing."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    def to_triangle_mesh(self, *, on_sphere: bool = False, kind: GeometryKind | None = None) -> Any:
        """Return ``mesh`` as an Open3D ``TriangleMesh``.

        Args:
            on_sphere: Put the vertices where they lie on the unit sphere: the map itself.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.
        """
        mesh = replace(self.mesh, vertices=self.positions, normals=None) if on_sphere else self.mesh
        return open3d_mesh(mesh, chosen_kind(kind, self.kind))
