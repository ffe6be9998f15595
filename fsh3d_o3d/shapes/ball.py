"""A function in a ball from its harmonics on concentric spheres.

Along the radius each coefficient is a cubic spline. A function that is smooth at the centre has f_lm(r) ~ r^l there, so
that f_lm(−r) = (−1)^l f_lm(r), and f_lm(0) = 0 unless l = 0. Both are built into the spline, which runs through the
centre to the other side: no boundary condition is needed there, and all directions agree on the value at the centre.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import solve_banded

from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d.sphere import NufftEngine, degrees_and_orders, grid_from_directions, resolve_threads, run_all

_TINY = 1e-300  # in the units of the points; nearer to the centre a point has no direction


class BallFunction:
    """f(rω) = Σ_lm f_lm(r) Y_lm(ω) for r up to the last of the radii h, 2h, … Sh, and constant beyond along each ray.

    Evaluated in float32, some 1e-6 of the largest value.
    """

    def __init__(self, coefficients: Float64Array, spacing: float) -> None:
        self._spacing = spacing
        self._nodes = _spline(coefficients).astype(np.float32)

    def __call__(self, points: Float64Array, *, threads: int | None = None) -> Float64Array:
        """Return f at points (n, 3), (n,)."""
        last = len(self._nodes) - 3
        radius = np.linalg.norm(points, axis=1)
        place = np.minimum(radius / self._spacing, last)
        order = np.argsort(place, kind="stable")
        place, radius = place[order], radius[order]
        directions = points[order] / np.maximum(radius, _TINY)[:, None]
        directions[radius <= _TINY] = (0.0, 0.0, 1.0)  # all directions are the same there
        bandwidth = int(np.sqrt(self._nodes.shape[1]) + 0.5)

        def share(number: int, low: int, high: int) -> FloatArray:
            """What a node adds to the points of its slice."""
            apart = np.abs(place[low:high] - (number - 1))
            bump = np.where(apart < 1, 2 / 3 - apart**2 + apart**3 / 2, np.maximum(2 - apart, 0) ** 3 / 6)
            engine = NufftEngine(grid_from_directions(directions[low:high]), bandwidth)
            return np.asarray(bump * engine.synthesise(self._nodes[number : number + 1], 1)[0])

        # Four nodes reach each point. Points are sorted by radius, so each node's are one slice.
        numbers = np.arange(len(self._nodes))
        lows, highs = np.searchsorted(place, numbers - 3), np.searchsorted(place, numbers + 1)
        used = [(int(n), int(lows[n]), int(highs[n])) for n in numbers if lows[n] < highs[n]]
        values = np.zeros(len(points))
        shares = run_all([functools.partial(share, *one) for one in used], resolve_threads(threads))
        for (_, low, high), part in zip(used, shares, strict=True):
            values[low:high] += part
        result = np.empty_like(values)
        result[order] = values
        return result


def _spline(coefficients: Float64Array) -> Float64Array:
    """B-spline coefficients (S + 3, b²) at the nodes −1, 0, … S + 1 through (S, b²) values at the nodes 1 … S."""
    shells, size = coefficients.shape
    degree = degrees_and_orders(int(np.sqrt(size) + 0.5))[0]
    values = np.zeros((shells + 2, size))
    values[1:-1] = coefficients
    # An even function through three nodes to either side gives the value at the centre to sixth order.
    values[0, 0] = (np.array([15.0, -6.0, 1.0]) / 10) @ coefficients[:3, 0]
    nodes = np.empty((shells + 3, size))
    for parity in (0, 1):
        own = degree % 2 == parity
        nodes[1:, own] = solve_banded((2, 1), _bands(shells, parity), values[:, own])
        nodes[0, own] = nodes[2, own] if parity == 0 else -nodes[2, own]
    return nodes


@functools.cache
def _bands(shells: int, parity: int) -> Float64Array:
    """The interpolation conditions for the nodes 0 … S + 1, as the bands of a matrix (two below, one above)."""
    bands = np.zeros((4, shells + 2))  # row 1 + i − j holds entry (i, j)
    bands[0, 2:] = bands[2, :-2] = 1 / 6
    bands[1, 1:-1] = 4 / 6
    # The centre: the node across it mirrors the first one, with the sign of the parity.
    bands[1, 0], bands[0, 1] = (4 / 6, 2 / 6) if parity == 0 else (1.0, 0.0)
    # The last node continues straight on: no second difference at the last shell.
    bands[1, -1], bands[2, -2], bands[3, -3] = 1.0, -2.0, 1.0
    return bands
