"""Powers of Gram matrices X Xᵀ, with a gradient that repeated eigenvalues do not disturb.

The derivative of U f(λ) Uᵀ has the divided differences (f(λ_i) − f(λ_j))/(λ_i − λ_j) where that of the eigenvectors has
1/(λ_i − λ_j) (Daleckii and Krein 1965). They stay finite where eigenvalues meet, and so does the gradient, which does
not depend on the eigenvectors that are chosen there. From the singular values of X, small ones have all their digits.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

_ONCE = "powers of Gram matrices have first derivatives only: their gradient cannot be differentiated again"


def gram_power(rows: Tensor, power: float, epsilon: float = 0.0, floor: float = 0.0) -> Tensor:
    """(X Xᵀ + ε²)^p − ε^2p of (…, R, n): (…, R, R). Eigenvalues below ``floor`` of the largest count as that."""
    return _gram_power(rows, power, epsilon, floor)[0]


@torch.library.custom_op(
    "fsh3d::gram_power",
    mutates_args=(),
    schema="(Tensor rows, float power, float epsilon, float floor) -> (Tensor, Tensor, Tensor)",
)
def _gram_power(rows: Tensor, power: float, epsilon: float, floor: float) -> tuple[Tensor, Tensor, Tensor]:
    """The power, and what its gradient needs: U (…, R, R) and eigenvalues (…, R)."""
    count, width = rows.shape[-2:]
    vectors, singular, _ = torch.linalg.svd(rows, full_matrices=count > width)
    # Rounding of what is zero: without ε a small power would make much of it.
    noise = torch.finfo(rows.dtype).eps * max(count, width) * singular.amax(-1, keepdim=True)
    singular = torch.where(singular <= noise, 0.0, singular) if epsilon == 0 else singular
    eigenvalues = torch.nn.functional.pad(singular * singular, (0, max(0, count - width)))
    values = _clamped(eigenvalues, floor) + epsilon**2
    values = values**power - (epsilon ** (2 * power) if epsilon else 0.0)
    return (vectors * values[..., None, :]) @ vectors.mT, vectors, eigenvalues


@_gram_power.register_fake
def _(rows: Tensor, power: float, epsilon: float, floor: float) -> tuple[Tensor, Tensor, Tensor]:
    count = rows.shape[-2]
    square = (*rows.shape[:-1], count)
    return rows.new_empty(square), rows.new_empty(square), rows.new_empty(rows.shape[:-1])


@torch.library.custom_op(
    "fsh3d::gram_power_backward",
    mutates_args=(),
    schema="(Tensor grad, Tensor rows, Tensor vectors, Tensor eigenvalues, float power, float epsilon, float floor) "
    "-> Tensor",
)
def _slope(
    grad: Tensor, rows: Tensor, vectors: Tensor, eigenvalues: Tensor, power: float, epsilon: float, floor: float
) -> Tensor:
    mixed = vectors.mT @ ((grad + grad.mT) / 2) @ vectors
    mixed = mixed * divided_differences(eigenvalues, power, epsilon, floor)
    return 2 * vectors @ (mixed @ (vectors.mT @ rows))


@_slope.register_fake
def _(grad: Tensor, rows: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(rows)


def divided_differences(eigenvalues: Tensor, power: float, epsilon: float, floor: float) -> Tensor:
    """(f(λ_i) − f(λ_j))/(λ_i − λ_j) of f(λ) = (λ + ε²)^p, its derivative where they are equal: (…, R) → (…, R, R).

    As a^(p−1) ((1 + t)^p − 1)/t of the larger a, which has no cancellation however close the two are.
    """
    kept = _clamped(eigenvalues, floor)
    shifted = kept + epsilon**2
    larger = torch.maximum(shifted[..., :, None], shifted[..., None, :])
    gap = (kept[..., :, None] - kept[..., None, :]).abs()
    step = -gap / torch.where(larger > 0, larger, 1.0)
    ratio = torch.where(step == 0, power, torch.expm1(power * torch.log1p(step)) / torch.where(step == 0, 1.0, step))
    slope = ratio * torch.where(larger > 0, larger, 1.0) ** (power - 1)
    slope = torch.where(larger > 0, slope, 0.0)  # both vanish: what they multiply does as well
    if floor == 0:
        return slope
    # What counts as more than it is, does not change: the share of the difference that is left.
    given = (eigenvalues[..., :, None] - eigenvalues[..., None, :]).abs()
    free = (eigenvalues == kept)[..., :, None] & (eigenvalues == kept)[..., None, :]
    return slope * torch.where(free, 1.0, gap / torch.where(given > 0, given, 1.0))


def _clamped(eigenvalues: Tensor, floor: float) -> Tensor:
    return torch.maximum(eigenvalues, floor * eigenvalues.amax(-1, keepdim=True)) if floor else eigenvalues


def _keep(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    ctx.options = inputs[1:]
    ctx.save_for_backward(inputs[0], *output[1:])
    ctx.set_materialize_grads(False)


def _backward(ctx: Any, grad: Tensor | None, *_: Tensor | None) -> tuple[Tensor | None, None, None, None]:
    if grad is None:
        return None, None, None, None
    return _slope(grad, *ctx.saved_tensors, *ctx.options), None, None, None


def _no_more(ctx: Any, grad: Tensor) -> None:
    raise RuntimeError(_ONCE)


_gram_power.register_autograd(_backward, setup_context=_keep)
_slope.register_autograd(_no_more)
