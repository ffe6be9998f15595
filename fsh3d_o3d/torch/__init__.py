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
from fsh3d_o3d.torch.conventions import from_e3nn, to_e3nn
from fsh3d_o3d.torch.correlation import CorrelationGrid, correlation
from fsh3d_o3d.torch.encoding import ShellEncoder, encode
from fsh3d_o3d.torch.evaluation import evaluate, evaluate_gradient
from fsh3d_o3d.torch.invariants import cross_shell_invariants
from fsh3d_o3d.torch.layers import QuadraticNonlinearity, ZonalConvolution
from fsh3d_o3d.torch.rotation import rotate_coefficients
from fsh3d_o3d.torch.surfaces import ConformalDecoder, DecodedSurface, RadialDecoder
from fsh3d_o3d.torch.transform import SphericalHarmonicTransform

__all__ = [
    # transform
    "SphericalHarmonicTransform",
    "evaluate",
    "evaluate_gradient",
    # coefficients
    "cross_shell_invariants",
    "degree_energies",
    "filter_coefficients",
    "from_e3nn",
    "heat_filter",
    "to_e3nn",
    # rotation
    "CorrelationGrid",
    "correlation",
    "rotate_coefficients",
    # shapes
    "ConformalDecoder",
    "DecodedSurface",
    "RadialDecoder",
    "ShellEncoder",
    "encode",
    # layers
    "QuadraticNonlinearity",
    "ZonalConvolution",
]
