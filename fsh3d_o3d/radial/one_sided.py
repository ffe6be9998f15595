"""The radial function of a scan that saw one side: from behind it, or from in front of it, as a camera sees a scene.

A scan from one place is a surface in front of which nothing lies. So it has a radial function about a point behind it,
where it bulges towards the scanner, or in front of it, where it recedes, as a room does. Which of some places is best,
a coarse fit from each tells. What no point tells is filled as smoothly as it can be: the directions there get samples
of the harmonic function that continues the surface, or a fit would be free to do there as it likes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import PointArrays, thinned
from fsh3d_o3d.radial.cloud import CloudFit, fit_radial_cloud, usable_bandwidth
from fsh3d_o3d.radial.mesh import filled
from fsh3d_o3d.sphere import evaluate, fibonacci_grid

_FILL_DIRECTIONS = 4096  # on the sphere, 3 degrees apart: a guess needs no detail
_BRIDGED = 12.0  # degrees: nearer to a point than this the fit continues by itself; four steps of the grid above
_LOOK_POINTS = 8_000  # of a cloud that places are compared on; a choice
_LOOK_BANDWIDTH = 16  # of that comparison: features 11 degrees wide
_LEAST_BANDWIDTH = 12  # below that a guess from another place is better; a choice
_DISTANCES = (0.5, 1.2)  # of places from the middle, in RMS radii, a choice: for flat scans and for deep ones
_KEPT = 0.95  # share of the points that places are judged by: outliers and the edges of what hides something are apart
_NEIGHBORS = 4  # points whose median radius a direction of the grid takes


def fit_one_sided(cloud: PointArrays, bandwidth: int, *, threads: int | None = None) -> CloudFit:
    """Fit a radial function to a cloud that covers one side, from the best of some places behind and before it.

    Args:
        cloud: Points; normals are not used.
        bandwidth: b, less where the points are too few for it.
        threads: Number of threads, or None for all that the process may use. Does not change the result.

    Returns:
        The fit; ``inliers``, ``empty_cap`` and ``empty_direction`` count the samples that filled what was not seen.

    Raises:
        GeometryError: From none of the places is there a radial function.
    """
    few = PointArrays(cloud.points[thinned(cloud.points, _LOOK_POINTS)])
    looks: list[tuple[float, Float64Array]] = []
    for center in _places(few.points):
        with contextlib.suppress(GeometryError):
            looks.append((_misfit(few.points, _fit(few, _LOOK_BANDWIDTH, center, threads)), center))
    for _, center in sorted(looks, key=lambda look: look[0]):
        degrees = bandwidth
        while degrees >= _LEAST_BANDWIDTH:
            with contextlib.suppress(GeometryError):  # where little was seen, high degrees may leave radii below zero
                return _fit(cloud, degrees, center, threads)
            degrees = degrees * 2 // 3
    raise GeometryError("the scan has no radial function, neither from behind nor from in front of it")


def _places(points: Float64Array) -> Iterator[Float64Array]:
    """Places on either side of the middle of the points, along the direction in which they spread least."""
    middle = np.median(points, axis=0)
    relative = points - middle
    reach = np.sqrt(np.square(np.linalg.norm(relative, axis=1)).mean())
    normal = np.linalg.svd(relative / reach, full_matrices=False)[2][2]
    for distance in _DISTANCES:
        for side in (-1.0, 1.0):
            yield middle + side * distance * reach * normal


def _fit(cloud: PointArrays, bandwidth: int, center: Float64Array, threads: int | None) -> CloudFit:
    relative = cloud.points - center
    radius = np.linalg.norm(relative, axis=1)
    radius = np.maximum(radius, 1e-9 * float(np.median(radius)))  # a point at the centre has no direction, nor harm
    directions = relative / radius[:, None]
    grid = fibonacci_grid(_FILL_DIRECTIONS).directions
    count = min(_NEIGHBORS, len(radius))
    found = KDTree(directions).query(grid, k=count)
    distance, index = (np.reshape(part, (-1, count)) for part in found)
    known = distance[:, 0] <= 2 * np.sin(np.radians(_BRIDGED / 4) / 2)
    if not known.any():
        known[distance[:, 0].argmin()] = True
    guess = np.median(radius[index], axis=1)
    if not known.all():
        guess[~known] = filled(grid, guess, known)
    empty = distance[:, 0] > 2 * np.sin(np.radians(_BRIDGED) / 2)
    samples = np.concatenate((cloud.points, center + guess[empty, None] * grid[empty]))
    whole = PointArrays(samples)
    return fit_radial_cloud(whole, min(bandwidth, usable_bandwidth(whole, center)), center, threads=threads)


def _misfit(points: Float64Array, fit: CloudFit) -> float:
    """RMS distance along rays of the points that fit best."""
    relative = points - fit.center
    radius = np.linalg.norm(relative, axis=1)
    used = radius > 0
    off = np.abs(evaluate(fit.coefficients, relative[used] / radius[used, None]) - radius[used])
    return float(np.sqrt(np.square(np.sort(off)[: max(1, int(_KEPT * len(off)))]).mean()))
