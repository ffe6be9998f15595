"""Rotation of coefficients, exactly, with gradients in the coefficients and in the rotation.

R = R_z(α) R_y(β) R_z(γ), and R_y is R_z between two quarter turns about x: a rotation about z mixes the orders m and −m
alone, and the quarter turns are constant matrices, one a degree. No matrix is made for a rotation, so that thousands at
once cost no more memory than the functions. Derivatives are those along the rotations: a small turn exp([ω]×) R changes
the result by sums of a few of its own coefficients, without the singularities of angles.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fsh3d_o3d.sphere import degrees_and_orders
from fsh3d_o3d.sphere import rotate_coefficients as rotated_exactly
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.broadcasting import grouped
from fsh3d_o3d.torch.coefficients import by_degree, from_degrees
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.sparse_maps import turned

__all__ = ["rotate_coefficients"]

_QUARTER_TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""About x, takes z to y."""


@full_precision
def rotate_coefficients(coefficients: Tensor, rotation: Tensor) -> Tensor:
    """Return the coefficients of the rotated functions f'(ω) = f(Rᵀω): (…, b²), (…, 3, 3) → (…, b²).

    What was in direction ω is in direction R ω afterwards. The gradient in R is tangent to the rotations, the one along
    which a network that makes rotations (from vectors, quaternions or six numbers) can move.

    Args:
        coefficients: (…, b²).
        rotation: R, (3, 3), or (…, 3, 3) with leading axes that fit those of the coefficients.

    Raises:
        TypeError: Not float32 or float64 tensors, or of different precisions.
        ValueError: Wrong shapes, different devices, no rotations, values that are not finite.

    Example:
        >>> R = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], requires_grad=True)  # x to y
        >>> coefficients = torch.rand(5, 16)
        >>> turned = ft.rotate_coefficients(coefficients, R)
        >>> x, y = torch.eye(3)[:1], torch.eye(3)[1:2]
        >>> torch.allclose(ft.evaluate(turned, y), ft.evaluate(coefficients, x), atol=1e-6)
        True
        >>> turned[:, 1].sum().backward()
        >>> R.grad.shape
        torch.Size([3, 3])
    """
    given, _ = checks.coefficients(coefficients)
    matrices = checks.rotations(rotation)
    checks.alike(given, "coefficients", matrices, "rotation")
    leading, functions, places = grouped(given, matrices, 2, "rotation")
    return rotate(functions, places).reshape(*leading, given.shape[-1])


@torch.library.custom_op("fsh3d::rotate", mutates_args=(), schema="(Tensor coefficients, Tensor rotations) -> Tensor")
def rotate(coefficients: Tensor, rotations: Tensor) -> Tensor:
    """Rotate functions (d, k, b²) by (d, 3, 3)."""
    b = round(coefficients.shape[-1] ** 0.5)
    alpha, beta, gamma = euler_angles(rotations)
    order = torch.arange(1 - b, b, device=coefficients.device, dtype=coefficients.dtype)
    quarter = quarter_turn(b, coefficients.dtype, coefficients.device)

    def about_z(rows: Tensor, angle: Tensor) -> Tensor:
        phase = angle[:, None, None] * order
        return rows * torch.cos(phase) - rows.flip(-1) * torch.sin(phase)

    def product(rows: Tensor, matrices: Tensor) -> Tensor:
        return (rows.flatten(1, 2) @ matrices).unflatten(1, rows.shape[1:3])

    rows = about_z(by_degree(coefficients).permute(2, 0, 1, 3), gamma)  # degree, group, function, order
    rows = about_z(product(rows, quarter), beta)
    rows = about_z(product(rows, quarter.mT), alpha)
    return from_degrees(rows.permute(1, 2, 0, 3))


@rotate.register_fake
def _(coefficients: Tensor, rotations: Tensor) -> Tensor:
    return torch.empty_like(coefficients)


def _keep(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    ctx.save_for_backward(inputs[1], output)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
    rotations, output = ctx.saved_tensors
    wanted = ctx.needs_input_grad
    back = rotate(grad, rotations.mT.contiguous()) if wanted[0] else None
    if not wanted[1]:
        return back, None
    torque = (turned(output) * grad[..., None, :]).sum((1, 3))  # (d, 3), per radian about fixed axes
    return back, cross_matrix(torque) @ rotations / 2


rotate.register_autograd(_backward, setup_context=_keep)


def cross_matrix(vectors: Tensor) -> Tensor:
    """[v]× with [v]× u = v × u: (…, 3) → (…, 3, 3)."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


def euler_angles(rotations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """α, β, γ (d,) of R = R_z(α) R_y(β) R_z(γ), (d, 3, 3), accurate for any β, 0 and π included."""
    alpha = torch.atan2(rotations[:, 1, 2], rotations[:, 0, 2])
    beta = torch.atan2(torch.hypot(rotations[:, 0, 2], rotations[:, 1, 2]), rotations[:, 2, 2])
    # Second row of R_z(−α) R, which R_y leaves alone. Where β is 0 or π, α is arbitrary and γ makes up for it.
    row = torch.cos(alpha)[:, None] * rotations[:, 1] - torch.sin(alpha)[:, None] * rotations[:, 0]
    return alpha, beta, torch.atan2(row[:, 0], row[:, 1])


@functools.lru_cache(maxsize=16)
def quarter_turn(bandwidth: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(b, 2b−1, 2b−1) matrices of all degrees, row: of the result, column: of what is turned; zero outside."""
    b = bandwidth
    order = degrees_and_orders(b)[1]
    # A rotation keeps degrees apart, so that one function can carry a coefficient of order m in each of them.
    basis = (order == np.arange(1 - b, b)[:, None]).astype(np.float64)
    columns = torch.from_numpy(rotated_exactly(basis, _QUARTER_TURN, threads=1))
    return by_degree(columns).permute(1, 2, 0).to(dtype).to(device).contiguous()
