"""Points of any density as samples of a surface: the area each stands for, and its normal."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.thinning import thinned

_NEIGHBOURS = 16  # points, a choice: fewer make areas noisy, more blur where density changes
_MOST_POINTS = 65536  # more do not change a feature, only the time it takes
# Of the median area, a choice. A lone outlier stands far from everything; without a bound it would claim more area
# than the object.
_LARGEST_SHARE = 16.0


def density_corrected(
    points: Float64Array, normals: Float64Array | None
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return points (n, 3), normals (n, 3) and weights (n,) of a cloud in the unit cube, in sorted order.

    The weight is the squared distance to the sixteenth neighbour, which is proportional to the area around a point
    where points lie on a surface, at most sixteen times the median; weights sum to 1. Equal points count once, and the
    order of the points does not matter. Normals are the given ones where they are finite and not zero, otherwise the
    direction in which the neighbours spread least (Hoppe et al. 1992).
    """
    kept = thinned(points, _MOST_POINTS)
    points = points[kept]
    count = min(_NEIGHBOURS, len(points) - 1)
    distance, index = cKDTree(points).query(points, k=count + 1)
    area = np.asarray(distance)[:, -1] ** 2
    area = np.minimum(area, _LARGEST_SHARE * np.median(area))
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    spread = np.matmul(around.transpose(0, 2, 1), around)
    # Scaled by its own size: eigenvalues of tiny matrices must not underflow.
    spread /= np.maximum(np.trace(spread, axis1=1, axis2=2), np.finfo(np.float64).tiny)[:, None, None]
    estimated = np.linalg.eigh(spread)[1][:, :, 0]
    if normals is None:
        return points, estimated, area / area.sum()
    given = normals[kept]
    largest = np.abs(given).max(axis=1)
    usable = np.isfinite(largest) & (largest > 0)
    given = given / np.where(usable, largest, 1)[:, None]  # of order one, so that squares neither overflow nor vanish
    return points, np.where(usable[:, None], given, estimated), area / area.sum()
