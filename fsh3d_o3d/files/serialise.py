"""From arrays to the bytes of a file; one function a format.

Open3D's writers print six digits (OBJ, OFF) or ten decimals (XYZ, so that 1e-30 becomes 0), and some leave files of
their own beside the target. Here text has the digits that float64 needs and the same arrays give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray

_PLY_NAMES = frozenset(
    ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", "s", "t", "u", "v", "texture_u", "texture_v")
)
"""Properties of vertices that mean something of their own."""


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
    uvs: Float64Array | None = None
    """(t, 3, 2) texture coordinates of the corners of triangles, or None."""
    attributes: Mapping[str, Float64Array] = field(default_factory=dict)
    """(n,) or (n, k) by name."""


def ply_bytes(surface: Content) -> bytes:
    """Binary PLY: float64 positions, normals and attributes, colours in eight bits, texture coordinates of corners."""
    columns: list[tuple[str, str, NDArray[Any]]] = []
    for names, values in (("x y z", surface.points), ("nx ny nz", surface.normals)):
        if values is not None:
            columns += [(name, "double", values[:, axis]) for axis, name in enumerate(names.split())]
    if surface.colors is not None:
        octets = color_bytes(surface.colors)
        columns += [(name, "uchar", octets[:, axis]) for axis, name in enumerate(("red", "green", "blue"))]
    columns += [(name, "double", values) for name, values in _attribute_columns(surface)]
    table = np.empty(len(surface.points), dtype=[(name, column.dtype.newbyteorder("<")) for name, _, column in columns])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    for name, kind, column in columns:
        table[name] = column
        header.append(f"property {kind} {name}")
    body = table.tobytes()
    if surface.triangles is not None:
        layout: list[Any] = [("n", "u1"), ("corners", "<i4", 3)]
        header += [f"element face {len(surface.triangles)}", "property list uchar int vertex_indices"]
        if surface.uvs is not None:
            layout += [("numbers", "u1"), ("uvs", "<f8", 6)]
            header.append("property list uchar double texcoord")
        faces = np.empty(len(surface.triangles), dtype=layout)
        faces["n"], faces["corners"] = 3, surface.triangles
        if surface.uvs is not None:
            faces["numbers"], faces["uvs"] = 6, surface.uvs.reshape(-1, 6)
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body


def obj_bytes(surface: Content) -> bytes:
    """Wavefront OBJ, with texture coordinates and normals, and colours behind the coordinates as many programs do."""
    vertices = surface.points if surface.colors is None else np.hstack([surface.points, surface.colors])
    text = _rows("v", vertices)
    corner = "%d"
    columns = [_triangles(surface) + 1]
    if surface.uvs is not None:
        places, index = np.unique(surface.uvs.reshape(-1, 2), axis=0, return_inverse=True)
        text += _rows("vt", places)
        columns.append(index.reshape(-1, 3) + 1)
        corner += "/%d"
    if surface.normals is not None:
        text += _rows("vn", surface.normals)
        columns.append(columns[0])
        corner += "/%d" if surface.uvs is not None else "//%d"
    corners = np.stack(columns, axis=2).reshape(len(columns[0]), -1)
    return (text + format_rows(f"f {corner} {corner} {corner}\n", corners)).encode("ascii")


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
    """Binary glTF 2.0: one mesh; float32 positions, normals, colours and texture coordinates.

    A vertex has one place in the texture there: where corners have others, at seams, it is written once for each.
    """
    surface, uvs = _cut_at_seams(surface)
    points = _as_float32(surface.points, "glTF")
    blocks: list[tuple[str, NDArray[Any], str, int]] = [("POSITION", points, "VEC3", 34962)]
    if surface.normals is not None:
        length = np.linalg.norm(surface.normals, axis=1, keepdims=True)
        # glTF asks for unit normals; one without direction is given the z axis.
        unit = np.divide(surface.normals, length, out=np.tile([0.0, 0.0, 1.0], (len(length), 1)), where=length > 0)
        blocks.append(("NORMAL", unit.astype("<f4"), "VEC3", 34962))
    if surface.colors is not None:
        blocks.append(("COLOR_0", np.clip(surface.colors, 0, 1).astype("<f4"), "VEC3", 34962))
    if uvs is not None:
        blocks.append(("TEXCOORD_0", _as_float32(uvs, "glTF"), "VEC2", 34962))
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


def _cut_at_seams(surface: Content) -> tuple[Content, Float64Array | None]:
    """Return a surface whose vertices have one place in the texture each, and those places (n, 2)."""
    if surface.uvs is None:
        return surface, None
    triangles = _triangles(surface)
    rows = np.column_stack((triangles.ravel(), surface.uvs.reshape(-1, 2)))
    found, index = np.unique(rows, axis=0, return_inverse=True)
    vertex = found[:, 0].astype(np.int64)
    if len(np.unique(vertex)) == len(vertex):  # nothing to cut: vertices stay where they are, unused ones too
        uvs = np.zeros((len(surface.points), 2))
        uvs[vertex] = found[:, 1:]
        return surface, uvs
    normals, colors = (None if array is None else array[vertex] for array in (surface.normals, surface.colors))
    uvs = np.asarray(found[:, 1:], dtype=np.float64)
    return Content(surface.points[vertex], index.reshape(-1, 3), normals, colors), uvs


def _attribute_columns(surface: Content) -> list[tuple[str, Float64Array]]:
    """Return a name that PLY allows, and is not of its own, and numbers (n,) for each column of the attributes."""
    columns: dict[str, Float64Array] = {}
    for name, values in surface.attributes.items():
        plain = "_".join(name.encode("ascii", "replace").decode("ascii").split())
        parts = [(plain, values)] if values.ndim == 1 else [(f"{plain}_{k}", one) for k, one in enumerate(values.T)]
        columns |= {f"{part}_" if part in _PLY_NAMES else part: one for part, one in parts}
    return list(columns.items())


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
