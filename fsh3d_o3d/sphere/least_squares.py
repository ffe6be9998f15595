"""Least-squares analysis: coefficients from samples where no exact quadrature weights are at hand.

Minimises Σ_j w_j (f_j − Σ_lm c_lm Y_lm(ω_j))² + λ Σ_lm (l(l+1))² c_lm² by conjugate gradients on the normal
equations. With w = 4π/n on evenly spread points their matrix is close to the identity (its eigenvalues lie in 0.95 …
1.03 on a Fibonacci grid of 4b² points), so that a handful of steps reach rounding. The second term is the bending
energy of the function, a thin-plate spline on the sphere (Wahba 1981): it fills what the samples leave open, smoothly.
"""

from __future__ import annotations

import warnings

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import FloatArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import ConvergenceWarning
from fsh3d_o3d.sphere.engines import Engine, EnginePair
from fsh3d_o3d.sphere.grids import SphericalGrid, grid_from_directions
from fsh3d_o3d.sphere.harmonics import degrees_and_orders

__all__ = ["LeastSquaresFit", "fit_coefficients"]


@value
class LeastSquaresFit:
    """Fitted coefficients and how well the normal equations are solved."""

    coefficients: FloatArray
    """(…, b²)."""
    iterations: int
    """Conjugate-gradient steps."""
    residual: float
    """Norm of the gradient over that at zero coefficients, the worst of the batch."""
    converged: bool
    """Whether ``residual`` reached the tolerance, or stopped falling at the floor that rounding sets."""


def fit_coefficients(
    values: object,
    directions: object,
    bandwidth: int,
    *,
    weights: object | None = None,
    smoothness: float = 0.0,
    tolerance: float = 1e-13,
    max_iterations: int = 1000,
    threads: int | None = None,
) -> LeastSquaresFit:
    """Fit functions of degree < b to samples at scattered directions.

    Args:
        values: (…, n) samples.
        directions: (n, 3) unit vectors, or a ``SphericalGrid``.
        bandwidth: b.
        weights: (n,) non-negative weights of the samples; scaled to sum to 4π. Equal if not given.
        smoothness: λ >= 0, the weight of the bending energy in units of the squared samples' mean: 0 for none, 1e-8 …
            1e-6 to bridge holes.
        tolerance: Relative norm of the gradient at which to stop.
        max_iterations: Most conjugate-gradient steps.
        threads: Number of threads, or None for all that the process may use.

    Raises:
        ValueError: Wrong shapes or ranges; or fewer samples than coefficients and no smoothness.

    Warns:
        ConvergenceWarning: The steps ran out: the samples leave too much open for so little smoothness.

    Example:
        >>> directions = fsh.fibonacci_grid(1000).directions
        >>> seen = directions[directions[:, 2] > -0.8]  # a hole around the south pole
        >>> fit = fsh.fit_coefficients(1 + seen[:, 0] * seen[:, 1], seen, bandwidth=4)
        >>> fit.converged, fit.coefficients.shape
        (True, (16,))
        >>> x, y = np.sqrt(0.5), -np.sqrt(0.5)
        >>> np.allclose(fsh.evaluate(fit.coefficients, [[x, y, 0], [0, 0, -1]]), [0.5, 1])
        True
    """
    b = check.bandwidth(bandwidth)
    grid = directions if isinstance(directions, SphericalGrid) else grid_from_directions(directions)
    n = len(grid)
    samples = check.values_on(values, "values", n)
    smoothness = check.number(smoothness, "smoothness", minimum=0.0)
    if n < b * b and smoothness == 0:
        raise ValueError(f"{n} samples do not determine b² = {b * b} coefficients; give a smoothness > 0")
    given = np.ones(n) if weights is None else np.asarray(check.values_on(weights, "weights", n), dtype=np.float64)
    if given.ndim != 1 or given.min() < 0 or given.sum() <= 0:
        raise ValueError(f"weights must have shape (n,) = ({n},), be non-negative and not all zero")
    flat = np.ascontiguousarray(samples.reshape(-1, n))
    engine = EnginePair(grid, b, given * (4 * np.pi / given.sum())).pick(max(8, len(flat)))
    fit = solve_least_squares(
        flat,
        engine,
        smoothness=smoothness,
        tolerance=check.number(tolerance, "tolerance", minimum=0.0, exclusive=True),
        max_iterations=check.integer(max_iterations, "max_iterations", minimum=1),
        threads=threads,
    )
    shaped = fit.coefficients.reshape(*samples.shape[:-1], b * b)
    return LeastSquaresFit(shaped, fit.iterations, fit.residual, fit.converged)


def solve_least_squares(
    values: FloatArray,
    engine: Engine,
    *,
    smoothness: float = 0.0,
    tolerance: float = 1e-13,
    max_iterations: int = 1000,
    threads: int | None = None,
) -> LeastSquaresFit:
    """Fit (batch, n) samples on an engine whose weights are those of the samples; gives (batch, b²)."""
    degree, _ = degrees_and_orders(engine.bandwidth)
    penalty = (smoothness * (degree * (degree + 1.0)) ** 2).astype(values.dtype)
    preconditioner = 1 / (1 + penalty)
    tolerance = max(tolerance, 4 * float(np.finfo(values.dtype).eps))
    # Each function in its own unit, so that squares neither overflow nor vanish.
    unit = np.abs(values).max(axis=1, keepdims=True, initial=0.0)
    unit[unit == 0] = 1
    gradient = engine.analyse(values / unit, threads)
    scale = np.linalg.norm(gradient, axis=1)
    scale[scale == 0] = 1
    coefficients = np.zeros_like(gradient)
    conditioned = preconditioner * gradient
    step = conditioned
    power = _dot(gradient, conditioned)
    floor = float(np.sqrt(np.finfo(values.dtype).eps))
    best, stalled, iterations = np.inf, 0, 0
    for iterations in range(max_iterations + 1):
        residual = float((np.linalg.norm(gradient, axis=1) / scale).max(initial=0.0))
        # Residuals rise and fall on the way; only near rounding does no progress mean that none is left.
        stalled = stalled + 1 if residual > 0.9 * best and best < floor else 0
        best = min(best, residual)
        if residual <= tolerance or stalled >= 10 or iterations == max_iterations:
            break
        image = engine.analyse(engine.synthesise(step, threads), threads) + penalty * step
        curvature = _dot(step, image)
        length = np.divide(power, curvature, out=np.zeros_like(power), where=curvature > 0)
        coefficients = coefficients + length * step
        gradient = gradient - length * image
        conditioned = preconditioner * gradient
        previous, power = power, _dot(gradient, conditioned)
        step = conditioned + np.divide(power, previous, out=np.zeros_like(power), where=previous > 0) * step
    converged = residual <= tolerance or stalled >= 10
    if not converged:
        warnings.warn(
            f"the least-squares fit stopped after {iterations} steps with a gradient of {residual:.1e} of the first: "
            f"the {len(engine.grid)} samples do not determine {engine.bandwidth**2} coefficients well; use more "
            "smoothness or a smaller bandwidth",
            ConvergenceWarning,
            stacklevel=3,
        )
    return LeastSquaresFit(coefficients * unit, iterations, residual, converged)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b)[:, None])
