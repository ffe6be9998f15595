"""Binary OFF: Geomview's big-endian numbers, and what other programs write."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.off_vertices import OffVertices
from fsh3d_o3d.files.formats.ply_binary import read_binary_element
from fsh3d_o3d.files.formats.result import polygon_mesh_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_WORD = 4  # bytes of every number, an int32 or a float32


def read_binary_off(source: Source, prefix: str, offset: int) -> MeshArrays | PointArrays:
    """Return what follows the line of the keyword: counts, vertices, and faces with the number of their colour's parts.

    The format is big-endian. Some programs write little-endian numbers, or leave out the faces' colours: what is taken
    is the first of the four readings that leaves nothing behind.
    """
    tried = [_read(source.data, offset, prefix, order, colored=colored) for order in "><" for colored in (True, False)]
    found = [one for one in tried if not isinstance(one, str)]
    if not found:
        raise GeometryReadError(next(reason for reason in tried if isinstance(reason, str)))
    rest, order, table, corners, counts = min(found, key=lambda one: one[0])
    if rest:
        source.note(f"{counted(rest, 'byte')} behind the numbers that the header announces passed over")
    if order == "<":
        source.note("binary numbers are little-endian, the format is big-endian")
    vertices = OffVertices.of(source, prefix, table)
    if not len(counts):
        return vertices.cloud(source)
    return polygon_mesh_of(source, vertices.positions, corners, np.cumsum(counts) - counts, counts, vertices.values)


def _read(
    data: bytes, offset: int, prefix: str, order: str, *, colored: bool
) -> tuple[int, str, Float64Array, IntArray, IntArray] | str:
    """Return bytes left behind, byte order, vertices, and faces one after another with their counts; or why not."""
    try:
        if "n" in prefix:
            OffVertices.check_dimension(int(_integers(data, offset, order, 1)[0]))
            offset += _WORD
        vertices, faces, _ = _integers(data, offset, order, 3).tolist()
        offset += 3 * _WORD
        (width,) = OffVertices.widths(prefix, color=(4,))
        if not 0 < vertices <= (len(data) - offset) // (width * _WORD) or faces < 0:
            return (
                f"truncated or damaged: {vertices} vertices and {faces} faces are announced, "
                f"but {counted(len(data) - offset, 'byte')} follow"
            )
        table = np.frombuffer(data, dtype=f"{order}f4", count=vertices * width, offset=offset).reshape(-1, width)
        layout: list[tuple[str, str | None]] = [(f"{order}i4", f"{order}i4")]
        if colored:
            layout.append((f"{order}f4", f"{order}i4"))
        columns, offset = read_binary_element(data, offset + table.nbytes, "face", faces, layout)
    except GeometryReadError as error:
        return str(error)
    corners, counts = columns[0]
    assert counts is not None
    if faces and (counts.min() < 1 or corners.min() < 0 or corners.max() >= vertices):
        return f"damaged: faces refer to vertices that are not among the {vertices}"
    rest = len(data[offset:].rstrip(b"\0 \t\r\n"))
    return rest, order, table.astype(np.float64), corners.astype(np.int64), counts


def _integers(data: bytes, offset: int, order: str, count: int) -> IntArray:
    if len(data) < offset + count * _WORD:
        raise GeometryReadError("truncated: the numbers of vertices and faces are missing behind OFF BINARY")
    return np.frombuffer(data, dtype=f"{order}i4", count=count, offset=offset).astype(np.int64)
