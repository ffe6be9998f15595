"""The correlation of functions over rotations, C(R) = Σ ⟨t, R s⟩, at given rotations and on a grid of SO(3).

It depends on products M_l = Σ t_l s_lᵀ alone, however many functions are rotated together.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fsh3d_o3d import _validation as check
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.coefficients import by_degree, from_degrees
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.rotation import rotate

__all__ = ["CorrelationGrid", "correlation"]


@full_precision
def correlation(source: Tensor, target: Tensor, rotations: Tensor) -> Tensor:
    """Return Σ⟨t, R s⟩ over functions and degrees: (…, S, b²), (…, S, b²), (k, 3, 3) → (…, k).

    With gradients in all three: follow the one in R, and functions are brought into alignment.

    Raises:
        TypeError: Not float32 or float64 tensors, or of different precisions.
        ValueError: Wrong or different shapes, different devices, no rotations, values that are not finite.

    Example:
        >>> source = torch.rand(2, 16)  # two functions that are rotated together
        >>> R = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> target = ft.rotate_coefficients(source, R)
        >>> found = ft.correlation(source, target, torch.stack([R, torch.eye(3)]))
        >>> torch.allclose(found[0], source.square().sum()), bool(found[1] < found[0])
        (True, True)
    """
    products = _products(source, target)
    matrices = checks.rotations(rotations, "rotations")
    if matrices.ndim != 3:
        raise ValueError(f"rotations must have shape (k, 3, 3), got {tuple(matrices.shape)}")
    checks.alike(products, "source", matrices, "rotations")
    b = products.shape[-3]
    # A function with a coefficient of order m in every degree shows a column of all of Wigner's matrices.
    basis = from_degrees(torch.eye(2 * b - 1, dtype=products.dtype, device=products.device)[:, None].expand(-1, b, -1))
    columns = by_degree(rotate(basis.expand(len(matrices), -1, -1), matrices))  # rotation, m', degree, m
    return torch.einsum("ksbt,...bts->...k", columns, products)


class CorrelationGrid(nn.Module):
    """Correlations over a grid of rotations R_z(α) R_y(β) R_z(γ): an FFT on SO(3) as a few matrix products.

    The grid has n = 2⌈fineness · b / 2⌉ equal steps of α and of γ and n/2 of β; the default, three a degree, leaves no
    maximum between its points unseen. A softmax over the values times ``rotations`` is a differentiable guess.

    Args:
        bandwidth: b of the functions.
        fineness: Steps of α for each degree.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Example:
        >>> grid = ft.CorrelationGrid(bandwidth=4)
        >>> source = torch.rand(2, 16)
        >>> values = grid(source, source)
        >>> values.shape  # β, γ, α
        torch.Size([6, 12, 12])
        >>> grid.rotations.shape
        torch.Size([6, 12, 12, 3, 3])
    """

    rotations: Tensor
    """(n/2, n, n, 3, 3): the steps of β, γ and α."""

    def __init__(
        self,
        bandwidth: int,
        *,
        fineness: int = 3,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.bandwidth = b = check.bandwidth(bandwidth)
        steps = 2 * max(4, (check.integer(fineness, "fineness", minimum=1, maximum=64) * b + 1) // 2)
        check.memory(8.0 * (steps // 2 * 2 * b**3 + 9 * steps**3), f"a grid of rotations for bandwidth {b}")
        turns = torch.arange(steps, dtype=torch.float64) * (2 * torch.pi / steps)
        tilts = (torch.arange(steps // 2, dtype=torch.float64) + 0.5) * (2 * torch.pi / steps)
        about_y = _about(1, tilts)
        rotations = torch.einsum("aij,bjk,ckl->bcail", _about(2, turns), about_y, _about(2, turns))
        basis = from_degrees(torch.eye(2 * b - 1, dtype=torch.float64)[:, None].expand(-1, b, -1))
        # A turn about y keeps functions that are even in y apart from those that are odd: cosines from sines.
        tilt = by_degree(rotate(basis.expand(len(tilts), -1, -1), about_y)).permute(0, 2, 3, 1)
        cosines, sines = tilt[..., b - 1 :, b - 1 :].clone(), tilt[..., :b, :b].flip(-1, -2).clone()
        sines[..., 0, :] = 0  # there is no sine of order 0
        sines[..., 0] = 0
        phase = turns[:, None] * torch.arange(b, dtype=torch.float64)
        waves = torch.cat((torch.cos(phase), torch.sin(phase)), 1)
        for name, table in (("rotations", rotations), ("_cosines", cosines), ("_sines", sines), ("_waves", waves)):
            dtype = torch.get_default_dtype() if dtype is None else dtype
            self.register_buffer(name, table.to(dtype).to(device or torch.get_default_device()), persistent=False)

    @full_precision
    def forward(self, source: Tensor, target: Tensor) -> Tensor:
        """Return C at the grid's rotations: (…, S, b²), (…, S, b²) → (…, n/2, n, n) for β, γ, α.

        Raises:
            TypeError, ValueError: As for ``correlation``; another bandwidth.
        """
        products, b = _products(source, target), self.bandwidth
        if products.shape[-3] != b:
            raise ValueError(f"the functions are of bandwidth {products.shape[-3]}, the grid is for {b}")
        checks.alike(products, "source", self._waves, "the grid's buffers")
        plus, minus = slice(b - 1, None), slice(None, b)
        cc, ss = products[..., plus, plus], products[..., minus, minus].flip(-1, -2)
        cs, sc = products[..., plus, minus].flip(-1), products[..., minus, plus].flip(-2)

        def over_degrees(first: Tensor, second: Tensor) -> Tensor:
            terms = torch.einsum("tlmn,...lmn->...tmn", self._cosines, first)
            return terms + torch.einsum("tlmn,...lmn->...tmn", self._sines, second)

        # Where one of the orders is 0 there is no sine; flipped halves repeat the cosine there.
        real = torch.arange(b, device=products.device) > 0
        cs, sc = cs * real, sc * real[:, None]
        ss_in = ss * real * real[:, None]
        upper = torch.cat((over_degrees(cc, ss_in), over_degrees(-cs, sc)), -1)
        lower = torch.cat((over_degrees(sc, -cs), over_degrees(-ss_in, -cc)), -1)
        return self._waves @ torch.cat((upper, lower), -2).mT @ self._waves.mT


def _products(source: object, target: object) -> Tensor:
    """M (…, b, 2b−1, 2b−1), rows of the target and columns of the source."""
    left, b = checks.coefficients(source, "source")
    right, c = checks.coefficients(target, "target")
    checks.alike(left, "source", right, "target")
    if left.ndim < 2 or right.ndim < 2 or left.shape[-2] != right.shape[-2] or b != c:
        raise ValueError(
            f"source and target must both have shape (…, S, b²), got {tuple(left.shape)} and {tuple(right.shape)}"
        )
    return torch.einsum("...fbt,...fbs->...bts", by_degree(right), by_degree(left))


def _about(axis: int, angles: Tensor) -> Tensor:
    """Rotations (k, 3, 3) about a coordinate axis."""
    result = torch.eye(3, dtype=angles.dtype).repeat(len(angles), 1, 1)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    result[:, first, first] = result[:, second, second] = torch.cos(angles)
    result[:, second, first], result[:, first, second] = torch.sin(angles), -torch.sin(angles)
    return result
