"""The spherical harmonic descriptor over a conformal map."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.closing import prepare_closed
from fsh3d_o3d.geometry import MeshArrays, PointArrays, geometry_arrays, surface_of
from fsh3d_o3d.sphere import SphericalGrid, SphericalHarmonicTransform, checked_weights, degree_energies
from fsh3d_o3d.sphere_map import ConformalMapOption, conformal_map, locate

_RECIPE = 1  # raised whenever the same option gives other numbers
_FRAME_SAMPLES = 256  # of the area, a few that nothing uses: the moments of a mesh are exact without


@value(kw_only=True)
class CPSHDOption:
    """Options of the descriptor over a conformal map. Equal options compare equal. Checked when made.

    Example:
        >>> fsh.CPSHDOption().metric in ("l1", "l2")
        True
    """

    bandwidth: int = 32
    """b: degrees 0 … b − 1; degree 0 is the position and counts as 0."""
    form: Literal["axes", "pooled"] = "axes"
    """``"axes"``: energies of the coordinates along the three principal axes of the area, the longest first; data is
    (b, 3). ``"pooled"``: one energy a degree for all three together, as in the paper; data is (b, 1). Neither changes
    when the shape or the map is rotated."""
    grid: SphericalGrid | None = None
    """Directions in which the map is sampled; None: the Fibonacci grid of 6b² points."""
    weights: NDArray[np.float64] | None = None
    """(n,) quadrature weights of ``grid``, for example ``driscoll_healy_weights(b)`` with ``equiangular_grid(b)``;
    None: the analytic weights."""
    map: ConformalMapOption = dataclasses.field(default_factory=ConformalMapOption)
    """How the surface is mapped; ``ConformalMapOption(area_weight=0)`` is conformal, as in the paper."""
    repair: int | None = None
    """Cells along the longest side at which meshes that are not closed surfaces of genus 0 are made so
    (``prepare_closed``); None: they are refused."""
    metric: Literal["l1", "l2"] = "l1"
    """Norm of descriptor distances."""

    def __post_init__(self) -> None:
        check.integer(self.bandwidth, "bandwidth", minimum=2, maximum=check.MAXIMUM_BANDWIDTH)
        check.choice(self.form, "form", ("axes", "pooled"))
        check.choice(self.metric, "metric", ("l1", "l2"))
        if not isinstance(self.map, ConformalMapOption):
            raise TypeError(f"map must be a ConformalMapOption, got {type(self.map).__name__}")
        if self.repair is not None:
            check.integer(self.repair, "repair", minimum=8, maximum=1024)
        object.__setattr__(self, "weights", checked_weights(self.grid, self.weights))

    @property
    def feature_shape(self) -> tuple[int, int]:
        """Shape of ``Feature.data``."""
        return self.bandwidth, 3 if self.form == "axes" else 1

    @functools.cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all options and the version of the recipe: features are comparable where it is the same."""
        mapped = ", ".join(f"{field.name}={getattr(self.map, field.name)!r}" for field in dataclasses.fields(self.map))
        parts = [
            f"cpshd {_RECIPE}",
            f"{self.bandwidth} {self.form} {self.repair} {self.metric} ConformalMapOption({mapped})",
        ]
        parts.append("fibonacci" if self.grid is None else self.grid.fingerprint)
        parts.append("analytic" if self.weights is None else hashlib.sha256(self.weights.tobytes()).hexdigest())
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def compute_cpshd_feature(mesh: Any, option: CPSHDOption | None = None) -> Any:
    """Compute the spherical harmonic descriptor of a closed surface of genus 0 over its map to the sphere.

    The energies per degree of the positions x, y, z over the map, of unit norm together: invariant to moving, rotating,
    mirroring and scaling, and up to sampling to the triangulation. After Agus et al., WISH, 2020, with the map of
    ``conformal_map`` in place of their Willmore flow.

    Args:
        mesh: Triangle mesh, as ``from_any`` takes it.
        option: ``CPSHDOption()`` if not given.

    Returns:
        ``open3d.pipelines.registration.Feature``; its data is (d, 1), float64: one column, because it is of one shape.
        ``data.reshape(option.feature_shape)`` has a row for each degree.

    Raises:
        TypeError: Not a mesh.
        GeometryError: Not a closed surface of genus 0, where ``option.repair`` is None; no area.

    Example:
        >>> gem = fsh.read_geometry("samples/gem.stl")
        >>> feature = fsh.compute_cpshd_feature(gem)
        >>> feature.data.shape, fsh.CPSHDOption().feature_shape
        ((96, 1), (32, 3))
    """
    feature = open3d().pipelines.registration.Feature()
    feature.data = _energies(mesh, option).reshape(-1, 1)
    return feature


def cpshd_descriptor(mesh: Any, option: CPSHDOption | None = None) -> NDArray[np.float32]:
    """Compute ``compute_cpshd_feature`` as a vector (d,), row by row."""
    return _energies(mesh, option).astype(np.float32).ravel()


def _energies(geometry: Any, given: CPSHDOption | None) -> Float64Array:
    option = CPSHDOption() if given is None else given
    if not isinstance(option, CPSHDOption):
        raise TypeError(f"option must be a CPSHDOption, got {type(option).__name__}")
    arrays, _ = geometry_arrays(geometry)
    if isinstance(arrays, PointArrays):
        raise TypeError("the descriptor over a conformal map needs a triangle mesh, got a point cloud")
    if option.repair is not None:
        arrays = prepare_closed(arrays, cells_per_side=option.repair).mesh
    mapped = conformal_map(arrays, option.map)
    positions = _in_principal_axes(mapped.mesh)
    transform = _transform(option)
    triangle, share = locate(mapped.positions, mapped.mesh.triangles, transform.grid.directions)
    values = np.einsum("mk,mkc->cm", share, positions[mapped.mesh.triangles[triangle]])
    energies = np.asarray(degree_energies(transform.forward(values)), dtype=np.float64).T
    energies[0] = 0
    if option.form == "pooled":
        energies = np.linalg.norm(energies, axis=1, keepdims=True)
    return np.asarray(energies / np.linalg.norm(energies))


def _in_principal_axes(mesh: MeshArrays) -> Float64Array:
    """The vertices about the area centroid, in RMS radii, along the principal axes of the area, the longest first."""
    surface = surface_of(mesh, _FRAME_SAMPLES)
    axes = np.linalg.eigh(surface.covariance)[1][:, ::-1]
    return np.asarray((mesh.vertices - surface.centroid) / surface.rms_radius @ axes)


@functools.lru_cache(maxsize=4)
def _transform(option: CPSHDOption) -> SphericalHarmonicTransform:
    return SphericalHarmonicTransform(option.bandwidth, option.grid, option.weights)
