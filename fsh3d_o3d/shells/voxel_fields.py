"""Fields of a surface on a voxel grid, looked up at points.

The grid is turned against the axes by a fixed generic rotation: models are drawn along the axes, and flat faces along
the grid are its worst case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.sparse import csr_array

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import Surface, surface_points

_SMALLEST = 1e-300  # stands for an area too far away to be seen, just above float64's least: its logarithm is finite


def _generic_rotation() -> Float64Array:
    rotation, triangle = np.linalg.qr(np.array([[0.48, -0.31, 0.62], [0.62, 0.83, -0.2], [0.62, -0.46, 0.75]]))
    return np.asarray(rotation * np.sign(np.diag(triangle)))


@dataclass(frozen=True, eq=False)
class Deposit:
    """A surface's area on the nodes of a grid."""

    area: Float64Array
    """(voxels³,) share of the area at each node."""
    radial: Float64Array
    """(voxels³,) the same times (n·r)²: n the surface's normal, r the direction from the centre."""


class VoxelGrid:
    """A grid over the ball of radius ``outer`` and the trilinear look-up of its nodes at fixed points.

    Args:
        points: (n, 3) within the ball.
        outer: Radius of the ball; area outside is left out.
        voxels: Nodes along each side, at least 4.
    """

    def __init__(self, points: Float64Array, outer: float, voxels: int) -> None:
        self.voxels = voxels
        self.outer = outer
        self.step = 2 * outer / (voxels - 2)  # one voxel of margin
        self._rotation = _generic_rotation()
        column, weight = self._corners(points @ self._rotation)
        row = np.tile(np.arange(len(points)), 8)
        self._lookup = csr_array((weight, (row, column)), shape=(len(points), voxels**3))

    def deposit(self, surface: Surface) -> Deposit:
        """Spread a surface's area over the nodes around each sample."""
        square = np.einsum("ij,ij->i", surface.points, surface.points)
        kept = square < self.outer**2
        points, normals = surface.points[kept], surface.normals[kept]
        index, weight = self._corners(points @ self._rotation)
        weight *= np.tile(surface.weights[kept], 8)
        length = square[kept] * np.einsum("ij,ij->i", normals, normals)
        radial = np.einsum("ij,ij->i", points, normals) ** 2 / np.maximum(length, _SMALLEST)
        size = self.voxels**3
        area, part = (np.bincount(index, w, size) for w in (weight, weight * np.tile(radial, 8)))
        return Deposit(np.asarray(area, dtype=np.float64), np.asarray(part, dtype=np.float64))

    def squared_soft_distances(self, deposit: Deposit, smoothing: float) -> Float64Array:
        """(n,) squared soft distances to the surface, −2s² log ∫ exp(−|x − y|²/2s²) dA(y) at unit area.

        The soft minimum over the whole area instead of the least distance: it has no kinks, and does not jump when a
        voxel is touched or not.
        """
        area = np.maximum(self._blurred(deposit.area, smoothing), _SMALLEST)
        return self.at_points(np.log(area)) * (-2 * smoothing**2)

    def radial_normals(self, deposit: Deposit, smoothing: float, width: float) -> Float64Array:
        """(n,) mean of (n·r)² over the surface around each point, n its normal and r the direction from the centre.

        Times exp(−d²/2 width²) of the soft distance d, so that the surface near by counts.
        """
        part, area = self._blurred(deposit.radial, smoothing), self._blurred(deposit.area, smoothing)
        area = np.maximum(area, _SMALLEST)
        return self.at_points(part / area * area ** ((smoothing / width) ** 2))

    def at_points(self, values: Float64Array) -> Float64Array:
        """Trilinear interpolation of node values (voxels³,) at the points (n,)."""
        return np.asarray(self._lookup @ values)

    def squared_distances(self, surface: Surface) -> Float64Array:
        """(n,) squared distances to the surface: Euclidean distance transform of the voxels that it touches.

        Distances are to the mean of the surface within the nearest voxel instead of to the voxel's node, which is
        several times more accurate.
        """
        points = surface_points(surface, self.step / 2)
        points = np.concatenate((points, surface.points))
        points = points[np.einsum("ij,ij->i", points, points) < self.outer**2] @ self._rotation
        if len(points) == 0:
            raise GeometryError("none of the surface lies within the shells")
        node = np.rint(points / self.step + (self.voxels - 1) / 2).astype(np.int64)
        flat = (node[:, 0] * self.voxels + node[:, 1]) * self.voxels + node[:, 2]
        size = self.voxels**3
        count = np.bincount(flat, minlength=size)
        mean = [np.bincount(flat, points[:, k], size) / np.maximum(count, 1) for k in range(3)]
        shape = (self.voxels,) * 3
        nearest = scipy.ndimage.distance_transform_edt(
            (count == 0).reshape(shape), return_distances=False, return_indices=True
        )
        place = ((nearest[0] * self.voxels + nearest[1]) * self.voxels + nearest[2]).ravel()
        own = (np.arange(self.voxels) - (self.voxels - 1) / 2) * self.step
        nodes = (own[:, None, None], own[:, None], own)
        square = sum((mean[k][place].reshape(shape) - nodes[k]) ** 2 for k in range(3))
        return self.at_points(np.asarray(square).ravel())

    def _blurred(self, values: Float64Array, sigma: float) -> Float64Array:
        """Node values (voxels³,) under a Gaussian of peak 1 along the three axes.

        By dense positive matrices: a blur through the Fourier transform rings, and the logarithm of its far field is a
        pattern of the grid.
        """
        size, node = self.voxels, np.arange(self.voxels) * self.step
        kernel = np.exp(-0.5 * ((node[:, None] - node) / sigma) ** 2)
        first = (kernel @ values.reshape(size, -1)).reshape(size * size, size) @ kernel
        return np.asarray(np.matmul(kernel, first.reshape(size, size, size)).ravel())

    def _corners(self, points: Float64Array) -> tuple[IntArray, Float64Array]:
        """Flat index and trilinear weight (8 n,) of the nodes around each of n points, corner by corner."""
        place = points / self.step + (self.voxels - 1) / 2
        low = place.astype(np.int64)
        part = place - low
        base = (low[:, 0] * self.voxels + low[:, 1]) * self.voxels + low[:, 2]
        offset = [(i * self.voxels + j) * self.voxels + k for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        x, y, z = ((1 - part[:, k], part[:, k]) for k in range(3))
        plane = [x[i] * y[j] for i in (0, 1) for j in (0, 1)]
        weight = np.concatenate([p * z[k] for p in plane for k in (0, 1)])
        return (base + np.array(offset)[:, None]).ravel(), weight
