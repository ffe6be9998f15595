"""Points as fields on concentric shells, with gradients down to the points: the descriptor's own fields.

Where the descriptor blurs the area on a voxel grid and interpolates, sums here run over the points themselves, so that
they are smooth in them: ∫ exp(−|x − y|²/2s²) dA(y) is Σ w exp(−|x − p|²/2s²). Blocks of places are summed one after the
other, and again for the gradient, so that memory does not grow with places times points.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.coefficients import degree_energies
from fsh3d_o3d.torch.invariants import cross_shell_invariants
from fsh3d_o3d.torch.matrix_powers import gram_power
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.transform import SphericalHarmonicTransform

__all__ = ["ShellEncoder", "encode"]

_BLOCK = 2**23  # places times points at a time, a choice: 64 MB in float64
_WEAKEST_FIELD = 0.05  # of the frame's first field, as in the descriptor: normals of a flat sheet are rounding alone
_FARTHEST = -700.0  # of a logarithm, as far as the descriptor's: an area too far away to be seen


class ShellEncoder(nn.Module):
    """Points to coefficients of fields on shells, and to the descriptor, as an ``SHDOption`` says.

    The cloud is moved to its centroid and scaled to unit RMS radius, so that position and size do not count, and the
    fields are those of the option's ``widths``, ``normal_width``, ``frames`` and ``bands``. All of it has gradients.
    Points should be spread evenly over the surface, or have weights: the density correction of the descriptor, a search
    for neighbours, has no gradient.

    Args:
        option: What is encoded; ``SHDOption.best()`` if not given, without its field of normals where clouds have none.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Raises:
        TypeError: Not an option.
        ValueError: An option whose fields have no gradient: ``distance="nearest"``, ``covariance=True``.

    Example:
        >>> encoder = ft.ShellEncoder(fsh.SHDOption(bandwidth=8, shells=8))
        >>> points = torch.randn(2, 500, 3, requires_grad=True)  # two clouds
        >>> coefficients = encoder(points)
        >>> coefficients.shape
        torch.Size([2, 8, 64])
        >>> encoder.feature(points).shape
        torch.Size([2, 64])
        >>> coefficients.sum().backward()
        >>> points.grad.shape
        torch.Size([2, 500, 3])
    """

    radii: Tensor
    """(S,) of the shells, in RMS radii."""

    def __init__(
        self,
        option: SHDOption | None = None,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.option = own = SHDOption.best() if option is None else option
        if not isinstance(own, SHDOption):
            raise TypeError(f"option must be an SHDOption, got {type(own).__name__}")
        if own.shell_fields.distance != "soft" or own.covariance:
            what = "covariance=True" if own.covariance else 'distance="nearest" (route="exact" too)'
            raise ValueError(f'{what} has no gradient worth the name: take distance="soft" and covariance=False')
        self.transform = SphericalHarmonicTransform(own.bandwidth, own.grid, own.weights, device=device, dtype=dtype)
        like = self.transform.weights
        radii = torch.tensor(own.shell_fields.radii, dtype=like.dtype, device=like.device)
        self.register_buffer("radii", radii, persistent=False)

    @full_precision
    def forward(self, points: Tensor, weights: Tensor | None = None, normals: Tensor | None = None) -> Tensor:
        """Return the coefficients of all functions: (…, n, 3) → (…, R, b²), by frames, fields and bands.

        Args:
            points: (…, n, 3) clouds.
            weights: (…, n) shares of the area, positive; alike if not given.
            normals: (…, n, 3) of any length and either sign; without them the field of normals is left out.

        Raises:
            TypeError: Not float32 or float64 tensors, or not of the encoder's precision.
            ValueError: Wrong shapes, another device, no points, values that are not finite.
        """
        place, share, across = self._checked(points, weights, normals)
        centroid = (share[..., None] * place).sum(-2, keepdim=True)
        place = place - centroid
        place = place / (share * place.square().sum(-1)).sum(-1).sqrt()[..., None, None]
        frames = [self._frame(place, share, across, power) for power in self.option.frames]
        return _balanced(torch.stack(frames, -4)) if len(frames) > 1 else _balanced(frames[0].unsqueeze(-4))

    @full_precision
    def feature(self, points: Tensor, weights: Tensor | None = None, normals: Tensor | None = None) -> Tensor:
        """Return the descriptor (…, d) as ``shd_descriptor`` orders and normalises it. Arguments as ``forward``.

        Example:
            >>> ft.ShellEncoder().feature(torch.rand(300, 3)).shape  # without the field of normals
            torch.Size([1632])
        """
        option, coefficients = self.option, self.forward(points, weights, normals)
        if option.invariant == "cross_shell":
            feature = cross_shell_invariants(coefficients, option.power, option.epsilon)
        else:
            feature = degree_energies(coefficients).mT
        feature = feature.flatten(-2)
        if option.normalisation == "none":
            return feature
        return nn.functional.normalize(feature, 1 if option.normalisation == "l1" else 2, dim=-1)

    def extra_repr(self) -> str:
        """What ``print`` shows of it."""
        return repr(self.option)

    def _checked(
        self, points: object, weights: Tensor | None, normals: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        place = checks.real(points, "points")
        if place.ndim < 2 or place.shape[-1] != 3 or place.shape[-2] < 2:
            raise ValueError(f"points must have shape (…, n, 3) with n >= 2, got {tuple(place.shape)}")
        checks.alike(place, "points", self.radii, "the encoder's buffers")
        share = torch.ones_like(place[..., 0]) if weights is None else checks.real(weights, "weights")
        across = None if normals is None else checks.real(normals, "normals")
        for value, name, shape in ((share, "weights", place.shape[:-1]), (across, "normals", place.shape)):
            if value is not None:
                checks.alike(value, name, place, "points")
                if value.shape != shape:
                    raise ValueError(f"{name} must have shape {tuple(shape)}, got {tuple(value.shape)}")
        if across is None and not self.option.widths:
            raise ValueError("the option has a field of normals alone, and the cloud has no normals")
        return place, share / share.sum(-1, keepdim=True), across

    def _frame(self, place: Tensor, share: Tensor, normals: Tensor | None, power: float) -> Tensor:
        """Coefficients (…, fields, bands, b²) of the cloud stretched by C^(−power/2), at unit RMS radius again."""
        if power:
            rows = (share.sqrt()[..., None] * place).mT
            matrix = gram_power(rows, -power / 2, 0.0, self.option.flatness)
            scale = (matrix @ rows).square().sum((-1, -2), keepdim=True).sqrt()
            matrix = matrix / scale
            if normals is not None:
                normals = normals @ torch.linalg.inv(matrix)  # covectors: by the inverse
            place = place @ matrix
        values = self._fields(place, share, normals) * self._shell_scale()
        values = values.unflatten(-2, (self.option.rows, -1)).mean(-2)
        return self.transform(values)

    def _shell_scale(self) -> Tensor:
        radii = self.radii[:, None]
        scales = {"none": torch.ones_like(radii), "radius": radii, "sqrt4pi": radii * (4 * torch.pi) ** 0.5}
        return scales[self.option.shell_scaling]

    def _fields(self, place: Tensor, share: Tensor, normals: Tensor | None) -> Tensor:
        """(…, fields, S, directions)."""
        option = self.option
        nodes = (self.radii[:, None, None] * self.transform.directions).reshape(-1, 3)
        inside = place.square().sum(-1) < option.radius**2  # as in the descriptor: what is farther is left out
        share = torch.where(inside, share, 0)
        values = []
        if option.widths:
            area = _log_area(nodes, place, [share], option.smoothing)[0]
            # exp(−d²/2σ²) of the soft distance d² = −2s² log ∫ exp(−|x − y|²/2s²) dA.
            values = [torch.exp(area * (option.smoothing / width) ** 2) for width in option.widths]
        if option.normal_width is not None and normals is not None:
            length = (place.square().sum(-1) * normals.square().sum(-1)).clamp(min=torch.finfo(place.dtype).tiny)
            part = share * (place * normals).sum(-1).square() / length
            ratio, area = _log_area(nodes, place, [part, share], option.normal_smoothing)
            values.append(torch.exp(ratio - area + area * (option.normal_smoothing / option.normal_width) ** 2))
        return torch.stack(values, -2).unflatten(-1, (option.shells, -1))


def encode(points: Tensor, option: SHDOption | None = None, *, weights: Tensor | None = None) -> Tensor:
    """Return the coefficients of soft fields on shells around points: (…, n, 3) → (…, R, b²).

    The call of a ``ShellEncoder``, which is made once for each option, precision and device; see there.

    Example:
        >>> points = torch.randn(200, 3, requires_grad=True)
        >>> coefficients = ft.encode(points, fsh.SHDOption(bandwidth=6, shells=4))
        >>> coefficients.shape
        torch.Size([4, 36])
        >>> ft.cross_shell_invariants(coefficients).sum().backward()  # a feature, and its gradient in the points
    """
    place = checks.real(points, "points")
    own = SHDOption.best() if option is None else option
    return _encoder(own, place.dtype, place.device)(place, weights)


@functools.lru_cache(maxsize=8)
def _encoder(option: SHDOption, dtype: torch.dtype, device: torch.device) -> ShellEncoder:
    return ShellEncoder(option, dtype=dtype, device=device)


def _log_area(nodes: Tensor, points: Tensor, shares: list[Tensor], smoothing: float) -> list[Tensor]:
    """Log Σ w exp(−|x − p|²/2s²) at nodes (m, 3) of points (…, n, 3), for each of several weights (…, n): (…, m)."""
    logs = torch.stack([torch.log(share.clamp(min=torch.finfo(share.dtype).tiny)) for share in shares])
    length = max(1, _BLOCK // max(1, points[..., 0].numel()))

    def block(own: Tensor, places: Tensor, weights: Tensor) -> Tensor:
        square = own.square().sum(-1)[:, None] + places.square().sum(-1)[..., None, :] - 2 * own @ places.mT
        return torch.logsumexp(weights[..., None, :] - square.clamp(min=0) / (2 * smoothing**2), -1)

    parts = [
        checkpoint(block, nodes[start : start + length], points, logs, use_reentrant=False, preserve_rng_state=False)
        for start in range(0, len(nodes), length)
    ]
    return list(torch.cat(parts, -1).clamp(min=_FARTHEST).unbind(0))


def _balanced(coefficients: Tensor) -> Tensor:
    """All functions (…, R, b²) of (…, frames, fields, bands, b²), each field of unit norm if several."""
    frames, fields = coefficients.shape[-4:-2]
    if frames * fields > 1:
        norm = torch.linalg.vector_norm(coefficients, dim=(-1, -2), keepdim=True)
        norm = torch.maximum(norm, _WEAKEST_FIELD * norm[..., :1, :, :])
        coefficients = coefficients / torch.where(norm > 0, norm, 1)
    return coefficients.flatten(-4, -2)
