"""Cotangent Laplacians of closed surfaces, and solvers that factorise once."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere_map.validity import cross, edge_vectors

# Twice a triangle's area counts as at least this part of its longest edge squared, a choice. It keeps those without
# area finite and the matrix well conditioned. Only the area is raised: the element matrix of a triangle is its area's
# inverse times a positive semidefinite one, so the sum stays positive semidefinite, with negative cotangents and all.
_THINNEST = 1e-6
_ACCURACY = 1e-7  # of conjugate gradients, relative to the first residual: about ten steps, and the flow moves far more
_STEPS = 60  # of conjugate gradients, a bound: six times what a map near the conformal one takes


def laplacian(vertices: Float64Array, triangles: IntArray) -> csc_array:
    """Return the positive semidefinite cotangent matrix (n, n): −(cot α + cot β) / 2 at an edge, rows sum to 0.

    Pinkall and Polthier, Computing Discrete Minimal Surfaces and Their Conjugates, 1993.
    """
    cot = cotangents(edge_lengths(vertices, triangles))
    weight = cot.ravel() / 2  # of the edge opposite each corner
    rows, columns = triangles[:, (1, 2, 0)].ravel(), triangles[:, (2, 0, 1)].ravel()
    n = len(vertices)
    adjacency = csc_array((weight, (rows, columns)), shape=(n, n))
    adjacency = adjacency + adjacency.T
    return csc_array(diags_array(adjacency.sum(axis=1)) - adjacency)


def edge_lengths(vertices: Float64Array, triangles: IntArray) -> Float64Array:
    """Return the length (t, 3) of the edge from each corner to the next."""
    _, u, v = edge_vectors(vertices, triangles)
    return np.asarray(np.sqrt(np.stack(((u * u).sum(axis=0), ((v - u) ** 2).sum(axis=0), (v * v).sum(axis=0)), axis=1)))


def cotangents(lengths: Float64Array) -> Float64Array:
    """Return the cotangent (t, 3) of the angle at each corner from the edge lengths (t, 3), corner to next corner."""
    opposite = lengths[:, (1, 2, 0)] ** 2
    total = opposite.sum(axis=1, keepdims=True)
    # The smallest float64 stands for the area of a triangle that is a single point, whose cotangents then are 0.
    thinnest = np.maximum(_THINNEST * opposite.max(axis=1), np.finfo(np.float64).tiny)
    return np.asarray((total - 2 * opposite) / (2 * np.maximum(double_areas(lengths), thinnest))[:, None])


def double_areas(lengths: Float64Array) -> Float64Array:
    """Return twice the area (t,) of triangles from their edge lengths; Kahan's arrangement of Heron's formula."""
    c, b, a = np.sort(lengths, axis=1).T
    product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
    return np.asarray(np.sqrt(np.maximum(product, 0.0)) / 2)


def lumped_mass(points: Float64Array, triangles: IntArray) -> Float64Array:
    """Return a third of the area of the triangles around each point (n,)."""
    _, u, v = edge_vectors(points, triangles)
    normal = cross(u, v)
    third = np.sqrt((normal * normal).sum(axis=0)) / 6
    mass = np.bincount(triangles.ravel(), weights=np.repeat(third, 3), minlength=len(points))
    return mass.astype(np.float64, copy=False)


class PinnedLaplacian:
    """A Laplacian L, factorised once: solves with L itself, and with L plus any mass by conjugate gradients.

    On a sphere of area 4π that the surface maps to conformally, L⁻¹ (L + M) has the eigenvalues 1 + 1/(l (l + 1)),
    whatever the mesh: ten steps give seven digits, and each costs a fraction of a factorisation.
    """

    def __init__(self, matrix: csc_array, pin: int) -> None:
        self._matrix = matrix
        # L is singular by a constant: a little mass at one vertex fixes the value there.
        pinned = np.zeros(matrix.shape[0])
        pinned[pin] = 1.0
        self._factors = factorised(csc_array(matrix + diags_array(pinned)))

    def solve(self, right: Float64Array) -> Float64Array:
        """Return the x (n, k) with L x = ``right`` (n, k), of zero column sums, that is 0 at the pinned vertex."""
        return np.asarray(self._factors.solve(right))

    def solve_with_mass(self, mass: Float64Array, right: Float64Array, start: Float64Array) -> Float64Array:
        """Return the x (n, k) with (L + diag(``mass``)) x = ``right`` (n, k), from a nearby ``start`` (n, k)."""
        x = start.copy()
        residual = right - self._matrix @ x - mass[:, None] * x
        direction = np.zeros_like(x)
        previous = np.ones(x.shape[1])
        least = 0.0
        for step in range(_STEPS):
            towards = self.solve(residual)
            decrement = np.einsum("nk,nk->k", residual, towards)  # squared length of the residual, of each column
            if step == 0:
                least = _ACCURACY**2 * float(decrement.max())
            if not (decrement > least).any():  # also where all is NaN
                break
            direction = towards + decrement / previous * direction if step else towards
            image = self._matrix @ direction + mass[:, None] * direction
            length = decrement / np.einsum("nk,nk->k", direction, image)
            x += length * direction
            residual -= length * image
            previous = decrement
        return x


def factorised(matrix: csc_array) -> SuperLU:
    """Return the factors of a positive definite matrix; SuperLU without pivoting, as fast as a Cholesky here."""
    factors: SuperLU = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return factors
