"""Spherical harmonic descriptors: geometry in, a rotation-invariant feature out.

A signature is a feature with the coefficients behind it, by which shapes can be compared once they are aligned.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors.cpshd import CPSHDOption, compute_cpshd_feature, cpshd_descriptor
from fsh3d_o3d.descriptors.shd_option import SHDOption
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import Surface, geometry_arrays, surface_of
from fsh3d_o3d.shells import ShellSampler
from fsh3d_o3d.sphere import (
    SphericalHarmonicTransform,
    energies,
    gram_powers,
    rotate_coefficients,
    single_threaded_blas,
)

__all__ = [
    "CPSHDOption",
    "SHDOption",
    "ShapeSignature",
    "compute_cpshd_feature",
    "compute_shd_feature",
    "compute_signature",
    "cpshd_descriptor",
    "descriptor_distances",
    "shd_descriptor",
]

_WEAKEST_FIELD = 0.05  # of the frame's first field; the normals of a flat sheet are zero but for rounding


def compute_shd_feature(geometry: Any, option: SHDOption | None = None) -> Any:
    """Compute the spherical harmonic descriptor of a mesh or a point cloud.

    The same shape gives the same feature up to sampling (``docs/features.md`` has figures) when it is moved, rotated,
    mirrored, scaled or triangulated otherwise. Meshes need not be closed, oriented or free of intersections.

    Args:
        geometry: Mesh or point cloud, as ``from_any`` takes it.
        option: ``SHDOption.best()`` if not given, like ``fsh3d describe`` and ``ShapeIndex``.

    Returns:
        ``open3d.pipelines.registration.Feature``; its data is (d, 1), float64: one column, because it is of one shape.
        ``data.reshape(option.feature_shape)`` has a row for each degree. Open3D takes columns for the features of
        points: ``correspondences_from_features`` matches whole shapes by such features, never points of one.

    Raises:
        TypeError: Not a geometry.
        GeometryError: Empty, not finite, without area or extent.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> feature = fsh.compute_shd_feature(mesh)
        >>> feature.data.shape, fsh.SHDOption.best().feature_shape
        ((3600, 1), (12, 300))
    """
    feature = open3d().pipelines.registration.Feature()
    feature.data = _described(geometry, option)[0].reshape(-1, 1)
    return feature


@value
class ShapeSignature:
    """What is kept of a shape to find it again: a feature, low degrees for alignment, and its frame."""

    feature: NDArray[np.float32]
    """(d,) the descriptor, as ``shd_descriptor`` gives it."""
    coefficients: NDArray[np.float32]
    """(R, b²) low-degree coefficients of the functions behind the feature, in the shape's principal axes, of unit norm
    in all."""
    centroid: Float64Array
    """(3,) area centroid, in the coordinates of the geometry."""
    rms_radius: float
    """Root mean square distance of the area from it, in the units of the geometry."""
    axes: Float64Array
    """(3, 3) rotation to the principal axes, the longest first: axes @ (point − centroid) / rms_radius is in the frame
    of the coefficients. The signs of two axes are arbitrary."""


def compute_signature(geometry: Any, option: SHDOption | None = None, *, bandwidth: int = 8) -> ShapeSignature:
    """Compute a shape's descriptor together with what ``signature_distances`` needs.

    Args:
        geometry: As for ``compute_shd_feature``.
        option: ``SHDOption.best()`` if not given.
        bandwidth: Degrees below this are kept for alignment; at most ``option.bandwidth``.

    Raises:
        TypeError: Not a geometry.
        GeometryError: As for ``compute_shd_feature``.

    Example:
        >>> signature = fsh.compute_signature(fsh.read_geometry("samples/gem.stl"))
        >>> signature.feature.shape, signature.axes.shape
        ((3600,), (3, 3))
    """
    option = _checked(SHDOption.best() if option is None else option)
    kept = check.integer(bandwidth, "bandwidth", minimum=2, maximum=option.bandwidth)
    feature, coefficients, surface = _described(geometry, option)
    axes = np.linalg.eigh(surface.covariance)[1].T[::-1].copy()
    axes[2] *= np.linalg.det(axes)
    low = rotate_coefficients(coefficients[:, : kept**2], axes, threads=1)
    norm = float(np.linalg.norm(low))
    return ShapeSignature(
        feature=feature.astype(np.float32).ravel(),
        coefficients=(low / (norm if norm > 0 else 1.0)).astype(np.float32),
        centroid=surface.centroid,
        rms_radius=surface.rms_radius,
        axes=axes,
    )


def shd_descriptor(geometry: Any, option: SHDOption | None = None) -> NDArray[np.float32]:
    """Compute ``compute_shd_feature`` as a vector (d,), row by row; see there. Does not need Open3D for arrays.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> fsh.shd_descriptor(mesh, fsh.SHDOption.best()).shape
        (3600,)
    """
    return _described(geometry, option)[0].astype(np.float32).ravel()


def descriptor_distances(first: object, second: object, option: SHDOption | CPSHDOption | None = None) -> Float64Array:
    """Return the distance of every descriptor of one set to every one of another: (m, d), (k, d) → (m, k).

    L1 or L2 as ``option.metric`` says; for unit L1 norm within [0, 2]. A single descriptor (d,) is a set of one.

    Raises:
        ValueError: Not descriptors of this option's length, or not finite.

    Example:
        >>> option = fsh.SHDOption.best()
        >>> names = ("gem.stl", "gem_rotated.stl", "horn.off")
        >>> gem, turned, horn = (fsh.shd_descriptor(fsh.read_geometry(f"samples/{name}"), option) for name in names)
        >>> print(fsh.descriptor_distances(gem, [turned, horn], option).round(1))
        [[0.  0.9]]
    """
    if not isinstance(option, CPSHDOption):
        option = _checked(option)
    length = option.feature_shape[0] * option.feature_shape[1]
    left, right = (_vectors(value, name, length) for value, name in ((first, "first"), (second, "second")))
    return np.asarray(cdist(left, right, "cityblock" if option.metric == "l1" else "euclidean"))


def _vectors(value: object, name: str, length: int) -> FloatArray:
    vectors = np.atleast_2d(check.values_on(value, name, length, "d"))
    if vectors.ndim != 2:
        raise ValueError(f"{name} must have shape (m, {length}) or ({length},), got {vectors.shape}")
    return vectors


def _described(geometry: Any, given: SHDOption | None) -> tuple[Float64Array, Float64Array, Surface]:
    """The feature, the coefficients (R, b²) it is made of, and the surface they were sampled from."""
    option = _checked(given)
    arrays, _ = geometry_arrays(geometry)
    plan = _plan(option)
    # One BLAS thread: its own split of products would change the last bits.
    with single_threaded_blas():
        surface = surface_of(arrays, option.samples)
        rows = [plan.coefficients(surface.whitened(power, option.flatness)) for power in option.frames]
        coefficients = _balanced(np.stack(rows))
        if option.invariant == "cross_shell":
            feature = gram_powers(coefficients, option.bandwidth, option.power, option.epsilon)
        else:
            feature = energies(coefficients, quadratic=option.covariance)
    if option.normalisation == "none":
        return feature, coefficients, surface
    norm = float(np.linalg.norm(feature.ravel(), 1 if option.normalisation == "l1" else 2))
    if norm == 0:
        raise GeometryError("the fields are zero on all shells: the shape lies outside of them")
    return feature / norm, coefficients, surface


def _balanced(coefficients: Float64Array) -> Float64Array:
    """All functions (R, b²) of frames and fields (frames, fields, rows, b²), each field of unit norm if several."""
    frames, fields, _, count = coefficients.shape
    if frames * fields > 1:
        norm = np.linalg.norm(coefficients, axis=(2, 3), keepdims=True)
        norm = np.maximum(norm, _WEAKEST_FIELD * norm[:, :1])
        coefficients = coefficients / np.where(norm > 0, norm, 1)
    return coefficients.reshape(-1, count)


class _Plan:
    """What all shapes share: shells, look-up tables, the transform."""

    def __init__(self, option: SHDOption) -> None:
        fields = option.shell_fields
        points = option.shells * (6 * option.bandwidth**2 if option.grid is None else len(option.grid))
        # Look-up table and its making, fields, node arrays.
        check.memory(400.0 * points + 8.0 * fields.count * points + 100.0 * option.voxels**3, "the shells of a feature")
        self._transform = SphericalHarmonicTransform(option.bandwidth, option.grid, option.weights)
        self._sampler = ShellSampler(fields, self._transform.grid.directions)
        self._rows = option.rows
        scale = {"none": np.ones(option.shells), "radius": fields.radii, "sqrt4pi": fields.radii * np.sqrt(4 * np.pi)}
        self._scale = scale[option.shell_scaling][:, None]

    def coefficients(self, surface: Surface) -> Float64Array:
        """(fields, rows, b²) coefficients of a surface."""
        values = self._sampler.sample(surface) * self._scale
        values = values.reshape(len(values), self._rows, -1, values.shape[2]).mean(axis=2)
        return np.asarray(self._transform.forward(values), dtype=np.float64)


@functools.lru_cache(maxsize=8)
def _plan(option: SHDOption) -> _Plan:
    return _Plan(option)


def _checked(option: SHDOption | None) -> SHDOption:
    if option is None:
        return SHDOption.best()
    if not isinstance(option, SHDOption):
        raise TypeError(f"option must be an SHDOption, got {type(option).__name__}")
    return option
