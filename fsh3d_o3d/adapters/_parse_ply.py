"""Stanford PLY (private): text and binary, polygons, triangle strips and bare points."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.adapters._parse_ply_binary import read_binary_element
from fsh3d_o3d.adapters._parse_result import cloud_of, mesh_of, polygon_mesh_of
from fsh3d_o3d.adapters._parse_text import NumberRows, TextLines, indices, text_reason
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import MeshArrays, PointArrays
from fsh3d_o3d.errors import GeometryReadError

_SHORT_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float"}
_LONG_TYPES = {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)}
_TYPES = {
    **{name: dtype for dtype, name in _SHORT_TYPES.items()},
    **_LONG_TYPES,
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAXIMUM_HEADER = 1 << 20
_INDEX_LISTS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element."""

    name: str
    """Name in the header."""
    dtype: str
    """NumPy type of the value, or of a list's items, in the file's byte order."""
    count_dtype: str | None = None
    """Type of a list's length; None for a single value."""


@dataclass(frozen=True)
class PlyElement:
    """A table of the file: ``count`` records of the same properties."""

    name: str
    """Name in the header."""
    count: int
    """Number of records."""
    properties: tuple[PlyProperty, ...]
    """What a record holds, in order."""


@dataclass(frozen=True, eq=False)
class PlyColumn:
    """All values of one property."""

    values: Float64Array
    """(count,) values, or (sum of the lengths,) items of lists."""
    counts: IntArray | None
    """(count,) lengths of the lists; None for single values."""
    dtype: str
    """Type in the file: colours are fractions or integers."""


def parse_ply(source: Source) -> MeshArrays | PointArrays:
    """Return a PLY file as a mesh, or as a point cloud where it has no faces."""
    data = source.data
    order, elements, offset = _header(data)
    tables = _read_text(data[offset:], elements) if order == "" else _read_binary(data, offset, elements)
    vertex = tables.get("vertex")
    if vertex is None or any(name not in vertex or vertex[name].counts is not None for name in "xyz"):
        raise GeometryReadError("there is no vertex element with x, y and z")
    points = _stack(vertex, "xyz")
    for name, reader in (("face", _polygons), ("tristrips", _strips)):
        columns = tables.get(name)
        size = next((element.count for element in elements if element.name == name), 0)
        if columns is not None and size > 0:
            lists = next((columns[key] for key in _INDEX_LISTS if key in columns), None)
            if lists is None or lists.counts is None:
                raise GeometryReadError(f"element {name} has no list of vertex indices")
            return reader(source, points, indices(lists.values, "vertex indices"), lists.counts)
    normals = _stack(vertex, ("nx", "ny", "nz")) if all(name in vertex for name in ("nx", "ny", "nz")) else None
    return cloud_of(source, points, normals, _colors(vertex))


def _header(data: bytes) -> tuple[str, list[PlyElement], int]:
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)", data[:_MAXIMUM_HEADER])
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise GeometryReadError("does not begin with ply")
    if end is None:
        raise GeometryReadError("truncated: the header has no end_header")
    order: str | None = None
    elements: list[PlyElement] = []
    for line in re.split(rb"[\r\n]+", data[: end.start()])[1:]:
        words = line.decode("latin-1").split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if kind in _ORDERS and order is None:
                order = _ORDERS[kind]
            case ["element", name, number] if number.isascii() and number.isdigit() and len(number) <= 18:
                if name in {element.name for element in elements}:
                    raise GeometryReadError(f"element {text_reason(name.encode())} is announced twice")
                elements.append(PlyElement(name, int(number), ()))
            case ["property", *what] if elements and order is not None:
                old = elements[-1]
                elements[-1] = PlyElement(old.name, old.count, (*old.properties, _property(what, order, old, line)))
            case _:
                raise GeometryReadError(f"header line {text_reason(line)} is not understood")
    if order is None:
        raise GeometryReadError("the header names no format")
    return order, elements, end.end()


def _property(words: list[str], order: str, element: PlyElement, line: bytes) -> PlyProperty:
    match words:
        case ["list", counts, items, name] if counts in _TYPES and items in _TYPES and _TYPES[counts][0] in "iu":
            result = PlyProperty(name, order + _TYPES[items], order + _TYPES[counts])
        case [kind, name] if kind in _TYPES:
            result = PlyProperty(name, order + _TYPES[kind])
        case _:
            raise GeometryReadError(f"header line {text_reason(line)} is not understood")
    if name in {known.name for known in element.properties}:
        raise GeometryReadError(f"property {text_reason(name.encode())} is announced twice")
    return result


def _read_text(text: bytes, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    lines = TextLines.of(text)
    expected = sum(element.count for element in elements if element.properties)
    if len(lines) != expected:
        raise GeometryReadError(f"the header announces {expected} lines, but {len(lines)} follow")
    tables, row = {}, 0
    for element in elements:
        if element.properties:
            tables[element.name] = _text_columns(element, lines.span(row, row + element.count))
            row += element.count
    return tables


def _text_columns(element: PlyElement, rows: NumberRows) -> dict[str, PlyColumn]:
    starts = rows.starts
    at = np.zeros_like(starts)
    columns: dict[str, PlyColumn] = {}
    for entry in element.properties:
        _inside_row(element, rows, at + 1)
        first = rows.values[starts + at]
        at = at + 1
        if entry.count_dtype is None:
            columns[entry.name] = PlyColumn(first, None, entry.dtype)
            continue
        counts = indices(first, "list lengths")
        if len(counts) and counts.min() < 0:
            raise GeometryReadError(f"a list of {counts.min()} items in element {element.name}")
        _inside_row(element, rows, at + counts)
        step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        columns[entry.name] = PlyColumn(rows.values[np.repeat(starts + at, counts) + step], counts, entry.dtype)
        at = at + counts
    over = np.flatnonzero(at != rows.counts)
    if len(over):
        raise GeometryReadError(
            f"{element.name} {over[0]} has {rows.counts[over[0]]} numbers where the header asks for {at[over[0]]}"
        )
    return columns


def _inside_row(element: PlyElement, rows: NumberRows, needed: IntArray) -> None:
    short = np.flatnonzero(needed > rows.counts)
    if len(short):
        raise GeometryReadError(f"{element.name} {short[0]} is cut short at {rows.counts[short[0]]} numbers")


def _read_binary(data: bytes, offset: int, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    tables = {}
    for element in elements:
        if not element.properties:
            continue
        layout = [(entry.dtype, entry.count_dtype) for entry in element.properties]
        columns, offset = read_binary_element(data, offset, element.name, element.count, layout)
        tables[element.name] = {
            entry.name: PlyColumn(values, counts, entry.dtype)
            for entry, (values, counts) in zip(element.properties, columns, strict=True)
        }
    if data[offset:].strip():
        raise GeometryReadError(f"{len(data) - offset} bytes follow the elements that the header announces")
    return tables


def _polygons(source: Source, points: Float64Array, corners: IntArray, counts: IntArray) -> MeshArrays:
    return polygon_mesh_of(source, points, corners, np.cumsum(counts) - counts, counts)


def _strips(source: Source, points: Float64Array, strips: IntArray, counts: IntArray) -> MeshArrays:
    """Triangles of strips that −1 ends; every second one is turned, stitches of no area are left out."""
    # Lists are separate strips as well: a −1 behind each.
    strips = np.insert(strips, np.cumsum(counts), -1)
    position = np.arange(len(strips))
    last_break = np.maximum.accumulate(np.where(strips == -1, position, -1))
    a, b, c = strips[:-2], strips[1:-1], strips[2:]
    real = (a != -1) & (b != -1) & (c != -1) & (a != b) & (b != c) & (a != c)
    odd = (position[:-2] - last_break[:-2] - 1) % 2 == 1
    triangles = np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)
    return mesh_of(source, points, triangles[real])


def _stack(vertex: dict[str, PlyColumn], names: str | tuple[str, ...]) -> Float64Array:
    return np.stack([vertex[name].values for name in names], axis=1)


def _colors(vertex: dict[str, PlyColumn]) -> Float64Array | None:
    names = ("red", "green", "blue")
    if any(name not in vertex or vertex[name].counts is not None for name in names):
        return None
    dtype = np.dtype(vertex["red"].dtype or "f8")
    colors = _stack(vertex, names)
    return colors if dtype.kind == "f" else colors / np.iinfo(dtype).max
