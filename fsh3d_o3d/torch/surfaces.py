"""Decoding shapes to vertices and normals, with gradients down to their coefficients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from fsh3d_o3d import _validation as check
from fsh3d_o3d.geometry import sphere_mesh
from fsh3d_o3d.sphere import equal_weights, grid_from_directions
from fsh3d_o3d.torch import checks
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.sparse_maps import gradient
from fsh3d_o3d.torch.transform import SphericalHarmonicTransform

__all__ = ["ConformalDecoder", "DecodedSurface", "RadialDecoder"]

_USUAL_VERTICES = 2562  # an icosahedron subdivided four times: enough for losses, a choice


class DecodedSurface(NamedTuple):
    """A surface as tensors.

    Example:
        >>> decoder = ft.RadialDecoder(bandwidth=4, vertices=42)
        >>> isinstance(decoder(torch.eye(16)[0]), ft.DecodedSurface)
        True
    """

    vertices: Tensor
    """(…, v, 3) positions."""
    normals: Tensor
    """(…, v, 3) unit normals, outward where the shape's orientation is; zero where the surface has none."""


class _Decoder(nn.Module):
    """Values and gradients of functions at the vertices of a sphere."""

    triangles: Tensor
    """(t, 3) int64: triangles of an icosphere's vertices, anticlockwise from outside; empty for given directions."""

    def __init__(
        self,
        bandwidth: int,
        vertices: int = _USUAL_VERTICES,
        *,
        directions: object | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.bandwidth = check.bandwidth(bandwidth)
        if directions is None:
            places, triangles = sphere_mesh(check.integer(vertices, "vertices", minimum=12, maximum=10**7))
        else:
            own = directions.detach().cpu().numpy() if isinstance(directions, Tensor) else directions
            places, triangles = check.directions(own), np.empty((0, 3), dtype=np.int64)
        grid = grid_from_directions(places)
        # Gradients are of one degree more. Only its synthesis is used, so that any weights do.
        self.sphere = SphericalHarmonicTransform(
            self.bandwidth + 1, grid, equal_weights(grid), device=device, dtype=dtype
        )
        self.register_buffer(
            "triangles", torch.as_tensor(triangles, device=self.sphere.weights.device), persistent=False
        )

    def extra_repr(self) -> str:
        """What ``print`` shows of it."""
        return f"bandwidth={self.bandwidth}, vertices={len(self.sphere.directions)}"

    def _given(self, coefficients: object) -> Tensor:
        given, b = checks.coefficients(coefficients)
        if b > self.bandwidth:
            raise ValueError(f"coefficients are of bandwidth {b}, the decoder of {self.bandwidth}")
        checks.alike(given, "coefficients", self.sphere.weights, "the decoder's buffers")
        return given

    def _slopes(self, coefficients: Tensor) -> Tensor:
        """Gradients on the sphere (…, v, 3)."""
        return self.sphere.inverse(gradient(coefficients)).mT


class RadialDecoder(_Decoder):
    """Star-shaped surfaces r(ω) ω about a centre, as ``RadialShape`` decodes them: vertices and normals.

    Whether radii are positive is not asked: a fit may pass through a surface that is none.

    Args:
        bandwidth: b, the largest that is decoded.
        vertices: At least so many, of an icosphere; see ``triangles``.
        directions: Instead, (v, 3) unit vectors of one's own.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Example:
        >>> shape = fsh.RadialShape.from_geometry(fsh.read_geometry("samples/gem.stl"), bandwidth=8)
        >>> decoder = ft.RadialDecoder(bandwidth=8, dtype=torch.float64)
        >>> coefficients = torch.tensor(shape.coefficients, requires_grad=True)
        >>> surface = decoder(coefficients, torch.tensor(shape.center))
        >>> surface.vertices.shape, decoder.triangles.shape
        (torch.Size([2562, 3]), torch.Size([5120, 3]))
        >>> surface.vertices.square().sum().backward()
    """

    @full_precision
    def forward(self, coefficients: Tensor, center: Tensor | None = None) -> DecodedSurface:
        """Decode (…, b²) about (…, 3), or the origin.

        Raises:
            TypeError, ValueError: Another bandwidth, precision or device; wrong shapes; not finite.
        """
        given = self._given(coefficients)
        radius, outward = self.sphere.inverse(given)[..., None], self.sphere.directions
        normals = nn.functional.normalize(radius * outward - self._slopes(given), dim=-1)
        vertices = radius * outward
        if center is not None:
            middle = checks.real(center, "center")
            checks.last_axis(middle, "center", 3, "3")
            checks.alike(middle, "center", given, "coefficients")
            vertices = vertices + middle[..., None, :]
        return DecodedSurface(vertices, normals)


class ConformalDecoder(_Decoder):
    """Closed surfaces of genus 0, x(ω) over a map, as ``ConformalShape`` decodes them: vertices and normals.

    Args:
        bandwidth: b, the largest that is decoded.
        vertices: At least so many, of an icosphere; see ``triangles``.
        directions: Instead, (v, 3) unit vectors of one's own.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Example:
        >>> decoder = ft.ConformalDecoder(bandwidth=4, vertices=162)
        >>> coefficients = torch.zeros(2, 3, 16)  # two shapes of three functions
        >>> coefficients[:, [0, 1, 2], [3, 1, 2]] = 1.0  # x, y, z themselves
        >>> surface = decoder(coefficients)
        >>> surface.vertices.shape
        torch.Size([2, 162, 3])
        >>> torch.allclose(surface.normals[0], decoder.sphere.directions, atol=1e-5)
        True
    """

    @full_precision
    def forward(self, coefficients: Tensor) -> DecodedSurface:
        """Decode (…, 3, b²).

        Raises:
            TypeError, ValueError: Another bandwidth, precision or device; wrong shapes; not finite.
        """
        given = self._given(coefficients)
        if given.ndim < 2 or given.shape[-2] != 3:
            raise ValueError(f"coefficients must have shape (…, 3, b²), got {tuple(given.shape)}")
        x, y, z = self._slopes(given).unbind(-3)
        outward = self.sphere.directions
        # The surface's area vector over that of the sphere: (ω·∇y×∇z, ω·∇z×∇x, ω·∇x×∇y).
        pairs = ((y, z), (z, x), (x, y))
        area = torch.stack([(outward * torch.linalg.cross(a, b)).sum(-1) for a, b in pairs], -1)
        return DecodedSurface(self.sphere.inverse(given).mT, nn.functional.normalize(area, dim=-1))
