"""Coefficients in the order and normalisation of e3nn.

e3nn's harmonics have y for their pole where ours have z: its degree 1 is x, y, z and ours y, z, x. Its coefficients are
those of the function turned by (x, y, z) → (z, x, y), orders −l … l, times a factor for the normalisation.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from fsh3d_o3d import _validation as check
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.coefficients import degree_of
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.rotation import rotate

__all__ = ["from_e3nn", "to_e3nn"]

Normalization = Literal["integral", "component", "norm"]


@full_precision
def to_e3nn(coefficients: Tensor, normalization: Normalization = "integral") -> Tensor:
    """Return coefficients of e3nn's harmonics, irreps 0e + 1o + 2e + …: (…, b²) → (…, b²), with gradients.

    Args:
        coefficients: (…, b²).
        normalization: e3nn's name for that of its harmonics: ``"integral"`` (orthonormal, as ours), ``"component"``
            (‖Y_l‖² = 2l + 1) or ``"norm"`` (‖Y_l‖ = 1).

    Raises:
        TypeError, ValueError: Not (…, b²) float32 or float64, not finite, or another normalisation.

    Example:
        >>> y = torch.tensor([0.0, 1, 0, 0])  # our order −1 of degree 1
        >>> ft.to_e3nn(y).round(decimals=6) + 0.0  # e3nn's order 0
        tensor([0., 0., 1., 0.])
    """
    given, b = checks.coefficients(coefficients)
    return _turned(given, inverse=False) / _factors(b, normalization, given)


@full_precision
def from_e3nn(coefficients: Tensor, normalization: Normalization = "integral") -> Tensor:
    """Return our coefficients of those of e3nn's harmonics: the inverse of ``to_e3nn``.

    Example:
        >>> coefficients = torch.rand(36)
        >>> torch.allclose(ft.from_e3nn(ft.to_e3nn(coefficients, "norm"), "norm"), coefficients, atol=1e-6)
        True
    """
    given, b = checks.coefficients(coefficients)
    return _turned(given * _factors(b, normalization, given), inverse=True)


def _turned(coefficients: Tensor, *, inverse: bool) -> Tensor:
    axes = torch.tensor([1, 2, 0] if inverse else [2, 0, 1], device=coefficients.device)
    rotation = torch.eye(3, dtype=coefficients.dtype, device=coefficients.device)[axes]
    return rotate(coefficients.reshape(1, -1, coefficients.shape[-1]), rotation[None]).reshape(coefficients.shape)


def _factors(bandwidth: int, normalization: str, like: Tensor) -> Tensor:
    """What e3nn's harmonics are times orthonormal ones, (b²,)."""
    check.choice(normalization, "normalization", ("integral", "component", "norm"))
    degree = degree_of(bandwidth, like.device).to(like.dtype)
    scale = {"integral": torch.ones_like(degree), "component": torch.full_like(degree, 4 * torch.pi).sqrt()}
    return scale.get(normalization, (4 * torch.pi / (2 * degree + 1)).sqrt())
