"""Writers of the sample files: the same arrays give the same bytes on every machine.

Coordinates are rounded to `DECIMALS` before they are written. That hides the last bits, in which the sine of one
processor differs from that of another. No writer puts a date, a path or a version into a file.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

DECIMALS = 5  # of coordinates of size 1: a hundred times finer than any triangle here
Array = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def rounded(values: Array, decimals: int = DECIMALS) -> Array:
    """Round, and turn -0.0 into 0.0 so that a text file does not depend on the sign of zero."""
    return np.round(values, decimals) + 0.0


def table(values: NDArray[np.generic], fmt: str) -> str:
    """Lines of text, one a row of `values` (n, k); `fmt` is one format for all columns or one for the whole row."""
    stream = io.StringIO()
    np.savetxt(stream, values, fmt=fmt, newline="\n")
    return stream.getvalue()


def _coordinates(points: Array, decimals: int = DECIMALS) -> str:
    return table(rounded(points, decimals), f"%.{decimals}f")


def _write_text(path: Path, text: str) -> None:
    path.write_bytes(text.encode("ascii"))


def _ply_header(encoding: str, vertices: Mapping[str, str], vertex_count: int, triangle_count: int) -> str:
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {vertex_count}"]
    lines += [f"property {kind} {name}" for name, kind in vertices.items()]
    if triangle_count:
        lines += [f"element face {triangle_count}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""])


_XYZ = {"x": "float", "y": "float", "z": "float"}


def write_ply(path: Path, points: Array, triangles: IndexArray | None = None) -> None:
    """Binary little-endian PLY with float32 coordinates: a mesh, or a cloud where `triangles` is None."""
    count = 0 if triangles is None else len(triangles)
    data = _ply_header("binary_little_endian", _XYZ, len(points), count).encode("ascii")
    data += rounded(points).astype("<f4").tobytes()
    if triangles is not None:
        faces = np.empty(count, dtype=[("size", "u1"), ("corners", "<i4", (3,))])
        faces["size"], faces["corners"] = 3, triangles
        data += faces.tobytes()
    path.write_bytes(data)


def write_ascii_ply(path: Path, points: Array, triangles: IndexArray, *, decimals: int) -> None:
    """ASCII PLY with double coordinates of `decimals` decimals, where the fifth is not enough."""
    header = _ply_header("ascii", {"x": "double", "y": "double", "z": "double"}, len(points), len(triangles))
    _write_text(path, header + _coordinates(points, decimals) + table(triangles, "3 %d %d %d"))


def write_off(path: Path, points: Array, triangles: IndexArray) -> None:
    """OFF as the Princeton Shape Benchmark has it."""
    header = f"OFF\n{len(points)} {len(triangles)} 0\n"
    _write_text(path, header + _coordinates(points) + table(triangles, "3 %d %d %d"))


def write_obj(path: Path, points: Array, polygons: Iterable[IndexArray]) -> None:
    """Wavefront OBJ; every array of `polygons` (t, k) holds faces of k corners."""
    text = "".join("f " + table(faces + 1, "%d").rstrip("\n").replace("\n", "\nf ") + "\n" for faces in polygons)
    _write_text(path, "v " + _coordinates(points).rstrip("\n").replace("\n", "\nv ") + "\n" + text)


def write_stl(path: Path, points: Array, triangles: IndexArray) -> None:
    """Binary STL: every triangle has its own three corners, equal to the bit where they meet."""
    corners = rounded(points).astype("<f4")[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    normals = rounded(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    records = np.zeros(
        len(triangles), dtype=[("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    records["normal"], records["corners"] = normals, corners
    path.write_bytes(b"fsh3d_o3d sample".ljust(80, b" ") + struct.pack("<I", len(records)) + records.tobytes())


def write_xyz(path: Path, points: Array, extra: Array) -> None:
    """Rows `x y z` and the columns of `extra`: unit normals (.xyzn) or colours in [0, 1] (.xyzrgb)."""
    _write_text(path, table(np.hstack([rounded(points), rounded(extra, 3)]), " ".join(["%.5f"] * 3 + ["%.3f"] * 3)))


def write_pcd(path: Path, points: Array, colors: Array) -> None:
    """ASCII PCD 0.7; `colors` (n, 3) in [0, 1] travel packed into one unsigned number, as PCL has them."""
    red, green, blue = np.round(colors * 255).astype(np.int64).T
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\n"
        f"COUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    )
    rows = np.column_stack([rounded(points), red << 16 | green << 8 | blue])
    _write_text(path, header + table(rows, "%.5f %.5f %.5f %d"))


def write_glb(path: Path, points: Array, triangles: IndexArray) -> None:
    """Binary glTF 2.0: a JSON chunk that describes one primitive, and a chunk of indices and float32 positions."""
    positions, indices = rounded(points).astype("<f4"), triangles.astype("<u4")
    binary = indices.tobytes() + positions.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5125, "count": indices.size, "type": "SCALAR"},
            {
                "bufferView": 1,
                "componentType": 5126,
                "count": len(positions),
                "type": "VEC3",
                "min": positions.min(axis=0).tolist(),
                "max": positions.max(axis=0).tolist(),
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": indices.nbytes, "target": 34963},
            {"buffer": 0, "byteOffset": indices.nbytes, "byteLength": positions.nbytes, "target": 34962},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)  # chunks are multiples of four bytes; `binary` is one already
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
