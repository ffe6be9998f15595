"""The kernel of a closed oriented surface: the points on the inner side of every face's plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import degenerate, triangle_normals

_START = 256  # faces in the first linear programme, spread over the mesh: as many as a round adds
_ADDED = 256  # violated faces that each round adds
_ROUNDS = 100  # a bound: by then the programme has 26,000 faces
_TOLERANCE = 1e-9  # of plane distances in the unit cube; HiGHS itself meets constraints to about this
_BOX = 1.0  # half the side of a box around the unit cube; some kernels reach to infinity without it


@dataclass(frozen=True, eq=False)
class FacePlanes:
    """Planes n·x = d of the faces of a mesh in the unit cube, normals outward and of unit length."""

    normals: Float64Array
    """(t, 3) unit normals; zero for faces without area."""
    offsets: Float64Array
    """(t,) distances d from the origin along the normals; +inf for faces without area, which constrain nothing."""
    area: Float64Array
    """(t,) areas."""

    @classmethod
    def of(cls, corners: Float64Array) -> FacePlanes:
        """Return the planes of triangles (t, 3, 3)."""
        cross = triangle_normals(corners)
        length = np.sqrt(np.einsum("ij,ij->i", cross, cross))
        flat = degenerate(corners)
        normals = np.where(flat[:, None], 0.0, cross / np.where(flat, 1.0, length)[:, None])
        offsets = np.where(flat, np.inf, np.einsum("ij,ij->i", normals, corners[:, 0]))
        return cls(normals=normals, offsets=offsets, area=length / 2)

    def distance(self, point: Float64Array) -> Float64Array:
        """Return the signed distance (t,) from each plane to a point (3,), positive on the inner side."""
        return np.asarray(self.offsets - self.normals @ point)

    def of_triangles(self, triangles: IntArray) -> Float64Array:
        """Return the planes (k, 4) of some triangles as rows (n, d)."""
        return np.column_stack((self.normals[triangles], self.offsets[triangles]))


def kernel_center(planes: FacePlanes) -> tuple[Float64Array, float]:
    """Return the Chebyshev centre (3,) and radius of the kernel, negative where it is empty.

    Maximise R subject to n_i·x + R ≤ d_i: a linear programme in four unknowns, solved over a few planes to which the
    most violated ones are added until none is left.
    """
    counted = np.flatnonzero(np.isfinite(planes.offsets))
    normals, offsets = planes.normals[counted], planes.offsets[counted]
    active = np.unique(np.linspace(0, len(counted) - 1, min(_START, len(counted))).astype(np.int64))
    solution = np.zeros(4)
    for _ in range(_ROUNDS):
        answer = linprog(
            np.array([0.0, 0.0, 0.0, -1.0]),
            A_ub=np.column_stack((normals[active], np.ones(len(active)))),
            b_ub=offsets[active],
            bounds=[(-_BOX, _BOX)] * 3 + [(-4 * _BOX, _BOX)],
            method="highs-ds",
        )
        if answer.x is None:  # cannot be infeasible; a numerical failure leaves the last answer, judged below
            break
        solution = answer.x
        violation = normals @ solution[:3] + solution[3] - offsets
        worst = np.argpartition(-violation, min(_ADDED, len(violation) - 1))[:_ADDED]
        worst = worst[violation[worst] > _TOLERANCE]
        if worst.size == 0:
            break
        active = np.union1d(active, worst)
    center = solution[:3]
    return center, float((offsets - normals @ center).min())
