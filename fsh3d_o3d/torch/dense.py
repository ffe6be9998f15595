"""Transforms on one grid as matrix products, halved where the grid has the half-turn symmetry of Fibonacci grids.

Under the half turn (x, y, z) → (x, −y, −z) every harmonic is even or odd. Folding values into their even and odd parts
leaves two matrices of a quarter of the size each. One pair of matrices serves both ways: weights are multiplied to
the values.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fsh3d_o3d.torch import recursion


def matrices(directions: Tensor, bandwidth: int, *, halved: bool, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """The harmonics (coefficients, points) at directions (n, 3) float64: all, or even and odd on half of them."""
    points = directions[: (len(directions) + 1) // 2] if halved else directions
    parity = parities(bandwidth) if halved else torch.zeros(bandwidth**2, dtype=torch.int64)
    own = [torch.nonzero(parity == part)[:, 0] for part in range(2 if halved else 1)]
    made = tuple(torch.empty((len(part), len(points)), dtype=dtype, device=directions.device) for part in own)
    if directions.device.type == "meta":
        return made
    for block in recursion.blocks(len(points), bandwidth, directions.device):
        filled = [0] * len(made)
        for degree, rows in recursion.degrees(points[block], bandwidth):
            kinds = parity[degree * degree : (degree + 1) ** 2]
            for part, matrix in enumerate(made):
                chosen = torch.nonzero(kinds == part)[:, 0].to(rows.device)
                matrix[filled[part] : filled[part] + len(chosen), block] = rows[chosen].to(dtype)
                filled[part] += len(chosen)
    return made


def parities(bandwidth: int) -> Tensor:
    """(b²,) 0 where the harmonic is even under the half turn about x, 1 where it is odd."""
    degree = torch.repeat_interleave(torch.arange(bandwidth), 2 * torch.arange(bandwidth) + 1)
    order = torch.arange(bandwidth**2) - degree * degree - degree
    return (degree + order + (order < 0)) % 2


@torch.library.custom_op(
    "fsh3d::dense_analyse",
    mutates_args=(),
    schema="(Tensor values, Tensor order, Tensor place, Tensor[] made) -> Tensor",
)
def analyse(values: Tensor, order: Tensor, place: Tensor, made: list[Tensor]) -> Tensor:
    """Yᵀ v: (k, n) → (k, b²).

    ``place`` puts even and odd coefficients, one after the other, in the usual order; ``order`` undoes it.
    """
    if len(made) == 1:
        return values @ made[0].mT
    n, half = values.shape[-1], made[0].shape[1]
    own, mirrored = values[:, :half], values[:, n - half :].flip(-1)
    even, odd = own + mirrored, own - mirrored
    if n % 2:  # the middle point is its own mirror image
        even[:, -1] = own[:, -1]
    return torch.cat((even @ made[0].mT, odd @ made[1].mT), -1).index_select(-1, place)


@torch.library.custom_op(
    "fsh3d::dense_synthesise",
    mutates_args=(),
    schema="(Tensor coefficients, int points, Tensor order, Tensor place, Tensor[] made) -> Tensor",
)
def synthesise(coefficients: Tensor, points: int, order: Tensor, place: Tensor, made: list[Tensor]) -> Tensor:
    """Y c: (k, b²) → (k, n). Arguments as for ``analyse``, and the number of points."""
    if len(made) == 1:
        return coefficients @ made[0]
    even, odd = coefficients.index_select(-1, order).split([len(part) for part in made], -1)
    even, odd = even @ made[0], odd @ made[1]
    return torch.cat((even + odd, (even - odd)[:, : points - even.shape[1]].flip(-1)), -1)


@analyse.register_fake
def _(values: Tensor, order: Tensor, place: Tensor, made: list[Tensor]) -> Tensor:
    return values.new_empty((len(values), len(order)))


@synthesise.register_fake
def _(coefficients: Tensor, points: int, order: Tensor, place: Tensor, made: list[Tensor]) -> Tensor:
    return coefficients.new_empty((len(coefficients), points))


def _keep_analysis(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    values, order, place, made = inputs  # the matrices are the plan's and not copied
    ctx.points = values.shape[-1]
    ctx.save_for_backward(order, place, *made)


def _analysis_backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    order, place, *made = ctx.saved_tensors
    return synthesise(grad, ctx.points, order, place, made), None, None, [None] * len(made)


def _keep_synthesis(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    _, _, order, place, made = inputs
    ctx.save_for_backward(order, place, *made)


def _synthesis_backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    order, place, *made = ctx.saved_tensors
    return analyse(grad, order, place, made), None, None, None, [None] * len(made)


analyse.register_autograd(_analysis_backward, setup_context=_keep_analysis)
synthesise.register_autograd(_synthesis_backward, setup_context=_keep_synthesis)
