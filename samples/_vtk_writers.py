"""Writers of VTK: legacy text, PolyData with raw bytes, and an unstructured grid of solid cells as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _scene_writers import words
from _writers import Array, rounded

Polygons = Sequence[Sequence[int]]
_WEDGE = 13  # VTK's number of a prism over a triangle


def write_vtk(path: Path, points: Array, polygons: Polygons) -> None:
    """Legacy VTK with polygons, and their height as a value at each point."""
    lines = [" ".join(map(str, [len(polygon), *polygon])) for polygon in polygons]
    total = sum(len(polygon) + 1 for polygon in polygons)
    path.write_bytes(
        (
            f"# vtk DataFile Version 3.0\na bracket\nASCII\nDATASET POLYDATA\nPOINTS {len(points)} double\n"
            + "".join(f"{words(point)}\n" for point in rounded(points))
            + f"POLYGONS {len(polygons)} {total}\n"
            + "".join(f"{line}\n" for line in lines)
            + f"POINT_DATA {len(points)}\nSCALARS height double 1\nLOOKUP_TABLE default\n"
            + f"{words(rounded(points[:, 2]))}\n"
        ).encode("ascii")
    )


def write_vtp(path: Path, points: Array, polygons: Polygons) -> None:
    """PolyData: arrays as raw bytes behind the XML."""
    blocks = [
        rounded(points).astype("<f8").tobytes(),
        np.array([corner for polygon in polygons for corner in polygon], dtype="<i4").tobytes(),
        np.cumsum([len(polygon) for polygon in polygons]).astype("<i4").tobytes(),
    ]
    places = np.cumsum([0] + [4 + len(block) for block in blocks])[:-1].tolist()
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian">\n<PolyData>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfPolys="{len(polygons)}"><Points><DataArray type="Float64" '
        f'NumberOfComponents="3" format="appended" offset="{places[0]}"/></Points><Polys><DataArray type="Int32" '
        f'Name="connectivity" format="appended" offset="{places[1]}"/><DataArray type="Int32" Name="offsets" '
        f'format="appended" offset="{places[2]}"/></Polys></Piece></PolyData>\n<AppendedData encoding="raw">_'
    )
    body = b"".join(len(block).to_bytes(4, "little") + block for block in blocks)
    path.write_bytes(head.encode("ascii") + body + b"</AppendedData>\n</VTKFile>\n")


def write_vtu(path: Path, points: Array, outline: Array) -> None:
    """An unstructured grid: the bracket filled with four prisms, whose outer faces are its surface."""
    count = len(outline)
    # Corners of a wedge run so that the first triangle looks outward, VTK's way: here downward.
    caps = np.array([[5, 4, 3], [5, 3, 0], [3, 2, 0], [2, 1, 0]])
    wedges = np.hstack([caps, caps + count])
    lists = {
        "connectivity": wedges,
        "offsets": np.arange(6, 6 * len(wedges) + 1, 6),
        "types": np.full(len(wedges), _WEDGE),
    }
    cells = "".join(
        f'<DataArray type="Int32" Name="{name}" format="ascii">{words(v)}</DataArray>\n' for name, v in lists.items()
    )
    path.write_bytes(
        (
            '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">\n'
            f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(wedges)}">\n<Points>'
            f'<DataArray type="Float64" NumberOfComponents="3" format="ascii">{words(rounded(points))}</DataArray>'
            f"</Points>\n<Cells>{cells}</Cells></Piece></UnstructuredGrid>\n</VTKFile>\n"
        ).encode("ascii")
    )
