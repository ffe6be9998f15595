"""The rotation that takes functions on the sphere to others, from their coefficients alone."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.sphere.coefficients import degree_energies
from fsh3d_o3d.sphere.rotation.correlation import correlator
from fsh3d_o3d.sphere.rotation.rotation import parity
from fsh3d_o3d.sphere.threads import resolve_threads, run_all, single_threaded_blas

__all__ = ["RotationEstimate", "estimate_rotation", "estimate_rotations"]

_FINE_BANDWIDTH = 32  # degrees below it settle an angle far below what sampling leaves of it
_COARSE_BANDWIDTHS = (8, 12, 16, 24, 32)  # of the first search: the first with enough of the functions in it
_ENERGY_SHARE = 0.05  # that is enough, a choice: where so few degrees hold less, noise may decide
_STARTS = 12  # local maxima of the first search to follow, at least: a choice; else twice as many as are asked for
_MOST_MAXIMA = 60  # as many as the icosahedron has rotations
_STEPS = 20  # of Newton, at most; four are usual
_DISTINCT = np.radians(5.0)  # radians, a choice: maxima closer than this are one
_CONSTANT = 1e-8  # of the norm, eight digits above rounding: below it, nothing but rounding depends on direction
_BLOCK = 24  # candidates a job, a choice; fixed, so that results do not depend on the number of threads


@value
class RotationEstimate:
    """The rotation of highest correlation, and the runners-up. Arrays are read-only."""

    rotation: Float64Array
    """(3, 3): takes the source to the target; of determinant −1 where ``reflected``."""
    correlation: float
    """Σ⟨t, R s⟩ / (‖s‖ ‖t‖) over degrees >= 1, in [−1, 1]; 1 for a rotated copy."""
    reflected: bool
    """Whether the source is also reflected; only where reflections were asked for."""
    rotations: Float64Array
    """(k, 3, 3) distinct local maxima, best first: several of equal correlation for symmetric shapes."""
    correlations: Float64Array
    """(k,) their correlations."""
    curvature: Float64Array
    """(3,) how fast the correlation falls away from ``rotation``, −d²C/dω² in 1/radian² about three axes, ascending.
    The first is near 0 where the shape has an axis of revolution, all are for a sphere."""

    @property
    def margin(self) -> float:
        """Correlation of the best maximum minus that of the next; 0 for symmetric shapes, 2 where there is none."""
        return float(self.correlations[0] - self.correlations[1]) if len(self.correlations) > 1 else 2.0


def estimate_rotation(
    source: object, target: object, *, bandwidth: int | None = None, reflections: bool = False, maxima: int = 4
) -> RotationEstimate:
    """Find R that maximises the correlation Σ⟨t, R s⟩ over all rotations, summed over functions and degrees.

    An FFT on SO(3) of the low degrees gives starting points, Newton's method on the group refines them with all
    degrees (Kostelec and Rockmore, 2008, for the former). Exchanging source and target gives the inverse.

    Args:
        source: (…, b²) coefficients of the functions on the sphere that are rotated together, such as shells.
        target: (…, c²) coefficients of as many functions. Of different bandwidths the smaller counts.
        bandwidth: Only degrees < this; None: at most 32.
        reflections: Whether to look at reflected sources as well.
        maxima: At most this many distinct maxima are reported.

    Raises:
        ValueError: Different numbers of functions; functions that are constant on the sphere, which every rotation
            leaves alone; not finite.

    Example:
        >>> coefficients = np.random.default_rng(0).normal(size=64)
        >>> R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> estimate = fsh.estimate_rotation(coefficients, fsh.rotate_coefficients(coefficients, R))
        >>> np.allclose(estimate.rotation, R, atol=1e-6)
        True
        >>> print(f"{estimate.correlation:.3f}, ahead by {estimate.margin:.1f}")
        1.000, ahead by 0.4
    """
    kept = check.integer(maxima, "maxima", minimum=1, maximum=_MOST_MAXIMA)
    left, right, b = _pair(source, target, bandwidth)
    left, right = _varying(left, "source"), _varying(right, "target")
    with single_threaded_blas():
        found = [local_maxima(left, right, b, kept)]
        if reflections:
            found.append(local_maxima(left * parity(b), right, b, kept))
    sign = np.repeat((1.0, -1.0), [len(found[0][1]), sum(len(part[1]) for part in found[1:])])
    rotations, values, hessians = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(-values, kind="stable")[:kept]
    rotations = rotations[order] * sign[order, None, None]
    curvature = -np.linalg.eigvalsh(hessians[order[0]])[::-1]
    values = np.clip(values[order], -1.0, 1.0)
    for array in (rotations, values, curvature):
        array.setflags(write=False)
    return RotationEstimate(rotations[0], float(values[0]), bool(sign[order[0]] < 0), rotations, values, curvature)


def estimate_rotations(
    sources: object, target: object, *, steps: int = 3, threads: int | None = None
) -> tuple[Float64Array, Float64Array]:
    """Find for each of many sources the rotation to one target: ``estimate_rotation`` for re-ranking, in few steps.

    The highest point of a grid on SO(3) and ``steps`` of Newton's method, all degrees at once: meant for bandwidths of
    about 8. A maximum narrower than the grid's 15° may be missed.

    Args:
        sources: (n, S, b²).
        target: (S, b²).
        steps: Newton steps.
        threads: At most this many; None: what the process may use. The result does not depend on it.

    Returns:
        Rotations (n, 3, 3) that take each source to the target, and Σ⟨t, R s⟩ (n,), not normalised, over all degrees.

    Raises:
        ValueError: Wrong shapes, not finite.

    Example:
        >>> target = np.random.default_rng(0).normal(size=(2, 36))  # two shells
        >>> R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> rotations, products = fsh.estimate_rotations([target, fsh.rotate_coefficients(target, R)], target)
        >>> np.allclose(rotations, [np.eye(3), R.T], atol=1e-3)
        True
        >>> products.shape
        (2,)
    """
    right, b = check.coefficients(target, "target")
    left, _ = check.coefficients(sources, "sources")
    if right.ndim != 2 or left.ndim != 3 or left.shape[1:] != right.shape:
        raise ValueError(f"sources must have shape (n, S, b²) and target (S, b²), got {left.shape} and {right.shape}")
    check.integer(steps, "steps", minimum=0, maximum=100)
    search = correlator(b)
    rotations, values = np.empty((len(left), 3, 3)), np.empty(len(left))

    def refine(start: int) -> None:
        part = slice(start, start + _BLOCK)
        products = search.products(left[part], right)
        on_grid = search.on_grid(products).reshape(len(products), -1)
        rotations[part], values[part], _ = search.ascend(products, search.rotations[on_grid.argmax(axis=1)], steps)

    with single_threaded_blas():
        jobs = [lambda start=start: refine(start) for start in range(0, len(left), _BLOCK)]
        run_all(jobs, resolve_threads(threads))
    return rotations, values


def _pair(source: object, target: object, bandwidth: int | None) -> tuple[Float64Array, Float64Array, int]:
    left, first = check.coefficients(source, "source")
    right, second = check.coefficients(target, "target")
    if left.shape[:-1] != right.shape[:-1]:
        raise ValueError(
            f"source and target must hold the same functions, got shapes {left.shape} and {right.shape}; "
            "take the same number of shells"
        )
    b = min(first, second)
    b = min(b, _FINE_BANDWIDTH) if bandwidth is None else min(b, check.bandwidth(bandwidth))
    check.memory(1000.0 * b**3, "the correlation of all degrees")
    rows = [values[..., : b * b].reshape(-1, b * b).astype(np.float64) for values in (left, right)]
    return rows[0], rows[1], b


def _varying(rows: Float64Array, name: str) -> Float64Array:
    """The functions without their means, of unit norm together."""
    scale = np.abs(rows).max(initial=0.0)
    rows = rows / scale if scale > 0 else rows
    total = float(np.linalg.norm(rows))
    rows = np.concatenate((np.zeros((len(rows), 1)), rows[:, 1:]), axis=1)
    norm = float(np.linalg.norm(rows))
    if norm <= _CONSTANT * total:
        raise ValueError(f"{name} is constant on the sphere (or zero): every rotation leaves it alone")
    return rows / norm


def local_maxima(
    source: Float64Array, target: Float64Array, b: int, kept: int
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Distinct maxima (k, 3, 3), their correlations (k,) and Hessians (k, 3, 3), best first, of rows (S, b²)."""
    starts = max(_STARTS, 2 * kept)
    first = _first_bandwidth(source, target, b)
    search = correlator(first)
    products = search.products(source[None, :, : first**2], target[:, : first**2])
    places = search.rotations[search.peaks(search.on_grid(products), starts)[0]]
    rotations, values, hessians = search.ascend(products, places, _STEPS)
    chosen = _distinct(rotations, values, starts)
    if first < b:
        fine = correlator(b, 1)  # its grid is not used
        products = fine.products(source[None], target)
        values = fine.values(products, rotations[chosen])
        chosen = [chosen[index] for index in np.argsort(-values, kind="stable")[: kept + 1]]
        rotations, values, hessians = fine.ascend(products, rotations[chosen], _STEPS)
        chosen = _distinct(rotations, values, kept)
    chosen = chosen[:kept]
    return rotations[chosen], values[chosen], hessians[chosen]


def _first_bandwidth(source: Float64Array, target: Float64Array, b: int) -> int:
    """The smallest bandwidth of the grid that holds enough of both functions."""
    share = np.minimum(*(np.cumsum(np.sum(degree_energies(rows) ** 2, axis=0)) for rows in (source, target)))
    return next(
        (first for first in _COARSE_BANDWIDTHS if first < b and share[first - 1] >= _ENERGY_SHARE),
        min(b, _COARSE_BANDWIDTHS[-1]),
    )


def _distinct(rotations: Float64Array, values: Float64Array, count: int) -> list[int]:
    """Indices of at most ``count`` rotations that differ, best first."""
    kept: list[int] = []
    for index in np.argsort(-values, kind="stable"):  # a dozen
        trace = np.einsum("kij,ij->k", rotations[kept], rotations[index])
        if not kept or trace.max() < 1 + 2 * np.cos(_DISTINCT):
            kept.append(int(index))
        if len(kept) == count:
            break
    return kept
