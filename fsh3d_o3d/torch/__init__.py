"""The transform and what follows it inside of networks: PyTorch modules and functions with gradients.

``from fsh3d_o3d import torch as ft``; the extra ``torch`` installs what it needs; ``import fsh3d_o3d`` never loads it.
Coefficients, grids, weights and rotations are those of the NumPy layer, and so are the numbers.
"""

from __future__ import annotations

from fsh3d_o3d._imports import import_installed

try:
    import_installed("torch")
except ModuleNotFoundError as error:
    if error.name != "torch":
        raise
    raise ImportError(
        "fsh3d_o3d.torch needs PyTorch, which is not installed: pip install 'fsh3d-o3d[torch]', or the build for your "
        "device from pytorch.org"
    ) from error

from fsh3d_o3d.torch.coefficients import degree_energies, filter_coefficients, heat_filter
from fsh3d_o3d.torch.evaluation import evaluate, evaluate_gradient
from fsh3d_o3d.torch.transform import SphericalHarmonicTransform

__all__ = [
    "SphericalHarmonicTransform",
    "degree_energies",
    "evaluate",
    "evaluate_gradient",
    "filter_coefficients",
    "heat_filter",
]
