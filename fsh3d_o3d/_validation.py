"""Checks at the public boundary: which argument, what was expected, what was given, what to do."""

from __future__ import annotations

import math
import operator
from typing import Any, SupportsIndex, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.errors import MemoryEstimateError

FloatArray = NDArray[np.floating[Any]]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

MAXIMUM_BANDWIDTH = 4096  # a choice: a transform on 6b² points takes 12 GB there, near the limit below
_LONGEST_SECONDS = 1e7  # four months; timers take some hundred years
_LARGEST_MEMORY_LIMIT = 2**60  # bytes, an exbibyte; limits take 2⁶³, to which what is in use already is added
_DEFAULT_MEMORY_LIMIT = 16 * 2**30  # bytes of one temporary, a choice: what a desktop has
_NEGLIGIBLE_MEMORY = 2**26  # bytes, a choice: asking what is free takes longer than some transforms


def unmasked(value: object, name: str) -> Any:
    """Return ``value``, a masked array without masked values as the array it is.

    Raises:
        ValueError: Some are masked: NumPy's functions would take the numbers under the mask for values.
    """
    if isinstance(value, np.ma.MaskedArray):
        masked = int(np.count_nonzero(np.ma.getmaskarray(value)))
        if masked:
            raise ValueError(
                f"{name} must not be masked, but {masked} of {value.size} values are: give them values with "
                ".filled(…), or leave them out, of a single axis with .compressed()"
            )
        return value.data
    if isinstance(value, (list, tuple)):
        for part in value:
            unmasked(part, name)
    return value


def integer(value: object, name: str, *, minimum: int, maximum: int | None = None) -> int:
    """Return ``value`` as an int within [minimum, maximum]; bools and floats are refused."""
    value = unmasked(value, name)
    if isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    try:
        number = operator.index(cast(SupportsIndex, value))
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {type(value).__name__} {value!r}") from None
    if number < minimum or (maximum is not None and number > maximum):
        bounds = f"at least {minimum}" if maximum is None else f"between {minimum} and {maximum}"
        raise ValueError(f"{name} must be {bounds}, got {number}")
    return number


def bandwidth(value: object, name: str = "bandwidth") -> int:
    """Return a bandwidth: degrees 0 … bandwidth − 1."""
    return integer(value, name, minimum=1, maximum=MAXIMUM_BANDWIDTH)


def number(
    value: object, name: str, *, minimum: float = -np.inf, maximum: float = np.inf, exclusive: bool = False
) -> float:
    """Return ``value`` as a finite float within the bounds (``exclusive`` leaves the minimum out)."""
    value = unmasked(value, name)
    try:
        result = float(cast(Any, value))
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, got {type(value).__name__} {value!r}") from None
    if not math.isfinite(result):
        raise ValueError(f"{name} must be finite, got {result}")
    if result < minimum or result > maximum or (exclusive and result <= minimum):
        sign = ">" if exclusive else ">="
        upper = "" if maximum == np.inf else f" and <= {maximum:g}"
        raise ValueError(f"{name} must be {sign} {minimum:g}{upper}, got {result:g}")
    return result


def seconds(value: object, name: str) -> float:
    """Return a limit of time: positive, and no more than the clocks and timers of the system take."""
    return number(value, name, minimum=0, maximum=_LONGEST_SECONDS, exclusive=True)


def memory_limit(value: object, name: str) -> int:
    """Return a limit of memory in bytes: at least 1 MiB, and no more than the system can be told."""
    return integer(value, name, minimum=2**20, maximum=_LARGEST_MEMORY_LIMIT)


def choice(value: object, name: str, choices: tuple[str, ...]) -> str:
    """Return ``value`` if it is one of ``choices``."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")
    return value


def real_array(value: object, name: str, *, finite: bool = True) -> FloatArray:
    """Return ``value`` as a float32 or float64 array; everything else real becomes float64."""
    array = np.asarray(unmasked(value, name))
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be an array of real numbers, got dtype {array.dtype}")
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    if finite and not _all_finite(array):
        bad = int(array.size - np.count_nonzero(np.isfinite(array)))
        raise ValueError(f"{name} must be finite, got {bad} NaN or infinite of {array.size} values")
    return cast(FloatArray, array)


def _all_finite(array: FloatArray) -> bool:
    """Whether no value is NaN or infinite; the sum tells in one pass, unless it overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum())) or bool(np.isfinite(array).all())


def values_on(value: object, name: str, count: int, symbol: str = "n") -> FloatArray:
    """Return a (…, count) array of finite reals."""
    array = real_array(value, name)
    if array.ndim == 0 or array.shape[-1] != count:
        raise ValueError(f"{name} must have shape (…, {symbol}) = (…, {count}), got {array.shape}")
    return array


def vectors(value: object, name: str, *, minimum: int = 1, finite: bool = True) -> Float64Array:
    """Return an (n, 3) float64 array."""
    array = real_array(value, name, finite=finite)
    if array.ndim != 2 or array.shape[1] != 3 or array.shape[0] < minimum:
        raise ValueError(f"{name} must have shape (n, 3) with n >= {minimum}, got {array.shape}")
    return np.ascontiguousarray(array, dtype=np.float64)


def point(value: object, name: str) -> Float64Array:
    """Return a (3,) float64 array."""
    array = real_array(value, name)
    if array.shape != (3,):
        raise ValueError(f"{name} must have shape (3,), got {array.shape}")
    return np.array(array, dtype=np.float64)


def directions(value: object, name: str = "directions") -> Float64Array:
    """Return an (n, 3) float64 array of unit vectors; lengths off by more than 1e-6 are refused."""
    array = vectors(value, name)
    length = np.linalg.norm(np.clip(array, -1e100, 1e100), axis=1)  # clipped: a square must not overflow
    worst = float(np.abs(length - 1).max())
    if worst > 1e-6:
        raise ValueError(
            f"{name} must be unit vectors (n, 3), but lengths lie in [{length.min():g}, {length.max():g}]; "
            "divide by the norm first"
        )
    return cast(Float64Array, array / length[:, None])


def coefficients(value: object, name: str = "coefficients") -> tuple[FloatArray, int]:
    """Return a (…, b²) array and b."""
    array = real_array(value, name)
    size = array.shape[-1] if array.ndim else 0
    b = int(np.sqrt(size) + 0.5)
    if size == 0 or b * b != size:
        raise ValueError(f"{name} must have shape (…, b²) with a square number of coefficients last, got {array.shape}")
    return array, b


def rotation(value: object, name: str = "rotation") -> Float64Array:
    """Return the rotation nearest to a (3, 3) matrix that is orthogonal to 1e-6 and of determinant +1."""
    array = real_array(value, name)
    if array.shape != (3, 3):
        raise ValueError(f"{name} must have shape (3, 3), got {array.shape}")
    matrix = np.clip(np.asarray(array, dtype=np.float64), -1e3, 1e3)  # clipped: a square must not overflow
    error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if error > 1e-6:
        raise ValueError(f"{name} must be a rotation matrix, but R Rᵀ differs from the identity by {error:.3g}")
    if np.linalg.det(matrix) < 0:
        raise ValueError(f"{name} must be a rotation matrix, got a reflection (determinant −1)")
    left, _, right = np.linalg.svd(matrix)
    return cast(Float64Array, left @ right)


def memory(estimate: float, what: str, limit: float = _DEFAULT_MEMORY_LIMIT) -> None:
    """Refuse a request whose estimated memory in bytes exceeds ``limit`` or most of what the machine has free."""
    if estimate < _NEGLIGIBLE_MEMORY:
        return
    limit = min(limit, 0.8 * _available_memory())
    if estimate > limit:
        raise MemoryEstimateError(
            f"{what} needs about {estimate / 2**30:.1f} GiB, more than the {limit / 2**30:.1f} GiB allowed here"
        )


def _available_memory() -> float:
    try:
        with open("/proc/meminfo", encoding="ascii") as file:  # noqa: PTH123 - a device, not a path
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024.0 * int(line.split()[1])
    except OSError:
        pass
    return float("inf")
