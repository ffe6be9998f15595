"""The right method by itself: which shape holds a geometry best, tried and measured."""

from __future__ import annotations

from fsh3d_o3d.reconstruction.reconstruct import TOLERANCE, choose, reconstruct, redecoded
from fsh3d_o3d.reconstruction.reconstruction import Reconstruction, Trial

__all__ = [
    "Reconstruction",
    "TOLERANCE",
    "Trial",
    "choose",
    "reconstruct",
    "redecoded",
]
