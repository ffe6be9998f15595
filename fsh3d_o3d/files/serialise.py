"""From arrays to the bytes of a file; one function a format.

Open3D's writers print six digits (OBJ, OFF) or ten decimals (XYZ, so that 1e-30 becomes 0), and some leave files of
their own beside the target. Here text has the digits that float64 needs and the same arrays give the same bytes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray


@dataclass(frozen=True, eq=False)
class Content:
    """What is written: a mesh, or a cloud of points where there are no triangles."""

    points: Float64Array
    """(n, 3) vertices or points."""
    triangles: IntArray | None
    """(t, 3) vertex indices; None for a cloud."""
    normals: Float64Array | None
    """(n, 3) normals, or None."""
    colors: Float64Array | None
    """(n, 3) colours in [0, 1], or None."""


def ply_bytes(surface: Content) -> bytes:
    """Binary PLY: float64 positions and normals, colours in eight bits."""
    columns: list[tuple[str, str, NDArray[Any]]] = []
    for names, values in (("x y z", surface.points), ("nx ny nz", surface.normals)):
        if values is not None:
            columns += [(name, "double", values[:, axis]) for axis, name in enumerate(names.split())]
    if surface.colors is not None:
        octets = color_bytes(surface.colors)
        columns += [(name, "uchar", octets[:, axis]) for axis, name in enumerate(("red", "green", "blue"))]
    table = np.empty(len(surface.points), dtype=[(name, column.dtype.newbyteorder("<")) for name, _, column in columns])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    for name, kind, column in columns:
        table[name] = column
        header.append(f"property {kind} {name}")
    body = table.tobytes()
    if surface.triangles is not None:
        faces = np.empty(len(surface.triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
        faces["n"], faces["corners"] = 3, surface.triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body


def obj_bytes(surface: Content) -> bytes:
    """Wavefront OBJ, with normals, and with colours behind the coordinates as many programs read them."""
    vertices = surface.points if surface.colors is None else np.hstack([surface.points, surface.colors])
    text = _rows("v", vertices)
    corner = "%d %d %d"
    corners = _triangles(surface) + 1
    if surface.normals is not None:
        text += _rows("vn", surface.normals)
        corner, corners = "%d//%d %d//%d %d//%d", np.repeat(corners, 2, axis=1)
    return (text + format_rows(f"f {corner}\n", corners)).encode("ascii")


def off_bytes(surface: Content) -> bytes:
    """OFF, as NOFF with normals, COFF with colours in eight bits, CNOFF with both."""
    triangles = _triangles(surface)
    columns: list[NDArray[Any]] = [surface.points.astype(object)]
    pattern = "%r %r %r"
    if surface.normals is not None:
        columns.append(surface.normals.astype(object))
        pattern += " %r %r %r"
    if surface.colors is not None:
        columns.append(color_bytes(surface.colors).astype(object))
        pattern += " %d %d %d 255"
    kind = ("C" if surface.colors is not None else "") + ("N" if surface.normals is not None else "") + "OFF"
    header = f"{kind}\n{len(surface.points)} {len(triangles)} 0\n"
    return (header + format_rows(pattern + "\n", np.hstack(columns)) + format_rows("3 %d %d %d\n", triangles)).encode(
        "ascii"
    )


def stl_bytes(surface: Content) -> bytes:
    """Binary STL: float32 corners and the normals of the triangles; neither vertex normals nor colours."""
    corners = surface.points[_triangles(surface)]
    scale = np.abs(corners).max() or 1.0
    sides = (corners[:, 1:] - corners[:, :1]) / scale  # scaled, so that the product neither over- nor underflows
    normals = np.cross(sides[:, 0], sides[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["normal"] = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    facets["corners"] = _as_float32(corners, "STL")
    return b"binary STL".ljust(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


def glb_bytes(surface: Content) -> bytes:
    """Binary glTF 2.0: one mesh; float32 positions, normals and colours."""
    points = _as_float32(surface.points, "glTF")
    blocks: list[tuple[str, NDArray[Any], str, int]] = [("POSITION", points, "VEC3", 34962)]
    if surface.normals is not None:
        length = np.linalg.norm(surface.normals, axis=1, keepdims=True)
        # glTF asks for unit normals; one without direction is given the z axis.
        unit = np.divide(surface.normals, length, out=np.tile([0.0, 0.0, 1.0], (len(length), 1)), where=length > 0)
        blocks.append(("NORMAL", unit.astype("<f4"), "VEC3", 34962))
    if surface.colors is not None:
        blocks.append(("COLOR_0", np.clip(surface.colors, 0, 1).astype("<f4"), "VEC3", 34962))
    blocks.append(("indices", _triangles(surface).astype("<u4"), "SCALAR", 34963))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    offset = 0
    for _, block, kind, target in blocks:
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": block.nbytes, "target": target})
        accessors.append(
            {
                "bufferView": len(accessors),
                "componentType": 5125 if kind == "SCALAR" else 5126,
                "count": block.size if kind == "SCALAR" else len(block),
                "type": kind,
            }
        )
        offset += block.nbytes
    accessors[0] |= {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    attributes = {name: number for number, (name, *_) in enumerate(blocks[:-1])}
    tree = {
        "asset": {"version": "2.0", "generator": "fsh3d_o3d"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(blocks) - 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(tree, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    binary = b"".join(block.tobytes() for _, block, _, _ in blocks)  # four-byte items: aligned as the format asks
    chunks = _chunk(b"JSON", text) + _chunk(b"BIN\0", binary)
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


def xyz_bytes(surface: Content) -> bytes:
    """Lines of coordinates, followed by the normals where there are any; no colours."""
    table = surface.points if surface.normals is None else np.hstack([surface.points, surface.normals])
    return _rows("", table).encode("ascii")


def pcd_bytes(surface: Content) -> bytes:
    """Binary PCD: float32 fields, as the programs that use the format expect, and colours packed in ``rgb``."""
    fields: list[tuple[str, str, NDArray[Any]]] = [
        (name, "<f4", surface.points[:, axis]) for axis, name in enumerate("xyz")
    ]
    if surface.normals is not None:
        fields += [(f"normal_{name}", "<f4", surface.normals[:, axis]) for axis, name in enumerate("xyz")]
    if surface.colors is not None:
        packed = color_bytes(surface.colors).astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)
        fields.append(("rgb", "<u4", packed))
    table = np.empty(len(surface.points), dtype=[(name, dtype) for name, dtype, _ in fields])
    for name, dtype, column in fields:
        table[name] = column if dtype == "<u4" else _as_float32(column, "PCD")
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _, _ in fields),
        "SIZE " + " ".join("4" for _ in fields),
        "TYPE " + " ".join(dtype[1].upper() for _, dtype, _ in fields),
        "COUNT " + " ".join("1" for _ in fields),
        f"WIDTH {len(table)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(table)}",
        "DATA binary\n",
    ]
    return "\n".join(header).encode("ascii") + table.tobytes()


def _triangles(surface: Content) -> IntArray:
    assert surface.triangles is not None
    return surface.triangles


def color_bytes(colors: Float64Array) -> NDArray[np.uint8]:
    """Return colours in [0, 1] in eight bits."""
    return np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)


def _as_float32(values: Float64Array, kind: str) -> NDArray[np.float32]:
    if np.abs(values).max() > np.finfo(np.float32).max:
        raise ValueError(f"{kind} stores float32, which cannot hold {np.abs(values).max():g}: choose .ply or .obj")
    return values.astype("<f4")


def _rows(keyword: str, table: Float64Array) -> str:
    pattern = " ".join(([keyword] if keyword else []) + ["%r"] * table.shape[1])
    return format_rows(pattern + "\n", table)


def format_rows(pattern: str, table: NDArray[Any]) -> str:
    """Return each row of a table in a pattern; ``%r`` is the shortest text that reads back as the same float64."""
    # One formatting operation for the whole table.
    return (pattern * len(table)) % tuple(table.ravel().tolist())


def _chunk(kind: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4, "little") + kind + content
