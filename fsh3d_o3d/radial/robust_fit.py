"""Robust least squares for radial functions: scale, weights, prior and solver.

Minimises Σ_j w_j (r_j − Σ_lm c_lm Y_lm(ω_j))² + Σ_lm p_l c_lm², with Tukey's biweight w_j renewed between solves
(iteratively reweighted least squares; Beaton and Tukey 1974) and p_l = λ(l(l+1))², the bending energy of a thin-plate
spline on the sphere (Wahba 1981). Sums over points go by the fast transform, also at small bandwidths: each grid here
serves a few transforms only, too few for matrices to pay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg
from scipy.special import erf

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere import NufftEngine, degrees_and_orders

TUKEY = 6.5
"""Tukey's constant: residuals beyond so many sigma have no weight; 98.6 % efficient for Gaussian noise."""

_TAIL_CUT = 2.5  # sigma at which the scale estimate cuts the tails off: 98.8 % of a Gaussian is within
_SMALLEST_PENALTY = 1e-13  # λ of the bending energy; takes a tenth of degree 1024, where (l(l+1))² is 1e12
_LARGEST_PENALTY = 1e-2  # the same; takes more than half of degree 3: what is left is a sphere, moved and stretched
_MOST_STEPS = 120  # of conjugate gradients, a bound: 10 to 16 were taken without a hole in the cloud, 40 with one
_POWERS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # q of (l(l+1))^q to choose from; 2 is the bending energy


@dataclass(frozen=True, eq=False)
class Correction:
    """A solution of the normal equations."""

    coefficients: Float64Array
    """(b²,)."""
    steps: int
    """Conjugate-gradient steps."""
    converged: bool
    """Whether the gradient fell below the tolerance."""


def robust_scale(residuals: Float64Array, floor: float) -> float:
    """Return the standard deviation of the Gaussian core of (n,) residuals about zero, at least ``floor``.

    Starts from the median of the absolute values and then, since outliers inflate that, repeats the standard deviation
    of what lies within 2.5 sigma, corrected for the tails cut off.
    """
    square = np.square(residuals)
    scale = max(floor, 1.4826 * float(np.sqrt(np.median(square))))
    # Variance of a standard normal cut at ±k.
    cut = _TAIL_CUT
    kept = 1 - cut * np.sqrt(2 / np.pi) * np.exp(-(cut**2) / 2) / erf(cut / np.sqrt(2))
    # Heavy tails could shrink the core without end: never below half of what the median says.
    least = max(floor, 0.5 * scale)
    for _ in range(8):
        core = square[square <= (cut * scale) ** 2]
        renewed = max(least, float(np.sqrt(core.sum() / (max(1, len(core)) * kept))))
        settled = abs(renewed - scale) <= 0.01 * scale
        scale = renewed
        if settled:
            break
    return scale


def tukey(residuals: Float64Array, scale: float) -> Float64Array:
    """Return Tukey's biweight (1 − (x / 6.5σ)²)², 0 beyond."""
    inner = 1 - np.square(residuals / (TUKEY * scale))
    np.maximum(inner, 0, out=inner)
    return np.asarray(np.square(inner, out=inner))


def bending(bandwidth: int) -> Float64Array:
    """Return (b²,) (l(l+1))²."""
    degree, _ = degrees_and_orders(bandwidth)
    return np.asarray(np.square(degree * (degree + 1.0)))


def likely_penalty(coefficients: Float64Array, bandwidth: int, variance: float) -> tuple[float, Float64Array]:
    """Return the smoothness λ and penalty under which unsmoothed coefficients are most likely (empirical Bayes).

    They are modelled as independent Gaussians of variance T (l(l+1))^−q + s², the second from noise. The likelihood is
    greatest for one T and one q of a few, and the penalty λ(l(l+1))^q with λ = s²/T makes the fit the posterior mean;
    q = 2 is the bending energy, rougher functions have less.

    Args:
        coefficients: (b²,).
        bandwidth: b.
        variance: s² of a coefficient without smoothing.

    Returns:
        λ and the (b²,) penalty.
    """
    root = np.sqrt(bending(bandwidth))
    if bandwidth < 2:
        return 0.0, np.zeros(1)
    # One row a degree: the coefficients of a degree share their variance.
    degree = np.arange(1, bandwidth)
    own = np.sqrt(root[degree**2] ** 2)
    energy = np.add.reduceat(np.square(coefficients), degree**2) / max(variance, 1e-300)
    strength = np.geomspace(_SMALLEST_PENALTY, _LARGEST_PENALTY, 111)
    best, chosen = np.inf, (0.0, np.zeros(bandwidth**2))
    for power in _POWERS:
        # The weakest penalty of every power is the same at the highest degree.
        scaled = strength * (own[-1] ** 2 + 1) / own[-1] ** power
        expected = 1 + 1 / (scaled[:, None] * own**power)
        cost = ((2 * degree + 1) * np.log(expected) + energy / expected).sum(axis=1)
        place = int(cost.argmin())
        if cost[place] < best:
            best, chosen = cost[place], (float(scaled[place]), scaled[place] * root**power)
    return chosen


def solve(
    start: Float64Array,
    gradient: Float64Array,
    engine: NufftEngine,
    penalty: Float64Array,
    *,
    tolerance: float,
    threads: int | None = None,
) -> Correction:
    """Improve coefficients by a step of Newton's method, found by conjugate gradients.

    The Hessian is only a model: the harmonics' inner products under the engine's weights, which may be those of cells
    that stand for many samples, plus the penalty. Steps repeated with exact gradients still end at the exact minimum.

    Args:
        start: (b²,) coefficients.
        gradient: (b²,) Yᵀ(w r) of the residuals r at ``start``, without the penalty's part; w sums to 4π.
        engine: Where the Hessian's samples are, with weights summing to 4π.
        penalty: (b²,) weight of each coefficient's square.
        tolerance: Norm of the preconditioned gradient at which to stop.
        threads: Number of threads, or None for all that the process may use.
    """
    # SciPy stops by the norm of the gradient as it stands; split to both sides, the preconditioner is in it.
    root = 1 / np.sqrt(1 + penalty)
    steps: list[Float64Array] = []

    def curvature(step: Float64Array) -> Float64Array:
        scaled = root * step
        return np.asarray(
            root * (engine.analyse(engine.synthesise(scaled[None], threads), threads)[0] + penalty * scaled)
        )

    hessian = LinearOperator((len(start), len(start)), matvec=curvature, dtype=np.float64)
    right = root * (gradient - penalty * start)
    step, failed = cg(hessian, right, rtol=0.0, atol=tolerance, maxiter=_MOST_STEPS, callback=steps.append)
    return Correction(start + root * step, len(steps), not failed)
