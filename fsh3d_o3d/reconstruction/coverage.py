"""Where a surface lies beyond what a cloud tells of it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fsh3d_o3d.geometry import BoolArray, MeshArrays, PointArrays, thinned, triangle_areas, vertex_distances

_MOST_POINTS = 100_000  # of a cloud that are looked at; a choice
_NEIGHBORS = 8  # points whose distance says how far apart points are there; a choice
_SPACINGS = 1.0  # a vertex nearer to a point than so many of those distances is seen: twice what even samples need
_DEVIATIONS = 3.0  # robust standard deviations of the points from the surface, allowed besides
_ALL_AROUND = 0.25  # of the area that may be a guess in a closed surface: a cap of 60 degrees has so much of a sphere


def unseen_vertices(cloud: PointArrays, mesh: MeshArrays) -> BoolArray | None:
    """Return which vertices (v,) of a surface no point of a cloud lies near, or None where these are few.

    Args:
        cloud: The points.
        mesh: The surface that was made of them.
    """
    points = cloud.points[thinned(cloud.points, _MOST_POINTS)]
    tree = KDTree(points)
    apart = np.asarray(tree.query(points, k=[min(_NEIGHBORS, len(points) - 1) + 1])[0])[:, 0]
    off, nearest = tree.query(mesh.vertices)
    # Scaled to be the standard deviation of a normal distribution; outliers do not count.
    deviation = 1.4826 * float(np.median(vertex_distances(PointArrays(points), mesh)))
    unseen = np.asarray(off > _SPACINGS * apart[nearest] + _DEVIATIONS * deviation)
    area = triangle_areas(mesh.vertices[mesh.triangles])
    share = float(area[unseen[mesh.triangles].any(axis=1)].sum() / area.sum())
    return unseen if _ALL_AROUND < share < 1 else None
