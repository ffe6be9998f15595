"""Global alignment of meshes and point clouds: any rotation, any position, any scale, no first guess."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.geometry import PointArrays
from fsh3d_o3d.registration.answer import Answer, answer
from fsh3d_o3d.registration.fit import search_tree
from fsh3d_o3d.registration.option import SphericalRegistrationOption
from fsh3d_o3d.registration.prepared import Prepared
from fsh3d_o3d.registration.search import Ambiguity
from fsh3d_o3d.registration.target import prepared_target
from fsh3d_o3d.sphere import single_threaded_blas

__all__ = [
    "SphericalRegistrationCandidate",
    "SphericalRegistrationOption",
    "SphericalRegistrationResult",
    "registration_spherical",
]


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
    correlation: float
    """Of the coefficients at the maximum that led to the answer, in [−1, 1]; 0 where a shape is round."""
    overlap: tuple[float, float]
    """Share of the source's area that lies on the target, and of the target's that lies on the source."""
    confidence: float
    """In [0, 1]: how far the answer can be trusted. Low where little overlaps, where surfaces stay apart, and where
    another pose fits as well (see ``ambiguity``)."""
    ambiguity: Ambiguity
    """``"discrete"``: some other pose fits about as well, as for two-fold symmetry; ``"continuous"``: turning a little
    about some axis changes little, as for vases and balls; ``"sliding"``: moving a little along some direction does,
    as for planes, walls and rods. Then the pose is one of several."""
    ambiguous_axis: Float64Array | None
    """(3,) that axis or direction, a unit vector in the target's coordinates; None where there is none."""
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
    dropped: tuple[int, int] = (0, 0)
    """Points of source and target that were left out because they are not finite."""

    @functools.cached_property
    def fitness(self) -> float:
        """Share of ``source_points`` with a point of the target within the ``max_correspondence_distance``."""
        return len(self._inliers[0]) / len(self.source_points)

    @functools.cached_property
    def inlier_rmse(self) -> float:
        """Root mean square distance of those, in units of the target; 0 if there are none."""
        distance = self._inliers[1]
        return float(np.sqrt(np.mean(distance**2))) if len(distance) else 0.0

    @functools.cached_property
    def correspondence_set(self) -> NDArray[np.int32]:
        """(c, 2) indices into ``source_points`` and ``target_points`` of those and the nearest to each."""
        return self._inliers[2]

    @functools.cached_property
    def _inliers(self) -> tuple[IntArray, Float64Array, NDArray[np.int32]]:
        """Indices and distances of the inliers, and the pairs; found when first asked for, because it takes long."""
        limit = self.max_correspondence_distance
        moved = self.source_points @ self.transformation[:3, :3].T + self.transformation[:3, 3]
        tree = search_tree(self.target_points)
        distance, index = map(np.asarray, tree.query(moved, distance_upper_bound=limit * (1 + 1e-12)))
        inlier = np.flatnonzero(distance <= limit)
        return inlier, distance[inlier], np.stack((inlier, index[inlier]), axis=1).astype(np.int32)


def registration_spherical(
    source: Any, target: Any, option: SphericalRegistrationOption | None = None
) -> SphericalRegistrationResult:
    """Find the similarity that maps one shape onto another, wherever and however they lie.

    Whole shapes are moved to their centroids and turned by the correlation of their spherical harmonics over all
    rotations. Where that does not lay both on each other, either is taken for a part: matches of local harmonics stand
    for poses, and what agrees of both surfaces decides (``docs/alignment.md``). Of parts in different units the scale
    is not found. Equal input gives equal bytes.

    Args:
        source: Mesh or point cloud, as ``from_any`` takes it.
        target: The same, in any combination.
        option: ``SphericalRegistrationOption()`` if not given.

    Returns:
        The transformation with overlap, confidence and runners-up. Shapes without a unique pose get one that fits, and
        ``ambiguity`` says so; the confidence is near 0 then.

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
    first = Prepared.of(source, option.samples, "source")
    second = prepared_target(target, option.samples)
    with single_threaded_blas():
        return _result(answer(first, second, option), first, second, option)


def _result(
    found: Answer, source: Prepared, target: Prepared, option: SphericalRegistrationOption
) -> SphericalRegistrationResult:
    matrix = found.transformations[0]
    scale = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    limit = option.max_correspondence_distance
    return SphericalRegistrationResult(
        transformation=matrix.copy(),
        correlation=float(found.correlations[0]),
        overlap=found.overlap,
        confidence=found.confidence,
        ambiguity=found.ambiguity,
        ambiguous_axis=found.axis,
        scale=scale,
        reflected=bool(np.linalg.det(matrix[:3, :3]) < 0),
        max_correspondence_distance=found.near if limit is None else limit,
        source_points=_own_points(source),
        target_points=_own_points(target),
        candidates=tuple(
            SphericalRegistrationCandidate(
                transformation=found.transformations[k].copy(),
                correlation=float(found.correlations[k]),
                fitness=float(found.fitness[k]),
                inlier_rmse=float(found.inlier_rmse[k]),
            )
            for k in range(1, len(found.transformations))
        ),
        dropped=(source.dropped, target.dropped),
    )


def _own_points(prepared: Prepared) -> Float64Array:
    """What fitness is measured on: a cloud's own points, in their order, or samples of a mesh."""
    if isinstance(prepared.geometry, PointArrays):
        return prepared.geometry.points.copy()
    return prepared.plain.points * prepared.plain.rms_radius + prepared.plain.centroid
