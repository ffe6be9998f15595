"""Global alignment of meshes and point clouds: any rotation, any position, any scale, no first guess."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, Surface, geometry_arrays
from fsh3d_o3d.registration.search import Alignment, Ambiguity, align
from fsh3d_o3d.registration.surface import plain_surface, resolved_surface
from fsh3d_o3d.sphere import single_threaded_blas

__all__ = [
    "SphericalRegistrationCandidate",
    "SphericalRegistrationOption",
    "SphericalRegistrationResult",
    "registration_spherical",
]

_WHOLE = 0.8  # share of the surfaces in touch; where it is less, they are also aligned by their plain area


@value(kw_only=True)
class SphericalRegistrationOption:
    """Options of ``registration_spherical``; checked when made.

    Example:
        >>> source, target = fsh.read_geometry("samples/gem_rotated.stl"), fsh.read_geometry("samples/gem.stl")
        >>> rigid = fsh.SphericalRegistrationOption(with_scaling=False)  # both in the same units
        >>> print(f"{fsh.registration_spherical(source, target, rigid).scale:.3f}")
        1.000
    """

    with_scaling: bool = True
    """Whether the source is also scaled; False: both are in the same units, and the result is rigid."""
    reflections: bool = False
    """Whether the source may also be mirrored, where that fits clearly better than turning it."""
    polish: bool = True
    """Whether the answer is brought closer by an iteration over closest points (ICP) of both surfaces."""
    max_correspondence_distance: float | None = None
    """Farthest that points count as corresponding in fitness and inlier RMSE, in units of the target. None: a tenth of
    the target's RMS radius, or twice the usual spacing of its points if that is more. Does not change the answer."""
    candidates: int = 6
    """Rotations that are compared: maxima of the correlation, best first."""
    bandwidth: int = 12
    """Degrees 0 … bandwidth − 1 of the functions that are correlated."""
    samples: int = 4096
    """Points on a mesh that stand for its area; of a cloud with more points as many are looked at."""

    def __post_init__(self) -> None:
        for name in ("with_scaling", "reflections", "polish"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name} must be True or False, got {getattr(self, name)!r}")
        if self.max_correspondence_distance is not None:
            check.number(self.max_correspondence_distance, "max_correspondence_distance", minimum=0, exclusive=True)
        check.integer(self.candidates, "candidates", minimum=1, maximum=60)
        check.integer(self.bandwidth, "bandwidth", minimum=4, maximum=32)
        check.integer(self.samples, "samples", minimum=256, maximum=10**6)


@value
class SphericalRegistrationCandidate:
    """Another alignment of the two, which was not chosen."""

    transformation: Float64Array
    """(4, 4) from source to target."""
    correlation: float
    """Of the coefficients, in [−1, 1]; as that of the result."""
    fitness: float
    """As that of the result, on a few hundred samples."""
    inlier_rmse: float
    """As that of the result, on a few hundred samples."""


@value
class SphericalRegistrationResult:
    """How the source lies on the target; Open3D's names, and what this method knows beyond.

    Arrays are the caller's own and may be written to, because Open3D's vectors do not take read-only ones.
    """

    transformation: Float64Array
    """(4, 4) similarity that maps the source onto the target, x ↦ scale · rotation · x + translation."""
    fitness: float
    """Share of ``source_points`` with a point of the target within the ``max_correspondence_distance``."""
    inlier_rmse: float
    """Root mean square distance of those, in units of the target; 0 if there are none."""
    correspondence_set: NDArray[np.int32]
    """(c, 2) indices into ``source_points`` and ``target_points`` of those and the nearest to each."""
    correlation: float
    """Of the coefficients at the maximum that led to the answer, in [−1, 1]; 0 where a shape is round."""
    confidence: float
    """In [0, 1]: how far the answer can be trusted. Low where little overlaps, where surfaces stay apart, and where
    another rotation fits as well (see ``ambiguity``)."""
    ambiguity: Ambiguity
    """``"discrete"``: some other rotation fits about as well, as for two-fold symmetry; ``"continuous"``: turning a
    little about some axis changes little, as for vases and balls. Then the rotation is one of several."""
    scale: float
    """Of the transformation."""
    reflected: bool
    """Whether it mirrors; its determinant is negative then."""
    max_correspondence_distance: float
    """What was used, in units of the target."""
    source_points: Float64Array
    """(n, 3) the cloud's points, or samples of the mesh's area, as given."""
    target_points: Float64Array
    """(m, 3) the same of the target."""
    candidates: tuple[SphericalRegistrationCandidate, ...]
    """The runners-up, best first."""


def registration_spherical(
    source: Any, target: Any, option: SphericalRegistrationOption | None = None
) -> SphericalRegistrationResult:
    """Find the similarity that maps one shape onto another, wherever and however they lie.

    Both are moved to the centroids and scaled by the RMS radii of their areas; the correlation of their spherical
    harmonics over all rotations gives candidates, distances between the surfaces decide among them, and closest points
    polish the answer (``docs/alignment.md``). Meant for shapes seen whole: where they overlap in part the answer may
    be wrong, and its confidence low. Equal input gives equal bytes.

    Args:
        source: Mesh or point cloud, as ``from_any`` takes it.
        target: The same, in any combination.
        option: ``SphericalRegistrationOption()`` if not given.

    Returns:
        The transformation with fitness, inlier RMSE, confidence and runners-up. Shapes without a unique rotation get
        one that fits, ``ambiguity`` says so, and the confidence is near 0.

    Raises:
        TypeError: Not a geometry, or not an option.
        GeometryError: Empty, not finite, without area or extent; the message begins with the argument's name.

    Example:
        >>> source, target = fsh.read_geometry("samples/gem_rotated.stl"), fsh.read_geometry("samples/gem.stl")
        >>> result = fsh.registration_spherical(source, target)
        >>> print(f"{1 / result.scale:.2f} times larger, fitness {result.fitness:.2f}")
        1.30 times larger, fitness 1.00
        >>> moved = source.transform(result.transformation)
        >>> bool(fsh.vertex_distances(moved, target).max() < 0.01)
        True
    """
    if option is None:
        option = SphericalRegistrationOption()
    if not isinstance(option, SphericalRegistrationOption):
        raise TypeError(f"option must be a SphericalRegistrationOption, got {type(option).__name__}")
    given = _arrays(source, "source"), _arrays(target, "target")
    with single_threaded_blas():
        plain = _surface(given[0], "source", option.samples), _surface(given[1], "target", option.samples)
        found = _aligned(resolved_surface(plain[0]), resolved_surface(plain[1]), option)
        if found.overlap < _WHOLE:
            # Thin parts that only one of the two has weigh less by their area than by what is seen of them.
            found = max(found, _aligned(*plain, option), key=lambda alignment: alignment.overlap)
        return _result(found, given, option)


def _arrays(geometry: Any, name: str) -> MeshArrays | PointArrays:
    try:
        return geometry_arrays(geometry)[0]
    except GeometryError as error:
        raise GeometryError(f"{name}: {error}") from None
    except TypeError as error:
        raise TypeError(f"{name}: {error}") from None


def _surface(geometry: MeshArrays | PointArrays, name: str, samples: int) -> Surface:
    try:
        return plain_surface(geometry, samples)
    except GeometryError as error:
        raise GeometryError(f"{name}: {error}") from None


def _aligned(first: Surface, second: Surface, option: SphericalRegistrationOption) -> Alignment:
    return align(
        first,
        second,
        scaling=option.with_scaling,
        reflections=option.reflections,
        polish=option.polish,
        candidates=option.candidates,
        bandwidth=option.bandwidth,
    )


def _result(
    found: Alignment,
    given: tuple[MeshArrays | PointArrays, MeshArrays | PointArrays],
    option: SphericalRegistrationOption,
) -> SphericalRegistrationResult:
    surfaces = found.first, found.second
    unit = surfaces[1].rms_radius
    limit = option.max_correspondence_distance
    near = found.near if limit is None else limit / unit
    points = [_fitness_points(*pair) for pair in zip(given, surfaces, strict=True)]
    tree = found.target.tree if points[1] is found.target.nodes else cKDTree(points[1])
    moved = found.poses.take([0]).apply(points[0])[0]
    distance, index = (np.asarray(part) for part in tree.query(moved, distance_upper_bound=near * (1 + 1e-12)))
    inlier = np.flatnonzero(distance <= near)
    transformations = _transformations(found, *surfaces)
    probed = found.distances[:, 0]
    inside = probed <= near
    squares = np.where(inside, probed, 0.0) ** 2
    return SphericalRegistrationResult(
        transformation=transformations[0].copy(),
        fitness=len(inlier) / len(points[0]),
        inlier_rmse=_rms(distance[inlier]) * unit,
        correspondence_set=np.stack((inlier, index[inlier]), axis=1).astype(np.int32),
        correlation=float(found.correlations[0]),
        confidence=found.confidence,
        ambiguity=found.ambiguity,
        scale=float(found.poses.scales[0] * (unit / surfaces[0].rms_radius)),
        reflected=bool(np.linalg.det(found.poses.rotations[0]) < 0),
        max_correspondence_distance=near * unit,
        source_points=_in_own_units(points[0], given[0], surfaces[0]),
        target_points=_in_own_units(points[1], given[1], surfaces[1]),
        candidates=tuple(
            SphericalRegistrationCandidate(
                transformation=transformations[k].copy(),
                correlation=float(found.correlations[k]),
                fitness=float(inside[k].mean()),
                inlier_rmse=float(np.sqrt(squares[k].sum() / max(inside[k].sum(), 1))) * unit,
            )
            for k in range(1, len(transformations))
        ),
    )


def _fitness_points(geometry: MeshArrays | PointArrays, surface: Surface) -> Float64Array:
    """What fitness is measured on, in the surface's frame: a cloud's own points, in their order, or samples."""
    if isinstance(geometry, MeshArrays):
        return surface.points
    return (geometry.points - surface.centroid) / surface.rms_radius


def _in_own_units(points: Float64Array, geometry: MeshArrays | PointArrays, surface: Surface) -> Float64Array:
    if isinstance(geometry, PointArrays):
        return geometry.points.copy()
    return points * surface.rms_radius + surface.centroid


def _transformations(found: Alignment, source: Surface, target: Surface) -> Float64Array:
    """(k, 4, 4) from the source's coordinates to the target's."""
    poses, ratio = found.poses, target.rms_radius / source.rms_radius
    result = np.zeros((len(poses), 4, 4))
    result[:, :3, :3] = ratio * poses.scales[:, None, None] * poses.rotations
    result[:, :3, 3] = target.centroid + target.rms_radius * poses.shifts - result[:, :3, :3] @ source.centroid
    result[:, 3, 3] = 1
    return result


def _rms(values: Float64Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
