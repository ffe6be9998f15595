"""The sparse systems of area balancing: two unknowns a vertex, one pattern for all Newton steps."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, cg, splu

from fsh3d_o3d._validation import Float64Array, IntArray

Order = Literal["MMD_AT_PLUS_A", "NATURAL"]

_DAMPINGS = (
    1e-8,
    1e-4,
    1.0,
)  # of the unit diagonal, tried in turn, a choice: rotations of the sphere cost nothing, so some is needed
_RESIDUAL = 1e-2  # relative, at which conjugate gradients stop; a choice: the step is only one of many


class BlockSystem:
    """Assembles and solves Σ_T RᵀR x = b with 2 × 2 blocks for the pairs of vertices that share a triangle.

    Solved by factors, whose order of elimination is found once, on the graph of the vertices; or by a few conjugate
    gradient steps, which are cheap, solve for what is wrong locally, and descend too.
    """

    def __init__(self, triangles: IntArray, count: int, *, conjugate_steps: int | None = None) -> None:
        """Find order and pattern for the corners (3, t) of ``count`` vertices.

        Args:
            triangles: (3, t) corners.
            count: Number of vertices.
            conjugate_steps: At most so many conjugate gradient steps instead of factors.
        """
        self._conjugate_steps = conjugate_steps
        self._order = np.arange(count) if conjugate_steps else _elimination_order(triangles, count)
        place_of = np.empty_like(self._order)
        place_of[self._order] = np.arange(count)
        corners = place_of[triangles]
        keys, slot = np.unique(
            np.tile(corners, (3, 1)).ravel() * count + np.repeat(corners, 3, axis=0).ravel(), return_inverse=True
        )
        column, row = np.divmod(keys, count)
        degree = np.bincount(column, minlength=count)
        start = np.concatenate(([0], np.cumsum(degree)))
        # Column 2j + d holds the rows 2i, 2i + 1 of all neighbours i of j in order.
        first = 4 * start[column] + 2 * (np.arange(len(keys)) - start[column])
        place = np.stack([[first + 2 * d * degree[column] + a for d in (0, 1)] for a in (0, 1)])
        self._rows = np.empty(4 * len(keys), dtype=np.int32)
        for a in (0, 1):
            self._rows[place[a]] = 2 * row + a
        self._start = np.concatenate(([0], np.cumsum(np.repeat(2 * degree, 2)))).astype(np.int32)
        self._shape = (2 * count, 2 * count)
        # (6, 6, t): where the entry of corner k, tangent a and corner l, tangent d of each triangle goes.
        pattern = slot.reshape(3, 3, -1)
        self._place = np.ascontiguousarray(place[:, :, pattern].transpose(2, 0, 3, 1, 4).reshape(6, 6, -1))
        own = np.flatnonzero(row == column)
        self._diagonal = np.stack((place[0, 0, own], place[1, 1, own]), axis=1).ravel()

    def directions(self, factors: Float64Array, gradient: Float64Array) -> Float64Array | None:
        """Return a step x (n, 2), the solution of (Σ RᵀR) x = −gradient (n, 2), slightly damped, that descends.

        None where rounding spoils every attempt.
        """
        data = self._assembled(factors)
        # Unit diagonal: triangles may differ by many orders of magnitude, and a pivot should not notice.
        diagonal = data[self._diagonal]
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        data *= scale[self._rows] * np.repeat(scale, np.diff(self._start))
        target = -gradient[self._order].ravel() * scale
        solution = self._solved(data, target)
        if solution is None:
            return None
        result = np.empty_like(gradient)
        result[self._order] = (solution * scale).reshape(-1, 2)
        return result

    def _assembled(self, factors: Float64Array) -> Float64Array:
        """Return the entries of Σ RᵀR in the order of the pattern."""
        data = np.zeros(len(self._rows))
        blocks = np.empty(factors.shape[1:])
        for k in range(6):
            np.multiply(factors[0, k], factors[0], out=blocks)
            for factor in factors[1:]:
                blocks += factor[k] * factor
            data += np.bincount(self._place[k].ravel(), blocks.ravel(), len(data))
        return data

    def _solved(self, data: Float64Array, target: Float64Array) -> Float64Array | None:
        """Return the least damped solution that descends: target · solution > 0, which NaN is not."""
        for damping in _DAMPINGS:
            data[self._diagonal] = 1 + damping
            matrix = csc_array((data, self._rows, self._start), shape=self._shape)
            try:
                if self._conjugate_steps:
                    solution, _ = cg(matrix, target, rtol=_RESIDUAL, maxiter=self._conjugate_steps)
                else:
                    solution = _factorised(matrix, "NATURAL").solve(target)
            except RuntimeError:  # exactly singular
                continue
            if target @ solution > 0:
                return np.asarray(solution)
        return None


def _elimination_order(triangles: IntArray, count: int) -> IntArray:
    """Return the vertices (n,) in an order that keeps factors sparse: minimum degree on the graph of the edges."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=0).ravel()
    # Every edge is a half-edge of two triangles, once each way. The graph's Laplacian + 1 has positive pivots.
    degree = np.bincount(start, minlength=count)
    own = np.arange(count)
    entries = np.concatenate((np.full(len(start), -1.0), degree + 1.0))
    places = (np.concatenate((start, own)), np.concatenate((end, own)))
    graph = csc_array((entries, places), shape=(count, count))
    return np.argsort(_factorised(graph, "MMD_AT_PLUS_A").perm_c)


def _factorised(matrix: Any, order: Order) -> SuperLU:
    factors: SuperLU = splu(
        matrix,
        permc_spec=order,
        diag_pivot_thresh=0.0,
        relax=8,
        panel_size=1,
        options={"SymmetricMode": True},
    )
    return factors
