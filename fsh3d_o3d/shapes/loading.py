"""Shapes from files."""

from __future__ import annotations

import os
from dataclasses import Field, fields
from typing import Any

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import Source, parse_with
from fsh3d_o3d.geometry import MeshArrays
from fsh3d_o3d.shapes.attributes import attributes_from_arrays
from fsh3d_o3d.shapes.conformal import ConformalShape
from fsh3d_o3d.shapes.radial import RadialShape
from fsh3d_o3d.shapes.shell import ShellShape
from fsh3d_o3d.shapes.storage import STORED_NAMES, read_arrays

__all__ = ["load_shape"]

_NAMELESS = "shape.npz"  # stands for a file whose name its reader tells


def load_shape(path: str | os.PathLike[str]) -> RadialShape | ShellShape | ConformalShape:
    """Read a shape that ``save`` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: Not a shape file, damaged, or of a newer format version.

    Example:
        >>> mesh = fsh.read_geometry("samples/gem.stl")
        >>> fsh.RadialShape.from_geometry(mesh, bandwidth=8).save("gem.npz")
        >>> shape = fsh.load_shape("gem.npz")
        >>> type(shape).__name__, shape.bandwidth
        ('RadialShape', 8)
    """
    return _shape(path, *read_arrays(path))


def _surface(source: Source) -> MeshArrays:
    """Return the surface of a shape's file: so that a shape can be given wherever geometry can."""
    try:
        return _shape(_NAMELESS, *read_arrays(_NAMELESS, source.data)).mesh_arrays()[0]
    except GeometryReadError as error:
        raise GeometryReadError(str(error).removeprefix(f"{_NAMELESS}: ")) from None


parse_with(".npz", _surface)


def _shape(
    path: str | os.PathLike[str], name: str, arrays: dict[str, Any]
) -> RadialShape | ShellShape | ConformalShape:
    for shape in (RadialShape, ShellShape, ConformalShape):
        if shape.__name__ == name:
            try:
                return shape(**{field.name: _value(path, arrays, field) for field in fields(shape)})
            except GeometryReadError:
                raise
            except (ValueError, TypeError) as error:
                raise GeometryReadError(f"{os.fspath(path)}: {error}") from None
    if name == "features":
        raise GeometryReadError(f"{os.fspath(path)}: it holds features, as fsh3d describe writes them, and no shape")
    raise GeometryReadError(f"{os.fspath(path)}: a shape of kind {name!r}, which this version does not know")


def _value(path: str | os.PathLike[str], arrays: dict[str, Any], field: Field[Any]) -> Any:
    """What a file holds for a field; the shape itself checks shapes and numbers."""
    if field.name == "attributes":
        radii = arrays.get("radii")
        return attributes_from_arrays(path, arrays, None if radii is None else radii.size)
    name = STORED_NAMES.get(field.name, field.name)
    if name not in arrays:
        if name == "geometry":
            return field.default
        raise ValueError(f"{name} is missing")
    array = arrays[name]
    expected = "fiu" if field.type in ("float", "Float64Array") else "U"
    if array.dtype.kind not in expected or (array.ndim > 0) != (field.type == "Float64Array"):
        raise ValueError(f"{name} is malformed ({array.dtype}, shape {array.shape})")
    return array if array.ndim else array.item()
