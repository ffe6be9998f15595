"""Harmonics on a device, degree by degree: the recursion of the NumPy layer, on a block of points at a time.

Nothing larger than a block of one degree is held, so that bandwidth 256 on its own grid, whose matrix would take
200 GB, fits into a fraction of one.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

_CPU_BLOCK = 2**18  # numbers of one degree in a block, a choice: what the cache of a processor holds
_DEVICE_BLOCK = 2**24  # the same on a device, a choice: enough to fill it


def blocks(points: int, bandwidth: int, device: torch.device) -> Iterator[slice]:
    """Slices of points, of a length that depends on nothing but the bandwidth and the kind of device."""
    numbers = _CPU_BLOCK if device.type == "cpu" else _DEVICE_BLOCK
    length = max(256, numbers // bandwidth)
    for start in range(0, points, length):
        yield slice(start, min(start + length, points))


def degrees(directions: Tensor, bandwidth: int) -> Iterator[tuple[int, Tensor]]:
    """Yield (l, Y) with the 2l+1 harmonics of degree l, orders −l … l, at unit vectors (…, m, 3): (…, 2l+1, m)."""
    b = bandwidth
    x, y, z = directions.unbind(-1)
    rho = torch.hypot(x, y)
    order = torch.arange(b, device=directions.device, dtype=directions.dtype)
    angle = order[:, None] * torch.atan2(y, x)[..., None, :]
    scale = (order + 1).clamp(max=2).sqrt()[:, None]  # √2, and 1 for order 0
    cosine, sine = torch.cos(angle) * scale, torch.sin(angle) * scale
    up, down = _factors(b, directions)
    height, width = z[..., None, :], rho[..., None, :]
    before = torch.zeros_like(cosine)
    last = torch.zeros_like(cosine)
    last[..., 0, :] = (1 / (4 * torch.pi)) ** 0.5
    yield 0, last[..., :1, :]
    for degree in range(1, b):
        current = z.new_empty((*z.shape[:-1], degree + 1, z.shape[-1]))
        inner = current[..., :degree, :]
        torch.mul(height, last[..., :degree, :], out=inner)
        inner.addcmul_(before[..., :degree, :], down[degree, :degree, None], value=-1)
        inner.mul_(up[degree, :degree, None])
        torch.mul(width, last[..., degree - 1 : degree, :], out=current[..., degree:, :])
        current[..., degree:, :].mul_(((2 * degree + 1) / (2 * degree)) ** 0.5)
        rows = z.new_empty((*z.shape[:-1], 2 * degree + 1, z.shape[-1]))
        torch.mul(current, cosine[..., : degree + 1, :], out=rows[..., degree:, :])
        torch.mul(current[..., 1:, :].flip(-2), sine[..., 1 : degree + 1, :].flip(-2), out=rows[..., :degree, :])
        yield degree, rows
        before, last = last, torch.nn.functional.pad(current, (0, 0, 0, 1)) if degree + 1 < b else current


def _factors(bandwidth: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """The recursion's factors (b, b) by degree and order, rounded once."""
    order = torch.arange(bandwidth, device=like.device, dtype=torch.float64)
    degree, m = order[:, None], order[None, :]
    up = torch.sqrt((4 * degree**2 - 1).clamp(min=0) / (degree**2 - m**2).clamp(min=1))
    down = torch.sqrt(((degree - 1) ** 2 - m**2).clamp(min=0) / (4 * (degree - 1) ** 2 - 1).abs())
    return up.to(like.dtype), down.to(like.dtype)


def synthesise(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Σ c(l, m) Y(l, m; ω_j): (d, k, b²) and unit vectors (d or 1, m, 3) → (d, k, m)."""
    b = round(coefficients.shape[-1] ** 0.5)
    result = coefficients.new_zeros((*coefficients.shape[:-1], directions.shape[-2]))
    for block in blocks(directions.shape[-2], b, directions.device):
        part = coefficients.new_zeros((*coefficients.shape[:-1], block.stop - block.start))
        for degree, rows in degrees(directions[:, block], b):
            part += coefficients[..., degree**2 : (degree + 1) ** 2] @ rows
        result[..., block] = part
    return result


def analyse(values: Tensor, directions: Tensor, bandwidth: int) -> Tensor:
    """Σ_j v_j Y(l, m; ω_j): (d, k, m) and unit vectors (d or 1, m, 3) → (d, k, b²)."""
    result = values.new_zeros((*values.shape[:-1], bandwidth**2))
    for block in blocks(directions.shape[-2], bandwidth, directions.device):
        part = values[..., block]
        for degree, rows in degrees(directions[:, block], bandwidth):
            result[..., degree**2 : (degree + 1) ** 2] += part @ rows.mT
    return result
