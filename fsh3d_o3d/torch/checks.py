"""Checks of tensors at the public boundary: kind, precision, device, shape, and values where that is free.

Whether values are finite is asked on the CPU alone. Elsewhere the answer would have to be waited for, a hidden transfer
in every step; there it is asked while ``torch.autograd.detect_anomaly`` is on, PyTorch's own switch for such checks.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

PRECISIONS = (torch.float32, torch.float64)
"""What transforms compute in."""


def real(value: object, name: str, *, finite: bool = True) -> Tensor:
    """Return a float32 or float64 tensor.

    Raises:
        TypeError: No tensor, or of another precision.
        ValueError: NaN or infinite values, where that is checked.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(value).__name__}; torch.as_tensor makes one")
    if value.dtype not in PRECISIONS:
        raise TypeError(f"{name} must be float32 or float64, got {value.dtype}; .float() converts")
    if finite:
        require_finite(value, name)
    return value


def require_finite(value: Tensor, name: str) -> None:
    """Refuse NaN and infinite values, where asking does not stop a device or a compiler."""
    if values_are_checked(value) and not bool(torch.isfinite(value.detach().sum())):
        bad = value.numel() - int(torch.isfinite(value.detach()).sum())
        if bad:  # else finite numbers whose sum overflows
            raise ValueError(f"{name} must be finite, got {bad} NaN or infinite of {value.numel()} values")


def values_are_checked(value: Tensor) -> bool:
    """Whether the values of a tensor may be looked at: on the CPU, or when anomalies are being searched for."""
    if torch.compiler.is_compiling() or value.device.type == "meta":
        return False
    return value.device.type == "cpu" or torch.is_anomaly_enabled()


def alike(value: Tensor, name: str, other: Tensor, other_name: str) -> None:
    """Refuse two tensors of different precision or on different devices.

    Raises:
        TypeError: Different precisions.
        ValueError: Different devices.
    """
    if value.dtype != other.dtype:
        raise TypeError(f"{name} are {value.dtype} and {other_name} {other.dtype}: convert one with .to(dtype)")
    if value.device != other.device:
        raise ValueError(f"{name} are on {value.device} and {other_name} on {other.device}: move one with .to(device)")


def last_axis(value: Tensor, name: str, count: int, symbol: str) -> None:
    """Refuse a tensor whose last axis is not of this length."""
    if value.ndim == 0 or value.shape[-1] != count:
        raise ValueError(f"{name} must have shape (…, {symbol}) = (…, {count}), got {tuple(value.shape)}")


def coefficients(value: object, name: str = "coefficients") -> tuple[Tensor, int]:
    """Return a (…, b²) tensor and b."""
    tensor = real(value, name)
    size = tensor.shape[-1] if tensor.ndim else 0
    b = math.isqrt(size)
    if size == 0 or b * b != size:
        raise ValueError(
            f"{name} must have shape (…, b²) with a square number of coefficients last, got {tuple(tensor.shape)}"
        )
    return tensor, b


def unit_vectors(value: object, name: str = "directions") -> Tensor:
    """Return (…, m, 3) vectors at length one; what they point at counts, not how long they are.

    Raises:
        ValueError: Another shape, or a vector of length zero, where values are checked.
    """
    vectors = real(value, name)
    if vectors.ndim < 2 or vectors.shape[-1] != 3:
        raise ValueError(f"{name} must have shape (…, m, 3), got {tuple(vectors.shape)}")
    length = torch.linalg.vector_norm(vectors, dim=-1, keepdim=True)
    if values_are_checked(length) and bool((length == 0).any()):
        raise ValueError(f"{name} must point somewhere, but {int((length == 0).sum())} vectors are zero")
    return vectors / length


def rotations(value: object, name: str = "rotation") -> Tensor:
    """Return (…, 3, 3) rotations: orthogonal to 1e-4 in float32, 1e-6 in float64, of determinant +1."""
    matrix = real(value, name)
    if matrix.ndim < 2 or matrix.shape[-2:] != (3, 3):
        raise ValueError(f"{name} must have shape (…, 3, 3), got {tuple(matrix.shape)}")
    if values_are_checked(matrix) and matrix.numel():
        own = matrix.detach()
        error = float((own @ own.mT - torch.eye(3, dtype=own.dtype, device=own.device)).abs().max())
        # As the NumPy layer in float64; in float32 a product of a few rotations is off by its rounding.
        if error > (1e-6 if own.dtype == torch.float64 else 1e-4):
            raise ValueError(f"{name} must be a rotation matrix, but R Rᵀ differs from the identity by {error:.3g}")
        if bool((torch.linalg.det(own) < 0).any()):
            raise ValueError(f"{name} must be a rotation matrix, got a reflection (determinant −1)")
    return matrix
