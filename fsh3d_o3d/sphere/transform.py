"""The spherical harmonic transform on a grid: plan once, transform many times."""

from __future__ import annotations

import functools
import math
from typing import Any, Literal

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, FloatArray
from fsh3d_o3d._value import value
from fsh3d_o3d.sphere.engines import EngineName, EnginePair
from fsh3d_o3d.sphere.grids import SphericalGrid, fibonacci_grid, grid_from_directions, grid_size, require_grid
from fsh3d_o3d.sphere.least_squares import solve_least_squares
from fsh3d_o3d.sphere.nufft_engine import synthesise_gradient
from fsh3d_o3d.sphere.weight_solution import WeightSolution
from fsh3d_o3d.sphere.weight_solver import solve_weights, warn_if_inexact

__all__ = ["SphericalHarmonicTransform", "evaluate", "evaluate_gradient"]

Analysis = Literal["quadrature", "least_squares"]


@value
class SphericalHarmonicTransform:
    """A plan for transforms between n samples on a grid and the b² coefficients of degree < b.

    ``forward`` is quadrature, f̂ = Σ_j w_j f(ω_j) Y(ω_j) (Eq. 12 in our normalisation), exact for functions of degree
    < b when the weights meet Eq. (8). With ``analysis="least_squares"`` it is the least-squares fit instead, exact
    for them on any grid that determines them; the weights only precondition it. ``inverse`` is synthesis. A plan may
    be used from several threads.

    Args:
        bandwidth: b; degrees 0 … b − 1.
        grid: Where functions are sampled; the Fibonacci grid of 6b² points if not given.
        weights: (n,) quadrature weights summing to 4π, or a ``WeightSolution``; the analytic weights if not given
            (equal weights for least squares).
        engine: ``"dense"`` (matrices, exact to rounding), ``"nufft"`` (fast transforms, 1e-13), or ``"auto"``: by size.
        analysis: ``"quadrature"`` or ``"least_squares"``.
        oversampling: Instead of a grid: the number of Fibonacci points in units of 4b², at least 1. The default is 1.5;
            from 1.43 on the weights are well conditioned.
        threads: Number of threads, or None for all that the process may use. Does not change results.

    Raises:
        TypeError, ValueError: An argument is of the wrong type, out of range, or of the wrong shape.
        MemoryEstimateError: The transform would not fit in memory.

    Example:
        >>> transform = fsh.SphericalHarmonicTransform(bandwidth=16)
        >>> x, y, z = transform.grid.directions.T
        >>> coefficients = transform.forward(x * y + z)
        >>> len(x), len(coefficients)
        (1536, 256)
        >>> print(fsh.degree_energies(coefficients)[:4].round(3))  # z is of degree 1, x y of degree 2
        [0.    2.047 0.915 0.   ]
        >>> np.allclose(transform.inverse(coefficients), x * y + z)
        True
    """

    bandwidth: int
    """b: degrees 0 … b − 1."""
    grid: SphericalGrid
    """Where functions are sampled."""
    weights: Float64Array
    """(n,) quadrature weights, read-only."""
    engine: EngineName
    """As given."""
    analysis: Analysis
    """What ``forward`` does."""
    threads: int | None
    """At most so many; None: all that the process may use."""

    def __init__(
        self,
        bandwidth: int,
        grid: SphericalGrid | None = None,
        weights: object | None = None,
        engine: EngineName = "auto",
        *,
        analysis: Analysis = "quadrature",
        oversampling: float | None = None,
        threads: int | None = None,
    ) -> None:
        b = check.bandwidth(bandwidth)
        if grid is not None:
            require_grid(grid)
        check.choice(analysis, "analysis", ("quadrature", "least_squares"))
        threads = None if threads is None else check.integer(threads, "threads", minimum=1, maximum=1024)
        if grid is not None and oversampling is not None:
            raise ValueError("give a grid or an oversampling, not both")
        if grid is None:
            size = grid_size(b, oversampling)
            check.memory(200.0 * size, f"a transform of bandwidth {b} on {size} points")
            grid = fibonacci_grid(size)
        if weights is None and analysis == "least_squares":
            weights = np.full(len(grid), 4 * np.pi / len(grid))
        elif weights is None:
            weights = solve_weights(grid, b, threads=threads)
            warn_if_inexact(weights, grid, stacklevel=3)
        if isinstance(weights, WeightSolution):
            weights = weights.weights
        own = np.array(check.values_on(weights, "weights", len(grid)), dtype=np.float64)
        if own.ndim != 1:
            raise ValueError(f"weights must have shape (n,) = ({len(grid)},), got {own.shape}")
        own.setflags(write=False)
        vars(self).update(bandwidth=b, grid=grid, weights=own, engine=engine, analysis=analysis, threads=threads)
        _ = self._engines  # checks its part

    @functools.cached_property
    def _engines(self) -> EnginePair:
        return EnginePair(self.grid, self.bandwidth, self.weights, self.engine)

    def forward(self, values: object) -> FloatArray:
        """Return the coefficients of sampled functions: (…, n) → (…, b²).

        Args:
            values: (…, n) samples in the order of the grid. float32 stays float32; all else becomes float64.

        Raises:
            ValueError: Wrong last axis, or values that are not finite.
        """
        samples = check.values_on(values, "values", len(self.grid))
        flat = np.ascontiguousarray(samples.reshape(_leading(samples), len(self.grid)))
        engine = self._engines.pick(len(flat))
        if self.analysis == "least_squares":
            result = solve_least_squares(flat, engine, threads=self.threads).coefficients
        else:
            result = engine.analyse(flat, self.threads)
        return result.reshape(*samples.shape[:-1], self.bandwidth**2)

    def inverse(self, coefficients: object) -> FloatArray:
        """Return the functions of given coefficients at the grid's points: (…, b²) → (…, n).

        Fewer coefficients than b² are a function of smaller bandwidth; more are an error (see ``truncate``).

        Raises:
            ValueError: The last axis is not a square number, is more than b², or values are not finite.
        """
        given, b = check.coefficients(coefficients)
        if b > self.bandwidth:
            raise ValueError(
                f"coefficients are of bandwidth {b}, the transform of {self.bandwidth}; truncate them first"
            )
        flat = np.zeros((_leading(given), self.bandwidth**2), dtype=given.dtype)
        flat[:, : b * b] = given.reshape(len(flat), b * b)
        return self._engines.pick(len(flat)).synthesise(flat, self.threads).reshape(*given.shape[:-1], len(self.grid))


def evaluate(coefficients: object, directions: object, *, threads: int | None = None) -> FloatArray:
    """Evaluate functions at any directions: (…, b²), (m, 3) → (…, m).

    Args:
        coefficients: (…, b²) real coefficients, float32 or float64.
        directions: (m, 3) unit vectors, or a ``SphericalGrid``.
        threads: Number of threads, or None for all that the process may use. Does not change the result.

    Raises:
        ValueError: Wrong shapes, values that are not finite, or directions that are not unit vectors.

    Example:
        >>> coefficients = np.zeros(16)
        >>> coefficients[2] = np.sqrt(4 * np.pi / 3)  # degree 1, order 0: the function z
        >>> np.allclose(fsh.evaluate(coefficients, np.eye(3)), [0, 0, 1])
        True
        >>> fsh.evaluate([coefficients, -coefficients], fsh.fibonacci_grid(100)).shape
        (2, 100)
    """
    given, b = check.coefficients(coefficients)
    check.bandwidth(b)
    grid = _as_grid(directions)
    flat = np.ascontiguousarray(given.reshape(_leading(given), b * b))
    engine = EnginePair(grid, b).pick(len(flat))
    return engine.synthesise(flat, threads).reshape(*given.shape[:-1], len(grid))


def evaluate_gradient(coefficients: object, directions: object) -> Float64Array:
    """Evaluate the gradient on the unit sphere of one function: (b²,), (m, 3) → (m, 3), tangent to the sphere.

    Raises:
        ValueError: Wrong shapes, values that are not finite, or directions that are not unit vectors.

    Example:
        >>> coefficients = np.zeros(16)
        >>> coefficients[2] = np.sqrt(4 * np.pi / 3)  # the function z
        >>> np.allclose(fsh.evaluate_gradient(coefficients, np.eye(3)), [[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        True
    """
    given, b = check.coefficients(coefficients)
    if given.ndim != 1:
        raise ValueError(f"coefficients must have shape (b²,), got {given.shape}")
    grid = _as_grid(directions)
    southward, eastward = synthesise_gradient(given, b, grid)
    cos_t, sin_t = np.cos(grid.colatitude), np.sin(grid.colatitude)
    cos_p, sin_p = np.cos(grid.longitude), np.sin(grid.longitude)
    south = np.stack([cos_t * cos_p, cos_t * sin_p, -sin_t], axis=1)
    east = np.stack([-sin_p, cos_p, np.zeros_like(sin_p)], axis=1)
    return np.asarray(southward[:, None] * south + eastward[:, None] * east, dtype=np.float64)


def _as_grid(directions: object) -> SphericalGrid:
    return directions if isinstance(directions, SphericalGrid) else grid_from_directions(directions)


def _leading(array: np.ndarray[Any, Any]) -> int:
    """Number of functions in (…, n): the product of the leading axes, 1 where there are none."""
    return math.prod(array.shape[:-1])
