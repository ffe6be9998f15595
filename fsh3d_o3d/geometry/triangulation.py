"""Triangulations of the unit sphere: the hull of given directions, or an icosphere of a chosen size."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from fsh3d_o3d._validation import Float64Array, IntArray, integer
from fsh3d_o3d._validation import directions as checked_directions
from fsh3d_o3d.geometry.triangles import triangle_normals
from fsh3d_o3d.sphere import icosphere

__all__ = ["fibonacci_triangulation", "icosphere", "sphere_mesh"]

_MAXIMUM_POINTS = 10 * 2000**2 + 2  # of the largest icosphere, of frequency 2000: 1 GB of positions, a choice


def fibonacci_triangulation(directions: Float64Array) -> tuple[Float64Array, IntArray]:
    """Triangulate the sphere between given directions: the faces of their convex hull, spherical Delaunay triangles.

    Made for the nodes of a Fibonacci grid, whose triangles have no small angle anywhere, the poles included (minimum
    about 38°, largest to smallest area about 1.6); any directions around the origin will do, if all are different.

    Args:
        directions: (n, 3) unit vectors, n ≥ 4.

    Returns:
        The directions (n, 3) as given, normalised, and outward-oriented triangles (2n − 4, 3), int64.

    Raises:
        ValueError: Not unit vectors, fewer than four, on one half of the sphere, or not all different.
    """
    points = checked_directions(directions)
    if len(points) < 4:
        raise ValueError(f"directions must be at least 4 to triangulate a sphere, got {len(points)}")
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError("directions must surround the origin, but they lie in one plane") from None
    triangles = hull.simplices.astype(np.int64)
    if len(triangles) != 2 * len(points) - 4 or len(hull.vertices) != len(points):
        raise ValueError(
            f"directions must all be different to be triangulated, but only {len(hull.vertices)} of {len(points)} "
            "are corners of their hull"
        )
    if hull.equations[:, 3].max() >= 0:
        raise ValueError("directions must surround the origin, but they leave half of the sphere empty")
    return points, _outward(points, triangles)


def sphere_mesh(resolution: int | Float64Array) -> tuple[Float64Array, IntArray]:
    """Return a triangulated sphere: directions (n, 3) and outward-oriented triangles (2n − 4, 3).

    Args:
        resolution: A number of points, for the smallest icosphere that has at least as many; or directions (n, 3),
            such as ``fibonacci_grid(n).directions``, to become the vertices.
    """
    if isinstance(resolution, np.ndarray) and resolution.ndim > 0:
        return fibonacci_triangulation(resolution)
    points = integer(resolution, "resolution", minimum=4, maximum=_MAXIMUM_POINTS)
    # The smallest f with 10 f² + 2 ≥ points.
    return icosphere(1 if points <= 12 else math.isqrt((points - 3) // 10) + 1)


def _outward(points: Float64Array, triangles: IntArray) -> IntArray:
    corners = points[triangles]
    inward = np.einsum("ij,ij->i", corners[:, 0], triangle_normals(corners)) < 0
    return np.ascontiguousarray(np.where(inward[:, None], triangles[:, (0, 2, 1)], triangles))
