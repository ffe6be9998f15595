"""Sums over harmonics and over points at any directions, with gradients for both arguments: two operators of PyTorch.

On the CPU and beyond small bandwidths they are ducc0's fast transforms on the tensors' own memory; elsewhere the
recursion. Each is the other's adjoint, and derivatives in the directions are sums of the same kind with other
coefficients, so that there are derivatives of any order, and nothing of a forward pass is kept but its arguments.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fsh3d_o3d.sphere import NufftEngine, SphericalGrid
from fsh3d_o3d.torch import recursion
from fsh3d_o3d.torch.sparse_maps import gradient

_SMALLEST_FAST_BANDWIDTH = 12  # of the fast transform on the CPU; below, the recursion is as fast and exact to rounding


@torch.library.custom_op(
    "fsh3d::synthesise", mutates_args=(), schema="(Tensor coefficients, Tensor directions) -> Tensor"
)
def synthesise(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Σ c(l, m) Y(l, m; ω_j): (d, k, b²) and unit vectors (d or 1, m, 3) → (d, k, m)."""
    b = round(coefficients.shape[-1] ** 0.5)
    if not _fast(coefficients, directions, b):
        return recursion.synthesise(coefficients, directions)
    parts = [
        engine.synthesise(own.numpy(), torch.get_num_threads())
        for own, engine in zip(coefficients.contiguous(), _engines(directions, b, len(coefficients)), strict=True)
    ]
    return torch.stack([torch.from_numpy(part) for part in parts])


@torch.library.custom_op(
    "fsh3d::analyse", mutates_args=(), schema="(Tensor values, Tensor directions, int bandwidth) -> Tensor"
)
def analyse(values: Tensor, directions: Tensor, bandwidth: int) -> Tensor:
    """Σ_j v_j Y(l, m; ω_j): (d, k, m) and unit vectors (d or 1, m, 3) → (d, k, b²)."""
    if not _fast(values, directions, bandwidth):
        return recursion.analyse(values, directions, bandwidth)
    parts = [
        engine.analyse(own.numpy(), torch.get_num_threads())
        for own, engine in zip(values.contiguous(), _engines(directions, bandwidth, len(values)), strict=True)
    ]
    return torch.stack([torch.from_numpy(part) for part in parts])


@synthesise.register_fake
def _(coefficients: Tensor, directions: Tensor) -> Tensor:
    return coefficients.new_empty((*coefficients.shape[:-1], directions.shape[-2]))


@analyse.register_fake
def _(values: Tensor, directions: Tensor, bandwidth: int) -> Tensor:
    return values.new_empty((*values.shape[:-1], bandwidth**2))


def _fast(values: Tensor, directions: Tensor, bandwidth: int) -> bool:
    """Whether the fast transform is the better way."""
    some = values.numel() > 0 and directions.numel() > 0
    return some and values.device.type == "cpu" and bandwidth >= _SMALLEST_FAST_BANDWIDTH


def _engines(directions: Tensor, bandwidth: int, count: int) -> list[NufftEngine]:
    x, y, z = directions.unbind(-1)
    theta, phi = torch.atan2(torch.hypot(x, y), z), torch.atan2(y, x) % (2 * torch.pi)
    arrays = (part.double().contiguous().numpy() for part in (directions, theta, phi))
    engines = [
        NufftEngine(SphericalGrid(place, south, east, "directions"), bandwidth)
        for place, south, east in zip(*arrays, strict=True)
    ]
    return engines * count if len(engines) == 1 else engines


def _keep_synthesis(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    ctx.save_for_backward(*inputs)


def _synthesis_backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
    coefficients, directions = ctx.saved_tensors
    wanted = ctx.needs_input_grad
    b = round(coefficients.shape[-1] ** 0.5)
    return (
        analyse(grad, directions, b) if wanted[0] else None,
        _slopes(coefficients, directions, grad) if wanted[1] else None,
    )


def _keep_analysis(ctx: Any, inputs: tuple[Tensor, Tensor, int], output: Tensor) -> None:
    ctx.save_for_backward(*inputs[:2])


def _analysis_backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
    values, directions = ctx.saved_tensors
    wanted = ctx.needs_input_grad
    return (
        synthesise(grad, directions) if wanted[0] else None,
        _slopes(grad, directions, values) if wanted[1] else None,
        None,
    )


def _slopes(coefficients: Tensor, directions: Tensor, values: Tensor) -> Tensor:
    """Derivative in the directions of Σ v_j f(ω_j), tangent to the sphere: like ``directions``."""
    slopes = synthesise(gradient(coefficients).flatten(-3, -2), directions).unflatten(-2, (-1, 3))
    return (slopes * values[..., None, :]).sum(-3).mT.sum_to_size(directions.shape)


synthesise.register_autograd(_synthesis_backward, setup_context=_keep_synthesis)
analyse.register_autograd(_analysis_backward, setup_context=_keep_analysis)
