"""VTP: PolyData of VTK, its arrays as raw bytes behind the XML."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.files.serialise import Content, color_bytes

_KINDS = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def vtp_bytes(surface: Content) -> bytes:
    """VTP: float64 positions and normals, colours in eight bits; in a cloud each point is a cell, and so is shown."""
    blocks: list[bytes] = []
    offset = 0

    def array(name: str, values: NDArray[Any]) -> str:
        nonlocal offset
        content = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
        place, offset = offset, offset + 8 + len(content)
        blocks.append(len(content).to_bytes(8, "little") + content)
        width = values.shape[1] if values.ndim == 2 else 1
        return (
            f'<DataArray type="{_KINDS[values.dtype.str[1:]]}" Name="{name}" NumberOfComponents="{width}" '
            f'format="appended" offset="{place}"/>'
        )

    points = array("Points", surface.points)
    values = named = ""
    if surface.normals is not None:
        values += array("Normals", surface.normals)
        named += ' Normals="Normals"'
    if surface.colors is not None:
        values += array("RGB", color_bytes(surface.colors))
        named += ' Scalars="RGB"'
    if surface.triangles is None:
        group, cells = "Verts", np.arange(len(surface.points))[:, None]
    else:
        group, cells = "Polys", surface.triangles
    ends = np.arange(1, len(cells) + 1) * cells.shape[1]
    lists = array("connectivity", cells.ravel().astype(np.int64)) + array("offsets", ends.astype(np.int64))
    text = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<PolyData><Piece NumberOfPoints="{len(surface.points)}" NumberOf{group}="{len(cells)}">\n'
        f"<PointData{named}>{values}</PointData>\n<Points>{points}</Points>\n<{group}>{lists}</{group}>\n"
        '</Piece></PolyData>\n<AppendedData encoding="raw">_'
    )
    return text.encode("ascii") + b"".join(blocks) + b"</AppendedData>\n</VTKFile>\n"
