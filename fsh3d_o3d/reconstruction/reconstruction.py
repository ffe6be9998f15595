"""What a reconstruction is: a shape, which method made it, why, how far it is off, and what to know about it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import (
    BoolArray,
    GeometryKind,
    MeshArrays,
    SurfaceError,
    chosen_kind,
    open3d_mesh,
)
from fsh3d_o3d.shapes import Shape

Method = Literal["radial", "conformal", "shells"]
"""Which kind of shape."""

_SEEN, _UNSEEN = (0.65, 0.65, 0.65), (0.85, 0.35, 0.2)  # red, green and blue in [0, 1], a choice


@value
class Trial:
    """One way that was tried."""

    way: str
    """Such as ``"radial"``, ``"shells"`` or ``"conformal, carved"``."""
    rmse: float | None
    """RMSE in units of the original's diagonal, of a cloud over the nearest nine tenths of its points, since others may
    be outliers; None where the way led nowhere."""
    maximum: float | None
    """Largest distance, in the same units."""
    topology_kept: bool | None
    """Whether parts and handles are as many as the original's; None where the original has no closed surface, and for
    clouds."""
    seconds: float
    """How long it took."""
    failure: str
    """Why it led nowhere; empty where it did not."""


@value
class Reconstruction:
    """The shape that holds a geometry best, how it was chosen, and what it cost.

    Example:
        >>> result = fsh.reconstruct(fsh.read_geometry("samples/gem.stl"), bandwidth=16)
        >>> result.method, result.shape.bandwidth, result.warnings
        ('radial', 16, ())
        >>> result.to_triangle_mesh().is_watertight()
        True
    """

    shape: Shape
    """The shape: ``RadialShape``, ``ConformalShape`` or ``ShellShape``."""
    method: Method
    """Which of them."""
    way: str
    """The method and what was done before it, such as ``"conformal, carved"``."""
    reason: str
    """Why this method, in words."""
    error: SurfaceError
    """Between the original and ``mesh``, in the units of the original; of a cloud, from its points to the surface."""
    notes: tuple[str, ...]
    """What was done to the original, and what to know about the result."""
    warnings: tuple[str, ...]
    """What is worse than it should be, each with what would help; empty where nothing is."""
    mesh: MeshArrays
    """The surface that comes back: closed and manifold, the part that a scan did not see included."""
    normals: Float64Array
    """(v, 3) vertex normals of ``mesh``."""
    unseen: BoolArray | None
    """(v,) vertices of ``mesh`` where a scan saw nothing and the surface is a guess; None where all was seen."""
    trials: tuple[Trial, ...]
    """All ways that were tried, in order."""
    seconds: float
    """How long everything took."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    @property
    def coefficients(self) -> int:
        """How many numbers the shape consists of."""
        return int(self.shape.coefficients.size)

    def surface(self, *, unseen: bool = False) -> tuple[MeshArrays, Float64Array]:
        """Return the surface and its vertex normals as arrays; see ``to_triangle_mesh``.

        Example:
            >>> surface, normals = result.surface()
            >>> len(surface.vertices) == len(normals)
            True
        """
        if self.unseen is None or unseen:
            return self.mesh, self.normals
        kept = self.mesh.triangles[~self.unseen[self.mesh.triangles].any(axis=1)]
        compact, source = replace(self.mesh, triangles=kept).compact()
        return compact, self.normals[source]

    def to_triangle_mesh(self, *, unseen: bool = False, kind: GeometryKind | None = None) -> Any:
        """Return the surface as an Open3D ``TriangleMesh`` with vertex normals.

        It is closed, unless the original is a scan that saw one side only: then it is open, and ends where the scan
        does.

        Args:
            unseen: Close it, with the guess in place of what was not seen; that part is coloured.
            kind: ``"legacy"`` or ``"tensor"``; that of the input if not given.

        Example:
            >>> result.to_triangle_mesh().has_vertex_normals()
            True
        """
        mesh, normals = self.surface(unseen=unseen)
        if self.unseen is not None and unseen:
            mesh = replace(mesh, colors=np.where(self.unseen[:, None], _UNSEEN, _SEEN))
        return open3d_mesh(mesh, chosen_kind(kind, self.kind), normals=normals)

    def summary(self) -> str:
        """Return which method, why, and what it cost, in a line.

        Example:
            >>> print(result.summary().split(":")[0])
            radial
        """
        relative = self.error.relative()
        return (
            f"{self.way}: {self.reason}; RMSE {100 * relative.rmse:.2g} %, at most {100 * relative.maximum:.2g} % "
            f"of the diagonal, {self.coefficients} coefficients, {self.seconds:.1f} s"
        )
