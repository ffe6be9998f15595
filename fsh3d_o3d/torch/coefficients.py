"""What is done to coefficients degree by degree, with gradients: energies and filters."""

from __future__ import annotations

import torch
from torch import Tensor

from fsh3d_o3d import _validation as check
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.precision import full_precision

__all__ = ["degree_energies", "filter_coefficients", "heat_filter"]


@full_precision
def degree_energies(coefficients: Tensor) -> Tensor:
    """Return the norm of each degree, √Σ_m c(l, m)²: (…, b²) → (…, b). Rotation leaves it unchanged.

    The gradient of a degree that is zero is zero, the least of its subgradients.

    Raises:
        TypeError, ValueError: Not (…, b²) float32 or float64, or not finite.

    Example:
        >>> ft.degree_energies(torch.tensor([5.0, 0.0, 3.0, 4.0]))  # degree 0, then the three orders of degree 1
        tensor([5., 5.])
    """
    values, _ = checks.coefficients(coefficients)
    return torch.linalg.vector_norm(by_degree(values), dim=-1)


def by_degree(coefficients: Tensor) -> Tensor:
    """(…, b²) → (…, b, 2b−1): a row a degree, orders −(b−1) … b−1, zero outside of the degree."""
    b = round(coefficients.shape[-1] ** 0.5)
    order = torch.arange(1 - b, b, device=coefficients.device)
    degree = torch.arange(b, device=coefficients.device)[:, None]
    inside = order.abs() <= degree
    place = torch.where(inside, degree * degree + degree + order, 0)
    return torch.where(inside, coefficients[..., place], 0)


def from_degrees(rows: Tensor) -> Tensor:
    """(…, b, 2b−1) → (…, b²): the inverse of ``by_degree``."""
    b = rows.shape[-2]
    index = torch.arange(b * b, device=rows.device)
    degree = degree_of(b, rows.device)
    return rows.flatten(-2)[..., degree * (2 * b - 1) + index - degree * degree - degree + b - 1]


def degree_of(bandwidth: int, device: torch.device) -> Tensor:
    """(b²,) the degree of every coefficient."""
    degree = torch.arange(bandwidth, device=device)
    return torch.repeat_interleave(degree, 2 * degree + 1, output_size=bandwidth**2)


@full_precision
def filter_coefficients(coefficients: Tensor, gain_per_degree: Tensor) -> Tensor:
    """Multiply each degree by a gain, with gradients for both: (…, b²), (…, b) → (…, b²).

    Raises:
        TypeError, ValueError: Not one finite gain a degree, other precisions or devices.

    Example:
        >>> gains = ft.heat_filter(3, torch.tensor(0.1))
        >>> ft.filter_coefficients(torch.ones(9), gains).shape
        torch.Size([9])
    """
    values, b = checks.coefficients(coefficients)
    gains = checks.real(gain_per_degree, "gain_per_degree")
    checks.last_axis(gains, "gain_per_degree", b, "b")
    checks.alike(values, "coefficients", gains, "gains")
    return values * gains[..., degree_of(b, gains.device)]


@full_precision
def heat_filter(bandwidth: int, time: Tensor) -> Tensor:
    """Gains of the heat kernel, exp(−t l(l+1)), with a gradient in the time: (…) → (…, b).

    Raises:
        TypeError, ValueError: The time is no tensor, negative or not finite.

    Example:
        >>> time = torch.tensor(0.1, requires_grad=True)
        >>> ft.heat_filter(4, time).sum().backward()
        >>> bool(time.grad < 0)
        True
    """
    b = check.bandwidth(bandwidth)
    rate = checks.real(time, "time")
    if checks.values_are_checked(rate) and bool((rate < 0).any()):
        raise ValueError(f"time must be >= 0, got {float(rate.detach().min()):g}")
    degree = torch.arange(b, device=rate.device, dtype=rate.dtype)
    return torch.exp(-rate[..., None] * (degree * (degree + 1)))
