"""Harmonics of what lies around key points: what local features and poses from single matches are made of.

``local_harmonics(points, radius)`` gives ``LocalHarmonics``: key points, the coefficients of their surroundings in
frames of their own, and features. What registration makes of them is in ``registration/local_poses.py``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors.neighbourhoods import Float32Array, neighbourhoods
from fsh3d_o3d.geometry import ThinnedSurface, thinned_surface, voxel_cells

CELLS = 6.0
"""Cells of the lattice that thins the points, to a radius; a choice between noise and time."""
_STRAY = 4.0  # median distances from the mean; what is farther does not count for the size
_LEAST_NEIGHBOURS = 8  # points within the radius; with fewer there is no surface to describe


@value
class LocalHarmonics:
    """Key points of a shape, and the harmonics of their surroundings."""

    points: Float64Array
    """(k, 3) key points, in the coordinates of the shape."""
    frames: Float64Array
    """(k, 3, 3) rotations from those coordinates into the key points' frames; the last row is the normal up to sign."""
    coefficients: Float32Array
    """(k, S, b²) on S shells of the radius, in the frames."""
    feature: Float64Array
    """(k, d) magnitudes of the coefficients of each order, of unit norm: the same in every pose."""
    counts: IntArray
    """(k,) how many points of the thinned shape lie within the radius."""
    offsets: Float64Array
    """(k,) radii from the key point to the mean of its neighbours along the surface; large at borders."""
    radius: float
    """Of the surroundings."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def described(self) -> NDArray[np.bool_]:
        """(k,) whether enough points lie around a key point to tell a surface."""
        return self.counts >= _LEAST_NEIGHBOURS


def local_harmonics(
    points: Float64Array | ThinnedSurface,
    radius: float,
    *,
    keypoints: int | Float64Array = 400,
    bandwidth: int = 5,
    shells: int = 3,
) -> LocalHarmonics:
    """Describe the surroundings of key points of a shape.

    Args:
        points: (n, 3) on the surface, finite, in any order and of any density, which are thinned here; or the surface
            thinned to about ``radius / 6``.
        radius: Of the surroundings, in units of the points; to be compared, both shapes need the same.
        keypoints: About how many are chosen, spread evenly; or (k, 3) positions near the surface.
        bandwidth: Degrees 0 … bandwidth − 1.
        shells: Windows of the distance.
    """
    surface = points if isinstance(points, ThinnedSurface) else thinned_surface(points, radius / CELLS)
    chosen = _spread(surface, keypoints) if isinstance(keypoints, int) else keypoints
    found = neighbourhoods(surface.points, surface.areas, chosen, radius, bandwidth=bandwidth, shells=shells)
    kept = found.counts >= _LEAST_NEIGHBOURS
    if isinstance(keypoints, int) and not kept.all():
        chosen, found = chosen[kept], found.take(kept)
    return LocalHarmonics(
        points=chosen,
        frames=found.frames,
        coefficients=found.coefficients,
        feature=_magnitudes(found.coefficients),
        counts=found.counts,
        offsets=found.offsets,
        radius=radius,
    )


def _spread(surface: ThinnedSurface, count: int) -> Float64Array:
    """About ``count`` of the points, one in each cell of a coarser lattice: that nearest to the middle of the cell."""
    thinned = surface.points
    if len(thinned) <= count:
        return thinned
    coarse = surface.spacing * np.sqrt(len(thinned) / count)  # of a surface: cells go with the square
    order, start = voxel_cells(thinned, coarse)
    size = np.diff(start, append=len(thinned))
    ordered = thinned[order]
    apart = np.mod(ordered / coarse, 1) - 0.5
    nearest = np.lexsort((np.einsum("ij,ij->i", apart, apart), np.repeat(np.arange(len(start)), size)))[start]
    return np.asarray(ordered[nearest])


def _magnitudes(coefficients: Float32Array) -> Float64Array:
    """√(c(s, l, m)² + c(s, l, −m)²) (k, S b (b + 1)/2), of unit norm; zero where there is nothing."""
    count, bandwidth = len(coefficients), int(np.sqrt(coefficients.shape[2]))
    degree, order = np.tril_indices(bandwidth)
    centre = degree * degree + degree
    values = np.hypot(coefficients[:, :, centre + order], coefficients[:, :, centre - order] * (order > 0))
    values = values.reshape(count, values.shape[1] * values.shape[2]).astype(np.float64)
    return np.asarray(values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), np.finfo(np.float32).tiny))


def typical_size(points: Float64Array) -> float:
    """Return the median distance of points (n, 3) from their mean, a few far ones left aside; 0 if all are the same."""
    size = float(np.abs(points).max()) or 1.0  # squares neither overflow nor vanish
    relative = points / size
    distance = np.linalg.norm(relative - relative.mean(axis=0), axis=1)
    near = relative[distance <= _STRAY * np.median(distance)]
    return size * float(np.median(np.linalg.norm(near - near.mean(axis=0), axis=1)))
