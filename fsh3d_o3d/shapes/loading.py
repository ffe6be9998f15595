"""Shapes from files."""

from __future__ import annotations

import os

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.shapes.conformal import ConformalShape
from fsh3d_o3d.shapes.radial import RadialShape
from fsh3d_o3d.shapes.shell import ShellShape
from fsh3d_o3d.shapes.storage import read_arrays

__all__ = ["load_shape"]


def load_shape(path: str | os.PathLike[str]) -> RadialShape | ShellShape | ConformalShape:
    """Read a shape that ``save`` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: Not a shape file, damaged, or of a newer format version.
    """
    kind, arrays = read_arrays(path)
    if kind == RadialShape.__name__:
        return RadialShape._from_arrays(path, arrays)
    if kind == ShellShape.__name__:
        return ShellShape._from_arrays(path, arrays)
    if kind == ConformalShape.__name__:
        return ConformalShape._from_arrays(path, arrays)
    raise GeometryReadError(f"{os.fspath(path)}: a shape of kind {kind!r}, which this version does not know")
