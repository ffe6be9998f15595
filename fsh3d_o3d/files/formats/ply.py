"""Stanford PLY: text and binary, polygons, triangle strips and bare points."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.ply_binary import read_binary_element
from fsh3d_o3d.files.formats.ply_header import PlyColumn, PlyElement, parse_header
from fsh3d_o3d.files.formats.ply_text import read_text
from fsh3d_o3d.files.formats.result import VertexValues, cloud_of, mesh_of, polygon_mesh_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import indices
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_INDEX_LISTS = ("vertex_indices", "vertex_index")
_NORMAL = ("nx", "ny", "nz")
_COLOR = ("red", "green", "blue")
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_CORNER_UVS = "texcoord"  # list of a face, as MeshLab writes it: two numbers for each corner
_KNOWN = {"x", "y", "z", *_NORMAL, *_COLOR, "alpha", *(name for pair in _UVS for name in pair)}
_MOST_ATTRIBUTES = 256  # a choice; their names go into the header of an answer


def parse_ply(source: Source) -> MeshArrays | PointArrays:
    """Return a PLY file as a mesh, or as a point cloud where it has no faces."""
    data = source.data
    order, elements, offset = parse_header(source)
    tables = read_text(source, data[offset:], elements) if order == "" else _read_binary(source, offset, elements)
    vertex = tables.get("vertex")
    if vertex is None or any(name not in vertex or vertex[name].counts is not None for name in "xyz"):
        raise GeometryReadError("there is no vertex element with x, y and z")
    points = _stack(vertex, "xyz")
    normals = _stack(vertex, _NORMAL) if all(name in vertex for name in _NORMAL) else None
    values = VertexValues(normals, _colors(vertex), _uvs(vertex), _attributes(vertex))
    for name, reader in (("face", _polygons), ("tristrips", _strips)):
        columns = tables.get(name)
        size = next((element.count for element in elements if element.name == name), 0)
        if columns is not None and size > 0:
            lists = next((columns[key] for key in _INDEX_LISTS if key in columns), None)
            if lists is None or lists.counts is None:
                raise GeometryReadError(f"element {name} has no list of vertex indices")
            corners = indices(lists.values, "vertex indices")
            own = _corner_uvs(columns, lists.counts) if name == "face" else None
            return reader(source, points, corners, lists.counts, values, own)
    edges = sum(element.count for element in elements if element.name == "edge")
    if edges:
        source.note(
            f"{counted(edges, 'edge')} passed over: there are no faces, and the vertices are read as a point cloud"
        )
    return cloud_of(source, points, values.normals, values.colors, values.attributes)


def _read_binary(source: Source, offset: int, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    data = source.data
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
        rest = counted(len(data) - offset, "byte")
        if _more_records_follow(data, offset, elements):
            raise GeometryReadError(
                f"{rest} follow the elements that the header announces, in records like the last one"
            )
        source.note(f"{rest} behind the elements that the header announces passed over")
    return tables


def _more_records_follow(data: bytes, offset: int, elements: list[PlyElement]) -> bool:
    """Whether what follows the last element looks like more of it: then the header's count is not the file's."""
    last = next((element for element in reversed(elements) if element.properties), None)
    if last is None:
        return False
    vertices = next((element.count for element in elements if element.name == "vertex"), 0)
    layout = [(entry.dtype, entry.count_dtype) for entry in last.properties]
    rest = data[offset:]
    if all(length is None for _, length in layout):
        size = sum(np.dtype(kind).itemsize for kind, _ in layout)
        return len(rest) % size == 0 and bool(rest.strip(b"\0"))
    try:
        columns, _ = read_binary_element(data, offset, last.name, 1, layout)
    except GeometryReadError:
        return False
    return all(
        counts is None or (counts[0] >= 3 and values.min() >= 0 and values.max() < vertices)
        for entry, (values, counts) in zip(last.properties, columns, strict=True)
        if entry.name in _INDEX_LISTS
    )


def _polygons(
    source: Source,
    points: Float64Array,
    corners: IntArray,
    counts: IntArray,
    values: VertexValues,
    corner_uvs: Float64Array | None,
) -> MeshArrays:
    return polygon_mesh_of(source, points, corners, np.cumsum(counts) - counts, counts, values, corner_uvs)


def _strips(
    source: Source, points: Float64Array, strips: IntArray, counts: IntArray, values: VertexValues, _: object
) -> MeshArrays:
    """Triangles of strips that −1 ends; every second one is turned, stitches of no area are left out."""
    # Lists are separate strips as well: a −1 behind each.
    strips = np.insert(strips, np.cumsum(counts), -1)
    position = np.arange(len(strips))
    last_break = np.maximum.accumulate(np.where(strips == -1, position, -1))
    a, b, c = strips[:-2], strips[1:-1], strips[2:]
    real = (a != -1) & (b != -1) & (c != -1) & (a != b) & (b != c) & (a != c)
    odd = (position[:-2] - last_break[:-2] - 1) % 2 == 1
    triangles = np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)
    return mesh_of(source, points, triangles[real], values)


def _stack(vertex: dict[str, PlyColumn], names: str | tuple[str, ...]) -> Float64Array:
    return np.stack([vertex[name].values for name in names], axis=1)


def _colors(vertex: dict[str, PlyColumn]) -> Float64Array | None:
    if any(name not in vertex or vertex[name].counts is not None for name in _COLOR):
        return None
    dtype = np.dtype(vertex["red"].dtype or "f8")
    colors = _stack(vertex, _COLOR)
    return colors if dtype.kind == "f" else colors / np.iinfo(dtype).max


def _uvs(vertex: dict[str, PlyColumn]) -> Float64Array | None:
    for pair in _UVS:
        if all(name in vertex and vertex[name].counts is None for name in pair):
            return _stack(vertex, pair)
    return None


def _corner_uvs(face: dict[str, PlyColumn], counts: IntArray) -> Float64Array | None:
    """Return the texture coordinates (m, 2) of the corners of all polygons, where every face has them."""
    column = face.get(_CORNER_UVS)
    if column is None or column.counts is None or not np.array_equal(column.counts, 2 * counts):
        return None
    return column.values.reshape(-1, 2).astype(np.float64)


def _attributes(vertex: dict[str, PlyColumn]) -> dict[str, Float64Array]:
    """Return the vertices' other properties; ``name_0``, ``name_1`` … together, as they are written."""
    single = {name: column.values for name, column in vertex.items() if column.counts is None and name not in _KNOWN}
    if len(single) > _MOST_ATTRIBUTES:
        return {}
    result: dict[str, Float64Array] = {}
    for name, values in single.items():
        stem, _, number = name.rpartition("_")
        if number != "0" or f"{stem}_1" not in single:
            if not (number.isdigit() and f"{stem}_0" in single and f"{stem}_1" in single):
                result[name] = values.astype(np.float64)
            continue
        columns = [values]
        while f"{stem}_{len(columns)}" in single:
            columns.append(single[f"{stem}_{len(columns)}"])
        result[stem] = np.stack(columns, axis=1).astype(np.float64)
    return result
