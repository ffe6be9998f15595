"""The distance of functions on the sphere at their best rotation."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere.coefficients import degree_energies
from fsh3d_o3d.sphere.rotation.rotation_search import estimate_rotation

__all__ = ["aligned_distance"]


def aligned_distance(first: object, second: object, *, bandwidth: int = 8, reflections: bool = False) -> float:
    """Return the L2 distance of two sets of functions, one of them rotated to be as near as it can be.

    √(‖a‖² + ‖b‖² − 2 max_R ⟨a, R b⟩) over degrees < ``bandwidth``, and the distance of the degrees' norms for the
    rest, which no rotation can be below. Symmetric, and 0 for rotated copies, to rounding (1e-8 of the norms).

    Args:
        first: (…, b²) coefficients, such as those of shells, rotated together.
        second: (…, b²), of the same shape.
        bandwidth: Degrees below this are aligned.
        reflections: Whether mirror images count as alike.

    Raises:
        ValueError: Different shapes, or not finite.

    Example:
        >>> coefficients = np.random.default_rng(0).normal(size=64)
        >>> turned = fsh.rotate_coefficients(coefficients, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> print(f"{np.linalg.norm(turned - coefficients):.1f}, {fsh.aligned_distance(turned, coefficients):.1f}")
        10.3, 0.0
    """
    (left, b), (right, other) = (
        check.coefficients(rows, name) for rows, name in ((first, "first"), (second, "second"))
    )
    if left.shape != right.shape or b != other:
        raise ValueError(f"first and second must have the same shape (…, b²), got {left.shape} and {right.shape}")
    kept = min(b, check.bandwidth(bandwidth))
    rows = [values.reshape(-1, b * b).astype(np.float64) for values in (left, right)]
    means, varying, rest = zip(*(_parts(values, kept) for values in rows), strict=True)
    sizes = [float(np.linalg.norm(values)) for values in varying]
    distance = float(((means[0] - means[1]) ** 2).sum() + ((rest[0] - rest[1]) ** 2).sum())
    inner = 0.0
    if _depends_on_direction(sizes[0], means[0]) and _depends_on_direction(sizes[1], means[1]):
        found = estimate_rotation(rows[1][:, : kept**2], rows[0][:, : kept**2], bandwidth=kept, reflections=reflections)
        inner = found.correlation * sizes[0] * sizes[1]
    distance += sizes[0] ** 2 + sizes[1] ** 2 - 2 * inner
    return float(np.sqrt(max(distance, 0.0)))


def _parts(rows: Float64Array, kept: int) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Degree 0, the other degrees to align, and the norms of the rest."""
    return rows[:, 0], rows[:, 1 : kept**2], np.asarray(degree_energies(rows)[:, kept:], dtype=np.float64)


def _depends_on_direction(size: float, means: Float64Array) -> bool:
    """Whether anything but rounding depends on direction."""
    return size > 1e-7 * float(np.hypot(size, np.linalg.norm(means)))
