"""Rotation invariants of several functions on the sphere together, with gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from fsh3d_o3d import _validation as check
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.coefficients import by_degree
from fsh3d_o3d.torch.matrix_powers import gram_power
from fsh3d_o3d.torch.precision import full_precision

__all__ = ["cross_shell_invariants"]


@full_precision
def cross_shell_invariants(coefficients: Tensor, power: float = 0.25, epsilon: float = 0.01) -> Tensor:
    """Return fractional powers of the Gram matrices of R functions: (…, R, b²) → (…, b, R(R+1)/2).

    G_l = X_l X_lᵀ holds the inner products of the functions' parts of degree l; rotations leave it. A row a degree: the
    upper triangle of (G_l + ε²)^p − ε^2p, row by row, with √2 off the diagonal, so that its norm is the matrix's. It is
    what ``SHDOption.best()`` compares shapes by. The gradient stays bounded where singular values repeat or vanish, as
    long as ε > 0; it cannot be differentiated again.

    Args:
        coefficients: (…, R, b²) of functions that are rotated together, such as shells.
        power: p, positive.
        epsilon: ε, in the units of the coefficients: smaller singular values are damped.

    Raises:
        TypeError, ValueError: Not (…, R, b²) float32 or float64, not finite, or options out of range.

    Example:
        >>> shells = torch.rand(8, 4, 36, requires_grad=True)  # eight shapes of four shells
        >>> invariants = ft.cross_shell_invariants(shells)
        >>> invariants.shape
        torch.Size([8, 6, 10])
        >>> invariants.sum().backward()
    """
    given, _ = checks.coefficients(coefficients)
    if given.ndim < 2:
        raise ValueError(f"coefficients must have shape (…, R, b²), got {tuple(given.shape)}")
    exponent = check.number(power, "power", minimum=0, exclusive=True)
    damping = check.number(epsilon, "epsilon", minimum=0)
    count = given.shape[-2]
    root = gram_power(by_degree(given).transpose(-2, -3), exponent, damping)
    first, second = torch.triu_indices(count, count, device=given.device)
    twice = 2 - (first == second).to(given.dtype)  # off the diagonal each entry stands for two
    return root[..., first, second] * twice.sqrt()
