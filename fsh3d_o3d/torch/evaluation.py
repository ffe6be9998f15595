"""Functions on the sphere and their gradients at any directions."""

from __future__ import annotations

from torch import Tensor

from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.broadcasting import grouped
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.sparse_maps import gradient
from fsh3d_o3d.torch.sums import synthesise

__all__ = ["evaluate", "evaluate_gradient"]


@full_precision
def evaluate(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Evaluate functions at any directions, with gradients for both: (…, b²), (m, 3) → (…, m).

    Derivatives in the directions are along the sphere, of any order; the memory of a call is that of its arguments and
    its result.

    Args:
        coefficients: (…, b²) real coefficients.
        directions: (m, 3), the same for all functions, or (…, m, 3) with as many leading axes as fit those of the
            coefficients: directions of each function's own. Only where they point counts; they need not be of
            unit length.

    Raises:
        TypeError: Not float32 or float64 tensors, or of different precisions.
        ValueError: Wrong shapes, different devices, vectors of length zero, values that are not finite.

    Example:
        >>> coefficients = torch.zeros(16, requires_grad=True)
        >>> directions = torch.eye(3)
        >>> ft.evaluate(coefficients, directions).sum().backward()
        >>> coefficients.grad.shape
        torch.Size([16])
        >>> ft.evaluate(torch.zeros(5, 2, 16), torch.rand(5, 1, 100, 3)).shape  # five pairs, each at its own places
        torch.Size([5, 2, 100])
    """
    given, _ = checks.coefficients(coefficients)
    unit = checks.unit_vectors(directions)
    checks.alike(given, "coefficients", unit, "directions")
    return _evaluated(given, unit)


@full_precision
def evaluate_gradient(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Evaluate gradients on the unit sphere, tangent to it: (…, b²), (m, 3) → (…, m, 3). Arguments as ``evaluate``.

    Example:
        >>> coefficients = torch.zeros(16)
        >>> coefficients[2] = (4 * torch.pi / 3) ** 0.5  # the function z
        >>> torch.allclose(ft.evaluate_gradient(coefficients, torch.eye(3)[:2]), torch.tensor([0.0, 0, 1]))
        True
    """
    given, _ = checks.coefficients(coefficients)
    unit = checks.unit_vectors(directions)
    checks.alike(given, "coefficients", unit, "directions")
    return gradient_at(given, unit)


def gradient_at(coefficients: Tensor, unit: Tensor) -> Tensor:
    """``evaluate_gradient`` at unit vectors."""
    return _evaluated(gradient(coefficients), unit.unsqueeze(-3)).mT


def _evaluated(coefficients: Tensor, unit: Tensor) -> Tensor:
    """Functions (…, b²) at unit vectors (…, m, 3)."""
    leading, functions, places = grouped(coefficients, unit, 2, "directions")
    return synthesise(functions, places).reshape(*leading, unit.shape[-2])
