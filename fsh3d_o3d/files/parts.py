"""What a file tells apart in its geometry: components, scans, labels, each by itself."""

from __future__ import annotations

import os
import warnings
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import printable
from fsh3d_o3d.errors import GeometryReadWarning
from fsh3d_o3d.files.formats import ReadFile
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry import GEOMETRY_KINDS, GeometryKind, MeshArrays, PointArrays, to_open3d


def read_geometry_parts(
    path: str | os.PathLike[str], *, kind: GeometryKind = "legacy", isolated: bool = True
) -> list[tuple[str, Any]]:
    """Read a file part by part: names, and Open3D geometry of each, all in the frame of the file.

    Parts are what is built by 3MF, what COLLADA, X3D and FBX place, the scans of E57, the labels of a volume and the
    pieces of VTK. All others have one part, named like the file. ``read_geometry`` returns them put together.

    Args:
        path: The file.
        kind: Kind of the Open3D geometry.
        isolated: Parse in a separate process.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: The file cannot be read: one line that names the file and the reason.

    Warns:
        GeometryReadWarning: The file was read in spite of something.

    Example:
        >>> for name, surface in fsh.read_geometry_parts("samples/formats/labels.nrrd"):
        ...     print(name, surface.is_watertight())
        label 1 True
        label 2 True
    """
    check.choice(kind, "kind", GEOMETRY_KINDS)
    found = read_geometry_file(path, isolated=isolated)
    for note in found.notes:
        warnings.warn(printable(f"{os.fsdecode(path)}: {note}"), GeometryReadWarning, stacklevel=2)
    if not found.parts:
        return [(os.path.basename(os.fsdecode(path)), to_open3d(found.geometry, kind=kind))]  # noqa: PTH119 - any bytes
    return [(name, to_open3d(part, kind=kind)) for name, part in parts_of(found)]


def parts_of(found: ReadFile) -> list[tuple[str, MeshArrays | PointArrays]]:
    """Return the parts of what was read, by name."""
    geometry = found.geometry
    result: list[tuple[str, MeshArrays | PointArrays]] = []
    point = row = 0
    for part in found.parts:
        own = slice(point, point + part.points)
        values = {name: array[own] for name, array in geometry.attributes.items()}
        beside = [None if array is None else array[own] for array in (geometry.normals, geometry.colors)]
        if isinstance(geometry, MeshArrays):
            triangles = geometry.triangles[row : row + part.triangles] - point
            mesh = MeshArrays(geometry.vertices[own], triangles, beside[0], beside[1], attributes=values)
            result.append((part.name, mesh))
        else:
            result.append((part.name, PointArrays(geometry.points[own], beside[0], beside[1], attributes=values)))
        point += part.points
        row += part.triangles
    return result
