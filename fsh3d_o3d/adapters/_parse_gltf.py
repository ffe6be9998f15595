"""glTF 2.0 (private): binary .glb, and .gltf with embedded buffers. Nothing outside the file is ever opened."""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.adapters._parse_result import mesh_of
from fsh3d_o3d.adapters._parse_text import text_reason
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import MeshArrays
from fsh3d_o3d.errors import GeometryReadError

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
# A file may place one mesh many times; this bounds what it can grow to, whatever it announces.
_MAXIMUM_TRIANGLES = 100_000_000


def parse_glb(source: Source) -> MeshArrays:
    """Return a binary glTF file as one mesh in scene coordinates."""
    data = source.data
    if data[:4] != b"glTF" or len(data) < 20:
        raise GeometryReadError("does not begin with a whole glTF header")
    version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != 2:
        raise GeometryReadError(f"glTF version {version} is not read, only 2")
    if length != len(data):
        raise GeometryReadError(f"truncated or damaged: the header announces {length} bytes, the file has {len(data)}")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        if at + 8 + size > len(data):
            raise GeometryReadError("damaged: a chunk reaches beyond the end of the file")
        chunks.setdefault(data[at + 4 : at + 8], data[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise GeometryReadError("damaged: there is no JSON chunk")
    return _mesh(source, chunks[b"JSON"], chunks.get(b"BIN\0"))


def parse_gltf(source: Source) -> MeshArrays:
    """Return a glTF file, whose buffers must be embedded, as one mesh in scene coordinates."""
    return _mesh(source, source.data, None)


@dataclass(frozen=True, eq=False)
class _Document:
    """The JSON tree, with every look-up checked."""

    tree: dict[str, Any]
    """The parsed JSON."""
    binary: bytes | None
    """The binary chunk of a .glb."""
    _contents: dict[int, bytes] = field(default_factory=dict)

    def entries(self, kind: str) -> list[Any]:
        """Return a top-level list, empty where it is missing."""
        found = self.tree.get(kind, [])
        if not isinstance(found, list):
            raise GeometryReadError(f"damaged: {kind} is not a list")
        return found

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """Return entry ``index`` of a top-level list."""
        found = self.entries(kind)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(found):
            raise GeometryReadError(f"damaged: there is no entry {str(index)[:20]!r} in {kind}")
        if not isinstance(found[index], dict):
            raise GeometryReadError(f"damaged: entry {index} of {kind} is not an object")
        return cast(dict[str, Any], found[index])

    def buffer(self, index: object) -> bytes:
        """Return the bytes of a buffer: the binary chunk, or those of a data URI, decoded once."""
        buffer = self.entry("buffers", index)
        number = cast(int, index)
        if number not in self._contents:
            self._contents[number] = self._content(number, buffer)
        return self._contents[number]

    def _content(self, index: int, buffer: dict[str, Any]) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            if index != 0 or self.binary is None:
                raise GeometryReadError(f"damaged: buffer {index} has no content")
            content = self.binary
        elif isinstance(uri, str) and uri.startswith("data:"):
            try:
                content = base64.b64decode(uri.partition(";base64,")[2], validate=True)
            except (binascii.Error, ValueError):
                raise GeometryReadError(f"damaged: buffer {index} is not base64") from None
        else:
            shown = text_reason(str(uri).encode("utf-8", "backslashreplace"))
            raise GeometryReadError(f"the buffer lies in another file, {shown}: only embedded buffers are read")
        needed = _natural(buffer, "byteLength")
        if len(content) < needed:
            raise GeometryReadError(f"truncated: buffer {index} announces {needed} bytes and has {len(content)}")
        return content[:needed]

    def accessor(self, index: object, kind: str) -> NDArray[Any]:
        """Return an accessor as a (count, width) array; counts are held against the buffer before any allocation."""
        accessor = self.entry("accessors", index)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise GeometryReadError("sparse accessors, and those without a buffer, are not read")
        component = accessor.get("componentType")
        if accessor.get("type") != kind or not isinstance(component, int) or component not in _COMPONENTS:
            raise GeometryReadError(f"damaged: accessor {index} is not {kind} of a known component type")
        view = self.entry("bufferViews", accessor["bufferView"])
        buffer = self.buffer(view.get("buffer"))
        dtype, width = np.dtype(_COMPONENTS[component]), _WIDTHS[kind]
        size, count = dtype.itemsize * width, _natural(accessor, "count")
        stride = _natural(view, "byteStride", size)
        begin, inner = _natural(view, "byteOffset", 0), _natural(accessor, "byteOffset", 0)
        extent, available = _natural(view, "byteLength"), len(buffer)
        if count == 0 or stride < size or inner + (count - 1) * stride + size > extent or begin + extent > available:
            raise GeometryReadError(f"truncated or damaged: accessor {index} of {count} items exceeds its buffer")
        array: NDArray[Any] = np.ndarray(
            (count, width), dtype, buffer=buffer, offset=begin + inner, strides=(stride, dtype.itemsize)
        )
        if accessor.get("normalized") is True and dtype.kind in "iu":
            array = np.maximum(array / np.iinfo(dtype).max, -1.0)
        return array


def _natural(entry: dict[str, Any], name: str, default: int | None = None) -> int:
    value = entry.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
        raise GeometryReadError(f"damaged: {name} must be a number >= 0")
    return value


def _mesh(source: Source, text: bytes, binary: bytes | None) -> MeshArrays:
    try:
        tree = json.loads(text)
    except RecursionError:
        raise GeometryReadError("damaged: the JSON is nested too deeply") from None
    except ValueError as error:
        raise GeometryReadError(f"truncated or damaged JSON ({str(error)[:80]})") from None
    if not isinstance(tree, dict):
        raise GeometryReadError("the JSON is not a glTF document")
    document = _Document(tree, binary)
    compressed = _COMPRESSED & {name for name in document.entries("extensionsRequired") if isinstance(name, str)}
    if compressed:
        raise GeometryReadError(f"compressed glTF ({', '.join(sorted(compressed))}) is not read")
    pieces: dict[int, tuple[Float64Array, IntArray]] = {}
    vertices: list[Float64Array] = []
    triangles: list[IntArray] = []
    vertex_total = triangle_total = 0
    for index, transform in _placements(document):
        if index not in pieces:
            pieces[index] = _primitives(document, index)
        points, corners = pieces[index]
        triangle_total += len(corners)
        if max(triangle_total, vertex_total + len(points)) > _MAXIMUM_TRIANGLES:
            raise GeometryReadError(f"the scene places more than {_MAXIMUM_TRIANGLES} triangles")
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is reported below
            vertices.append(points @ transform[:3, :3].T + transform[:3, 3])
            mirrored = np.linalg.det(transform[:3, :3]) < 0
        triangles.append((corners[:, ::-1] if mirrored else corners) + vertex_total)
        vertex_total += len(points)
    if not triangles:
        raise GeometryReadError("no surface: the scene places no triangles")
    return mesh_of(source, np.concatenate(vertices), np.concatenate(triangles))


def _placements(document: _Document) -> list[tuple[int, Float64Array]]:
    """Return (mesh, transform) of each node in the scene that has a mesh; without nodes, each mesh as it is."""
    nodes = document.entries("nodes")
    if not nodes:
        return [(index, np.eye(4)) for index in range(len(document.entries("meshes")))]
    if document.entries("scenes"):
        roots = document.entry("scenes", document.tree.get("scene", 0)).get("nodes", [])
    else:
        children = [document.entry("nodes", index).get("children", []) for index in range(len(nodes))]
        below = {child for group in children if isinstance(group, list) for child in group if isinstance(child, int)}
        roots = [index for index in range(len(nodes)) if index not in below]
    stack = [(root, np.eye(4)) for root in _children(roots)]
    placed: list[tuple[int, Float64Array]] = []
    visited: set[int] = set()
    while stack:
        index, parent = stack.pop()
        node = document.entry("nodes", index)
        if index in visited:  # the format asks for a tree; else a small file could unfold without end
            raise GeometryReadError(f"damaged: node {index} has two parents")
        visited.add(index)
        with np.errstate(over="ignore", invalid="ignore"):
            transform = parent @ _local(node)
        if "mesh" in node:
            document.entry("meshes", node["mesh"])
            placed.append((node["mesh"], transform))
        stack.extend((child, transform) for child in reversed(_children(node.get("children", []))))
    return placed


def _children(value: object) -> list[Any]:
    if not isinstance(value, list):
        raise GeometryReadError("damaged: nodes must be a list")
    return value


def _local(node: dict[str, Any]) -> Float64Array:
    if "matrix" in node:
        return _floats(node["matrix"], 16, "matrix").reshape(4, 4).T
    result = np.eye(4)
    x, y, z, w = _floats(node.get("rotation", [0, 0, 0, 1]), 4, "rotation")
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    result[:3, :3] = rotation * _floats(node.get("scale", [1, 1, 1]), 3, "scale")
    result[:3, 3] = _floats(node.get("translation", [0, 0, 0]), 3, "translation")
    return result


def _floats(value: object, count: int, name: str) -> Float64Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all() or np.abs(array).max() > 1e100:
        raise GeometryReadError(f"damaged: {name} of a node must be {count} numbers")
    return array


def _primitives(document: _Document, index: int) -> tuple[Float64Array, IntArray]:
    """Return all triangles of a mesh; points and lines are passed over."""
    vertices: list[Float64Array] = [np.empty((0, 3))]
    triangles: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    offset = total = 0
    primitives = document.entry("meshes", index).get("primitives")
    for primitive in primitives if isinstance(primitives, list) else []:
        if not isinstance(primitive, dict) or not isinstance(primitive.get("attributes"), dict):
            raise GeometryReadError(f"damaged: a primitive of mesh {index} has no attributes")
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            continue
        points = document.accessor(primitive["attributes"].get("POSITION"), "VEC3").astype(np.float64)
        if "indices" in primitive:
            corners = document.accessor(primitive["indices"], "SCALAR")
            if corners.dtype.kind != "u":
                raise GeometryReadError("damaged: indices must be unsigned integers")
            flat = corners.ravel().astype(np.int64)
        else:
            flat = np.arange(len(points))
        if flat.max() >= len(points):
            raise GeometryReadError(f"a face names vertex {flat.max()} of {len(points)}")
        triangles.append(_cut(flat, mode) + offset)
        vertices.append(points)
        offset += len(points)
        total += len(triangles[-1])
        if max(offset, total) > _MAXIMUM_TRIANGLES:
            raise GeometryReadError(f"mesh {index} has more than {_MAXIMUM_TRIANGLES} triangles or vertices")
    return np.concatenate(vertices), np.concatenate(triangles)


def _cut(flat: IntArray, mode: int) -> IntArray:
    if mode == _TRIANGLES:
        if len(flat) % 3:
            raise GeometryReadError(f"damaged: {len(flat)} indices are not triangles")
        return flat.reshape(-1, 3)
    a, b, c = (np.full(max(0, len(flat) - 2), flat[0]) if mode == _FAN else flat[:-2]), flat[1:-1], flat[2:]
    if mode == _FAN:
        return np.stack([a, b, c], axis=1)
    odd = np.arange(len(a)) % 2 == 1
    strip = np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)
    return cast(IntArray, strip[(a != b) & (b != c) & (a != c)])
