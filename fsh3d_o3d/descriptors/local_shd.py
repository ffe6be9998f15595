"""A feature for every point, from spherical harmonics of its surroundings: where FPFH stands in Open3D's pipelines."""

from __future__ import annotations

from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors.key_points import CELLS, local_harmonics, typical_size
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, geometry_arrays, surface_of, triangle_areas
from fsh3d_o3d.sphere import single_threaded_blas

_RADIUS = 1.0  # typical sizes (median distance from the mean); of halves and of views 60° apart the best of 0.5 … 1.2
_SAMPLES_A_CELL = 6.0  # points on a mesh for each cell of its area, as dense as scans mostly are
_FEWEST_SAMPLES, _MOST_SAMPLES = 4096, 2_000_000  # on a mesh; more would need more than 200 MB
_BYTES_A_NUMBER = 24.0  # coefficients in single precision, features in double, and a copy while they are made


@value(kw_only=True)
class LocalSHDOption:
    """Options of ``compute_local_shd_feature``; checked when made.

    Example:
        >>> half, whole = fsh.read_geometry("samples/stone_cloud.xyzn"), fsh.read_geometry("samples/stone_degree8.ply")
        >>> option = fsh.LocalSHDOption.common(half, whole)  # features of both can be compared
        >>> option.radius > 0, option.length
        (True, 63)
    """

    radius: float | None = None
    """Of the surroundings that are described, in units of the geometry; what is compared needs the same. None: the
    median distance of the points from their mean. Only by the density around them do points from one to
    three radii off have an influence, and farther ones none."""
    bandwidth: int = 6
    """b: degrees 0 … b − 1 of the harmonics."""
    shells: int = 3
    """S: windows of the distance from the point, up to the radius."""

    def __post_init__(self) -> None:
        if self.radius is not None:
            check.number(self.radius, "radius", minimum=0, exclusive=True)
        check.integer(self.bandwidth, "bandwidth", minimum=2, maximum=12)
        check.integer(self.shells, "shells", minimum=1, maximum=16)

    @property
    def length(self) -> int:
        """Numbers in the feature of a point, S b (b + 1)/2."""
        return self.shells * self.bandwidth * (self.bandwidth + 1) // 2

    @classmethod
    def common(cls, *geometries: Any, bandwidth: int = 6, shells: int = 3) -> LocalSHDOption:
        """Return the option for geometries that are to be compared: its radius fits the smallest of them.

        Raises:
            ValueError: No geometry.
            TypeError, GeometryError: As for ``compute_local_shd_feature``.
        """
        if not geometries:
            raise ValueError("common needs the geometries that are to be compared, got none")
        radius = min(_default_radius(_given(geometry)[1]) for geometry in geometries)
        return cls(radius=radius, bandwidth=bandwidth, shells=shells)


def compute_local_shd_feature(geometry: Any, option: LocalSHDOption | None = None, keypoints: object = None) -> Any:
    """Compute features of points that are the same in every pose, from harmonics of what lies around them.

    Takes the place of ``compute_fpfh_feature`` before ``registration_ransac_based_on_feature_matching``,
    ``registration_fgr_based_on_feature_matching`` and ``correspondences_from_features``. Normals are neither needed nor
    looked at, and a surface may be inside out. Around each point, the area in S windows of the distance is expanded in
    spherical harmonics in a frame along the local normal; the feature is the magnitude of each degree, order and
    window, √(c(s, l, m)² + c(s, l, −m)²), which neither turning about the normal nor its sign changes, of unit norm.

    Args:
        geometry: Mesh or point cloud, as ``from_any`` takes it. Points of Open3D's clouds may be NaN, as organised ones
            are where nothing was seen.
        option: ``LocalSHDOption()`` if not given. To compare two geometries give both the same radius:
            ``LocalSHDOption.common(source, target)``.
        keypoints: The points to describe: indices (k,) into the cloud's points or the mesh's vertices, or positions
            (k, 3) near the surface. None: all points, or all vertices.

    Returns:
        ``open3d.pipelines.registration.Feature``; its data is (d, k), float64, one column a point. Columns of points
        that are NaN or have fewer than eight others around them are zero.

    Raises:
        TypeError: Not a geometry, or key points are neither integers nor positions.
        ValueError: Key points of another shape, out of range, or not finite.
        GeometryError: Empty, no finite point, or without extent where the radius is not given.
        MemoryEstimateError: The features would not fit.

    Example:
        >>> cloud = fsh.read_geometry("samples/stone_cloud.xyzn")
        >>> feature = fsh.compute_local_shd_feature(cloud)
        >>> feature.data.shape
        (63, 2000)
        >>> fsh.compute_local_shd_feature(cloud, keypoints=[3, 5, 8]).data.shape
        (63, 3)
    """
    option = LocalSHDOption() if option is None else option
    if not isinstance(option, LocalSHDOption):
        raise TypeError(f"option must be a LocalSHDOption, got {type(option).__name__}")
    given, surface = _given(geometry)
    places = given if keypoints is None else _places(keypoints, given)
    size = _BYTES_A_NUMBER * (option.length + option.shells * option.bandwidth**2)
    check.memory(size * len(places), f"describing {len(places)} points at once")
    radius = _default_radius(surface) if option.radius is None else option.radius
    points = _sampled(surface, radius / CELLS) if isinstance(surface, MeshArrays) else surface
    seen = np.isfinite(places).all(axis=1)
    data = np.zeros((option.length, len(places)))
    with single_threaded_blas():
        found = local_harmonics(
            points, radius, keypoints=places[seen], bandwidth=option.bandwidth, shells=option.shells
        )
    data[:, seen] = found.feature.T * found.described
    feature = open3d().pipelines.registration.Feature()
    feature.data = data
    return feature


def _given(geometry: Any) -> tuple[Float64Array, MeshArrays | Float64Array]:
    """The points or vertices as given, NaN and all; and the mesh, or the points that are finite."""
    o3d = open3d()
    if isinstance(geometry, o3d.geometry.PointCloud):
        points = np.array(geometry.points)
    elif isinstance(geometry, o3d.t.geometry.PointCloud) and "positions" in geometry.point:
        points = geometry.point.positions.cpu().numpy().astype(np.float64)
    else:
        arrays, _ = geometry_arrays(geometry)
        if isinstance(arrays, MeshArrays):
            return arrays.vertices, arrays
        points = arrays.points
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        raise GeometryError(f"none of the {len(points)} points is finite" if len(points) else "the cloud has no points")
    return points, finite


def _places(keypoints: object, points: Float64Array) -> Float64Array:
    array = np.asarray(check.unmasked(keypoints, "keypoints"))
    if array.ndim == 2:
        return check.vectors(array, "keypoints")
    if array.dtype.kind not in "iu":
        raise TypeError(f"keypoints must be integers (k,) or positions (k, 3), got dtype {array.dtype}")
    if array.ndim != 1 or not array.size:
        raise ValueError(f"keypoints must be integers (k,) or positions (k, 3) with k >= 1, got shape {array.shape}")
    if array.min() < 0 or array.max() >= len(points):
        raise ValueError(
            f"keypoints must be indices 0 … {len(points) - 1} of points, got {array.min()} … {array.max()}"
        )
    chosen: IntArray = array.astype(np.int64)
    return points[chosen]


def _default_radius(surface: MeshArrays | Float64Array) -> float:
    if isinstance(surface, MeshArrays):
        samples = surface_of(surface, _FEWEST_SAMPLES)
        size = samples.rms_radius * typical_size(samples.points)
    else:
        size = typical_size(surface)
    if not size > 0:
        raise GeometryError("all points lie in one place; give a radius in the option")
    return _RADIUS * size


def _sampled(mesh: MeshArrays, spacing: float) -> Float64Array:
    """Points (n, 3) on a mesh, several a cell of this spacing."""
    corners = mesh.vertices[mesh.triangles]
    area = float(triangle_areas(corners / spacing).sum())
    count = int(np.clip(_SAMPLES_A_CELL * area, _FEWEST_SAMPLES, _MOST_SAMPLES))
    surface = surface_of(mesh, count)
    return np.asarray(surface.points * surface.rms_radius + surface.centroid)
