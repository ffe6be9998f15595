"""Shapes as immutable values: coefficients and what is needed to come back."""

from __future__ import annotations

from fsh3d_o3d.shapes.canonical import canonical_rotation
from fsh3d_o3d.shapes.conformal import ConformalShape
from fsh3d_o3d.shapes.cube import ShellVolume
from fsh3d_o3d.shapes.loading import load_shape
from fsh3d_o3d.shapes.radial import RadialShape
from fsh3d_o3d.shapes.shape import Shape
from fsh3d_o3d.shapes.shell import ShellShape
from fsh3d_o3d.shapes.storage import write_arrays

__all__ = [
    "ConformalShape",
    "RadialShape",
    "Shape",
    "ShellShape",
    "ShellVolume",
    "canonical_rotation",
    "load_shape",
    "write_arrays",
]
