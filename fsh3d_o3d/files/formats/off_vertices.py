"""Vertices of an OFF file: positions, normals, colours and texture coordinates, told apart by the keyword."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import VertexValues, cloud_of
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import PointArrays

_NORMAL = 3  # numbers of a normal
_TEXTURE = 2  # numbers of a texture coordinate


@dataclass(frozen=True, eq=False)
class OffVertices:
    """Vertices with what the letters before the keyword say stands behind them: N normals, C colours, ST texture."""

    positions: Float64Array
    """(v, 3)."""
    normals: Float64Array | None
    """(v, 3), or None."""
    colors: Float64Array | None
    """(v, 3) in [0, 1], or None."""
    uvs: Float64Array | None
    """(v, 2) texture coordinates, or None."""

    @property
    def values(self) -> VertexValues:
        """All but the positions."""
        return VertexValues(self.normals, self.colors, self.uvs)

    @staticmethod
    def check_dimension(dimension: int) -> None:
        """Raise where nOFF is not in three dimensions."""
        if dimension != 3:
            raise GeometryReadError(f"nOFF in {dimension} dimensions is not read, only in 3")

    @staticmethod
    def widths(prefix: str, *, color: tuple[int, ...] = (4, 3)) -> tuple[int, ...]:
        """Return how many numbers a vertex may have; colours may come with their transparency or without."""
        fixed = (4 if "4" in prefix else 3) + _NORMAL * ("N" in prefix) + _TEXTURE * ("ST" in prefix)
        return tuple(fixed + size for size in color) if "C" in prefix else (fixed,)

    @classmethod
    def of(cls, source: Source, prefix: str, table: Float64Array) -> OffVertices:
        """Return what the columns of a (v, c) table hold, in the order position, normal, colour, texture."""
        size = 4 if "4" in prefix else 3
        if table.shape[1] < size:
            raise GeometryReadError(f"each vertex needs {size} numbers, found {table.shape[1]}")
        positions = table[:, :3]
        if size == 4:
            weight = table[:, 3]
            if not ((weight > 0).all() or (weight < 0).all()):
                raise GeometryReadError("the fourth, homogeneous coordinate of 4OFF must not be 0 nor change its sign")
            if (weight != 1).any():
                source.note("coordinates are divided by the fourth, homogeneous one")
                positions = positions / weight[:, None]
        at = size
        normals = table[:, at : at + _NORMAL] if "N" in prefix and table.shape[1] >= at + _NORMAL else None
        at += _NORMAL * ("N" in prefix)
        colors = _colors(table[:, at : at + 3]) if "C" in prefix and table.shape[1] in cls.widths(prefix) else None
        uvs = table[:, -_TEXTURE:] if "ST" in prefix and table.shape[1] in cls.widths(prefix) else None
        return cls(positions, normals, colors, uvs)

    def cloud(self, source: Source) -> PointArrays:
        """Return the vertices as points; normals that are not finite are left out."""
        normals = self.normals if self.normals is not None and np.isfinite(self.normals).all() else None
        return cloud_of(source, self.positions, normals, self.colors)


def _colors(colors: Float64Array) -> Float64Array | None:
    """Return colours in [0, 1], given as fractions or as integers to 255; None where they are neither."""
    if not (colors.min() >= 0 and colors.max() <= 255):
        return None
    if colors.max() <= 1:
        return colors
    return colors / 255 if (colors == np.rint(colors)).all() else None
