"""The analytic weights of a grid, and how well they meet the conditions."""

from __future__ import annotations

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value

__all__ = ["WeightSolution"]


@value
class WeightSolution:
    """Quadrature weights and how well they meet Eq. (8)."""

    weights: Float64Array
    """(n,) read-only; their sum is 4π to ``residual``."""
    bandwidth: int
    """b: the conditions are those of degrees below 2b."""
    residual: float
    """max |ŝ(l, m) − e₀| over l < 2b, ŝ = A w / √4π normalised as in Eq. (8): ŝ(0, 0) = 1, all others 0."""
    iterations: int
    """Conjugate-gradient steps; 0 where a factorisation solved the system."""
    minimum: float
    """Smallest weight."""
    maximum: float
    """Largest weight."""
    negative: int
    """Number of negative weights."""
    converged: bool
    """Whether Eq. (8) holds: ``residual`` <= 1e-10."""
