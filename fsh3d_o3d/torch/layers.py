"""Layers on functions on the sphere that commute with rotations: turned input, turned output."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fsh3d_o3d import _validation as check
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.coefficients import by_degree, from_degrees
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.transform import SphericalHarmonicTransform

__all__ = ["QuadraticNonlinearity", "ZonalConvolution"]


class ZonalConvolution(nn.Module):
    """Convolution with learned kernels that depend on the angle alone (Esteves et al. 2018), as gains by degree.

    c'(o, l, m) = Σ_i w(o, i, l) c(i, l, m), and a constant for each channel that goes out.

    Args:
        in_channels: Functions that go in.
        out_channels: Functions that come out.
        bandwidth: b of both.
        bias: Whether to add the constants.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Example:
        >>> layer = ft.ZonalConvolution(3, 8, bandwidth=6)
        >>> layer(torch.rand(5, 3, 36)).shape
        torch.Size([5, 8, 36])
        >>> sum(part.numel() for part in layer.parameters())
        152
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        bandwidth: int,
        *,
        bias: bool = True,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        shape = tuple(
            check.integer(value, name, minimum=1)
            for value, name in ((out_channels, "out_channels"), (in_channels, "in_channels"))
        )
        self.bandwidth = check.bandwidth(bandwidth)
        self.weight = nn.Parameter(torch.empty(*shape, self.bandwidth, device=device, dtype=dtype))
        self.bias = nn.Parameter(torch.zeros(shape[0], device=device, dtype=dtype)) if bias else None
        nn.init.normal_(self.weight, std=shape[1] ** -0.5)  # each degree keeps its energy on average

    @full_precision
    def forward(self, coefficients: Tensor) -> Tensor:
        """(…, in, b²) → (…, out, b²).

        Raises:
            TypeError, ValueError: Another bandwidth, number of channels, precision or device.
        """
        rows = _rows(coefficients, self.bandwidth, self.weight.shape[1])
        checks.alike(rows, "coefficients", self.weight, "the layer's weights")
        result = from_degrees(torch.einsum("oil,...ils->...ols", self.weight, rows))
        if self.bias is None:
            return result
        constant = nn.functional.pad(self.bias[:, None] * (4 * torch.pi) ** 0.5, (0, self.bandwidth**2 - 1))
        return result + constant

    def extra_repr(self) -> str:
        """What ``print`` shows of it."""
        out, into, b = self.weight.shape
        return f"{into}, {out}, bandwidth={b}, bias={self.bias is not None}"


class QuadraticNonlinearity(nn.Module):
    """a f + g f² / √(1 + mean f²), point by point, with learned a and g for each channel.

    What is pointwise on the sphere commutes with rotations, but for what aliasing breaks. A square has no degree beyond
    2b − 2, and a grid of bandwidth 1.5 b integrates it: the degrees that are kept are exact, and the layer equivariant
    to rounding. It lets degrees talk to each other, which convolutions do not. The mean square is an invariant and
    keeps deep networks bounded.

    Args:
        channels: Functions.
        bandwidth: b.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Example:
        >>> layer = ft.QuadraticNonlinearity(8, bandwidth=6)
        >>> layer(torch.rand(5, 8, 36)).shape
        torch.Size([5, 8, 36])
    """

    def __init__(
        self,
        channels: int,
        bandwidth: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        count = check.integer(channels, "channels", minimum=1)
        self.bandwidth = check.bandwidth(bandwidth)
        self.linear = nn.Parameter(torch.ones(count, device=device, dtype=dtype))
        self.square = nn.Parameter(torch.ones(count, device=device, dtype=dtype))
        # Three factors of degree < b make degree 3(b − 1), and weights are exact below twice their bandwidth.
        self.transform = SphericalHarmonicTransform(-(-3 * self.bandwidth // 2), device=device, dtype=dtype)

    @full_precision
    def forward(self, coefficients: Tensor) -> Tensor:
        """(…, channels, b²) → (…, channels, b²).

        Raises:
            TypeError, ValueError: Another bandwidth, number of channels, precision or device.
        """
        _rows(coefficients, self.bandwidth, len(self.linear))
        checks.alike(coefficients, "coefficients", self.linear, "the layer's weights")
        mean_square = coefficients.square().sum(-1, keepdim=True) / (4 * torch.pi)
        squares = self.transform(self.transform.inverse(coefficients).square())[..., : self.bandwidth**2]
        return self.linear[:, None] * coefficients + self.square[:, None] * squares / (1 + mean_square).sqrt()

    def extra_repr(self) -> str:
        """What ``print`` shows of it."""
        return f"{len(self.linear)}, bandwidth={self.bandwidth}"


def _rows(coefficients: object, bandwidth: int, channels: int) -> Tensor:
    given, b = checks.coefficients(coefficients)
    if b != bandwidth:
        raise ValueError(f"coefficients are of bandwidth {b}, the layer of {bandwidth}")
    if given.ndim < 2 or given.shape[-2] != channels:
        raise ValueError(f"coefficients must have shape (…, {channels}, b²), got {tuple(given.shape)}")
    return by_degree(given)
