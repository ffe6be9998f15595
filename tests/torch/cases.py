"""What tests of the PyTorch layer share: tensors in float64 and comparisons in the norm of what is compared."""

from __future__ import annotations

import numpy as np
import torch


def randn(*shape: int, seed: int = 0, grad: bool = False, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Normal numbers, the same each time."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64).to(dtype).requires_grad_(grad)


def rotation(seed: int = 0, *shape: int) -> torch.Tensor:
    """Rotations (…, 3, 3), uniformly distributed."""
    q, r = torch.linalg.qr(randn(*shape, 3, 3, seed=seed))
    q = q * torch.sign(torch.diagonal(r, dim1=-2, dim2=-1))[..., None, :]
    return q * torch.linalg.det(q)[..., None, None]


def exponential(vectors: torch.Tensor) -> torch.Tensor:
    """Rotations about vectors (…, 3), with gradients: what a network would make rotations by."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(cross)


def difference(found: object, expected: object) -> float:
    """Relative difference in the L2 norm."""
    a, b = (np.asarray(part.detach() if isinstance(part, torch.Tensor) else part) for part in (found, expected))
    assert a.shape == b.shape, (a.shape, b.shape)
    return float(np.linalg.norm(a - b)) / max(float(np.linalg.norm(b)), 1e-300)
