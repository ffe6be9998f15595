"""What all shapes have in common: the protocol they follow, and what they share of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import GeometryKind, MeshArrays
from fsh3d_o3d.shapes import storage
from fsh3d_o3d.shapes.attributes import attributes_as_arrays
from fsh3d_o3d.sphere import filter_coefficients, rotate_coefficients, truncate

if TYPE_CHECKING:
    from typing import Self  # Python 3.10 does not have it yet


@runtime_checkable
class Shape(Protocol):
    """What can be done with any shape: ``RadialShape``, ``ShellShape`` and ``ConformalShape`` follow it.

    Each has options of its own besides; how fine a mesh is (``to_triangle_mesh``) each counts in its own way.
    """

    @property
    def coefficients(self) -> Float64Array:
        """(…, b²) of real orthonormal harmonics, index l² + l + m."""

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Coefficients of what belongs to the surface, such as ``"colors"``, by name: as many for each function."""

    @property
    def center(self) -> Float64Array:
        """(3,) what ``rotated`` turns about, in the units of the input."""

    @property
    def kind(self) -> GeometryKind:
        """Which Open3D objects it becomes unless told otherwise: those it came from."""

    @property
    def bandwidth(self) -> int:
        """b: degrees 0 … b − 1."""

    @classmethod
    def from_geometry(
        cls,
        geometry: Any,
        bandwidth: int = ...,
        *,
        attributes: Mapping[str, Any] | None = None,
        carry: bool = True,
        oversampling: float | None = None,
        threads: int | None = None,
    ) -> Self:
        """Encode geometry, as ``from_any`` takes it, with what belongs to its vertices unless ``carry`` is False.

        The default bandwidth is one that suits the kind of shape.
        """

    def evaluate(self, where: object, /, *, threads: int | None = None) -> Float64Array:
        """Return the function that the coefficients stand for, at directions or, of a field, at points (m, 3)."""

    def attribute(self, name: str, where: object, /) -> Float64Array:
        """Return what belongs to the surface at directions or, of a field, at points (m, 3)."""

    def mesh_arrays(self, size: int | None = None, /) -> tuple[MeshArrays, Float64Array]:
        """Return the surface as arrays and its vertex normals (v, 3)."""

    def to_triangle_mesh(self, size: int | None = None, /, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``TriangleMesh``."""

    def to_point_cloud(self, n: int = 10_000, *, kind: GeometryKind | None = None) -> Any:
        """Decode to an Open3D ``PointCloud`` of n points, with normals, colours and other attributes."""

    def compute_feature(self) -> Any:
        """Return energies per degree as an Open3D ``Feature`` of shape (d, 1)."""

    def truncated(self, bandwidth: int) -> Self:
        """Return the shape of the degrees below ``bandwidth``."""

    def filtered(self, gain_per_degree: object) -> Self:
        """Return the shape with each degree multiplied by a gain."""

    def rotated(self, rotation: object) -> Self:
        """Return the shape rotated about its centre."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the shape to an ``.npz`` that ``load_shape`` reads."""


@value
class HarmonicShape:
    """Coefficients, and what is the same for all shapes that consist of some."""

    coefficients: Float64Array

    @property
    def bandwidth(self) -> int:
        """b: degrees 0 … b − 1."""
        return int(np.sqrt(self.coefficients.shape[-1]) + 0.5)

    def truncated(self, bandwidth: int) -> Self:
        """Return the shape of the degrees below ``bandwidth``: a coarser level of detail.

        Example:
            >>> shape.truncated(4).bandwidth
            4
        """
        return self._changed(lambda coefficients: truncate(coefficients, bandwidth))

    def filtered(self, gain_per_degree: object) -> Self:
        """Return the shape with each degree multiplied by a gain, (b,) or a function of the degrees.

        See ``heat_filter``, ``lanczos_filter``, ``ideal_filter``.

        Example:
            >>> smooth = shape.filtered(fsh.heat_filter(shape.bandwidth, 0.01))
            >>> smooth.coefficients.shape == shape.coefficients.shape
            True
        """
        return self._changed(lambda coefficients: filter_coefficients(coefficients, gain_per_degree))

    def rotated(self, rotation: object) -> Self:
        """Return the shape rotated about its centre by R (3, 3), exactly; see ``rotate_coefficients``.

        It decodes to what this one does with every point p at center + R (p − center).

        Raises:
            ValueError: R is not a rotation.

        Example:
            >>> turned = shape.rotated([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
            >>> np.allclose(turned.compute_feature().data, shape.compute_feature().data)
            True
        """
        return self._changed(lambda coefficients: rotate_coefficients(coefficients, rotation))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the shape to an ``.npz`` of plain arrays; ``load_shape`` reads it back, equal to the last bit.

        Raises:
            ValueError: The name does not end in ``.npz``.
            OSError: The file cannot be written; what was there stays.

        Example:
            >>> shape.save("shape.npz")
            >>> bool((fsh.load_shape("shape.npz").coefficients == shape.coefficients).all())
            True
        """
        values = {part.name: getattr(self, part.name) for part in fields(self)}
        attributes = attributes_as_arrays(values.pop("attributes"), axes=2 if "radii" in values else 1)
        arrays = {storage.STORED_NAMES.get(name, name): np.array(value) for name, value in values.items()}
        storage.write_arrays(path, type(self).__name__, {**arrays, **attributes})

    def _changed(self, change: Callable[[Float64Array], FloatArray], **others: Any) -> Self:
        attributes: Mapping[str, Float64Array] = vars(self)["attributes"]  # a field of each shape, behind its own
        carried = {name: np.asarray(change(array), dtype=np.float64) for name, array in attributes.items()}
        others["attributes"] = carried
        return replace(self, coefficients=np.asarray(change(self.coefficients), dtype=np.float64), **others)


def feature_of(energies: FloatArray) -> Any:
    """Return energies, of any number of axes, as an Open3D ``Feature`` of one column: it is of one shape."""
    feature = open3d().pipelines.registration.Feature()
    feature.data = np.ascontiguousarray(energies).reshape(-1, 1)
    return feature
