"""VTK's XML formats: arrays as text, base64 or raw bytes behind the XML, packed or not."""

from __future__ import annotations

import base64
import binascii
import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED, inflated
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.text import indices, numbers
from fsh3d_o3d.files.formats.vtk.cells import POLYGON, STRIP, Cells, geometry_of, named_values
from fsh3d_o3d.files.formats.xml_tree import XmlElement, xml_root
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_KINDS = {
    f"{sign}Int{bits}": f"{letter}{bits // 8}" for sign, letter in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)
}
_KINDS |= {"Float32": "f4", "Float64": "f8"}
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*_")
_END = b"</AppendedData>"
_GROUPS = {"Verts": 2, "Lines": 4, "Strips": STRIP, "Polys": POLYGON}  # lists of PolyData, and the kind of their cells


def parse_vtk_xml(source: Source) -> MeshArrays | PointArrays:
    """Return a .vtp or .vtu file with the values at its points."""
    file = _File(source.data)
    pieces = [piece for piece in file.grid.all("Piece") if _count(piece, "NumberOfPoints")]
    found = [_piece(source, file, piece) for piece in pieces]
    if not found:
        raise GeometryReadError("it holds no points")
    if len(found) == 1:
        return found[0]
    assembly = Assembly(source)
    for number, part in enumerate(found):
        if isinstance(part, MeshArrays):
            assembly.add_mesh(f"piece {number}", part.vertices, part.triangles)
        else:
            assembly.add_cloud(f"piece {number}", part.points, part.normals, part.colors)
    return assembly.result()


class _File:
    """The XML of a file, and the bytes behind it."""

    def __init__(self, data: bytes) -> None:
        self._appended, self._raw = b"", False
        behind = _APPENDED.search(data)
        if behind is not None:
            end = data.rfind(_END)
            if end < behind.end():
                raise GeometryReadError("truncated: the end of its appended data is missing")
            self._appended, self._raw = data[behind.end() : end], b"raw" in behind[1]
            data = data[: behind.start()] + data[end + len(_END) :]
        root = xml_root(data)
        kind = root.attributes.get("type", "")
        if root.name != "VTKFile" or kind not in ("PolyData", "UnstructuredGrid"):
            raise GeometryReadError(f"it holds '{kind[:30] or root.name[:30]}', not PolyData or an UnstructuredGrid")
        grid = root.find(kind)
        if grid is None:
            raise GeometryReadError(f"damaged: its {kind} is missing")
        self.grid = grid
        self._order = ">" if root.attributes.get("byte_order") == "BigEndian" else "<"
        self._header = np.dtype(self._order + ("u8" if root.attributes.get("header_type") == "UInt64" else "u4"))
        self._packing = root.attributes.get("compressor", "")
        if self._packing not in ("", "vtkZLibDataCompressor"):
            raise GeometryReadError(f"it is packed by {self._packing[:40]}, which is not read: save it with zlib")

    def array(self, element: XmlElement) -> NDArray[np.generic]:
        """Return an array, (n,) or (n, k)."""
        name = element.attributes.get("type", "")
        if name not in _KINDS:
            raise GeometryReadError(f"an array is of type '{name[:20]}', which is not read")
        dtype = np.dtype(self._order + _KINDS[name])
        form = element.attributes.get("format", "ascii")
        if form == "ascii":
            values: NDArray[np.generic] = numbers(element.text.encode("utf-8"))
            flat = indices(values, "whole numbers").astype(dtype) if dtype.kind in "iu" else values  # type: ignore[arg-type]
        elif form in ("binary", "appended"):
            content = self._content(element, form)
            if len(content) % dtype.itemsize:
                raise GeometryReadError(f"damaged: an array of {len(content)} bytes does not hold {name} alone")
            flat = np.frombuffer(content, dtype=dtype)
        else:
            raise GeometryReadError(f"an array is in the format '{form[:20]}', which is not read")
        width = _count(element, "NumberOfComponents", 1)
        if width > 1 and len(flat) % width:
            raise GeometryReadError(f"truncated or damaged: {len(flat)} numbers in rows of {width}")
        return flat.reshape(-1, width) if width > 1 else flat

    def _content(self, element: XmlElement, form: str) -> bytes:
        if form == "appended":
            offset = _count(element, "offset")
            if offset >= len(self._appended):
                raise GeometryReadError("truncated or damaged: an array lies beyond the appended data")
            source = self._appended[offset:]
        else:
            source = "".join(element.text.split()).encode("ascii", "replace")
        raw = form == "appended" and self._raw
        return self._unpacked(source, raw=raw) if self._packing else self._plain(source, raw=raw)

    def _plain(self, source: bytes, *, raw: bool) -> bytes:
        size = self._header.itemsize
        head = source[:size] if raw else _decoded(source, size)
        if len(head) < size:
            raise GeometryReadError("truncated: the length of an array is missing")
        length = int(np.frombuffer(head, dtype=self._header)[0])
        content = source[size : size + length] if raw else _decoded(source, size + length)[size:]
        if len(content) < length:
            raise GeometryReadError(f"truncated: an array announces {length} bytes, {len(content)} are there")
        return content

    def _unpacked(self, source: bytes, *, raw: bool) -> bytes:
        size = self._header.itemsize
        head = np.frombuffer(_whole(source[: 3 * size] if raw else _decoded(source, 3 * size), 3 * size), self._header)
        blocks, block, last = (int(value) for value in head)
        if blocks * block + last > MOST_UNPACKED or blocks * size > len(source):
            raise GeometryReadError(f"damaged: an array announces {blocks} packed blocks of {block} bytes")
        bytes_of_head = (3 + blocks) * size
        table = _whole(source[:bytes_of_head] if raw else _decoded(source, bytes_of_head), bytes_of_head)
        lengths = np.frombuffer(table, dtype=self._header)[3:].tolist()
        body = source[bytes_of_head if raw else -(-bytes_of_head // 3) * 4 :]
        if not raw:
            body = _decoded(body, sum(lengths))
        result = []
        at = 0
        for length in lengths:
            result.append(inflated(_whole(body[at : at + length], length), what="an array", limit=max(block, last))[0])
            at += length
        return b"".join(result)


def _whole(data: bytes, size: int) -> bytes:
    if len(data) < size:
        raise GeometryReadError("truncated: a packed array breaks off")
    return data


def _decoded(text: bytes, size: int) -> bytes:
    """Return the first ``size`` bytes, or all where there are fewer, of base64."""
    letters = text[: -(-size // 3) * 4]
    try:
        return base64.b64decode(letters, validate=True)[:size]
    except (binascii.Error, ValueError):
        raise GeometryReadError("truncated or damaged: an array is not base64") from None


def _piece(source: Source, file: _File, piece: XmlElement) -> MeshArrays | PointArrays:
    count = _count(piece, "NumberOfPoints")
    places = piece.find("Points")
    element = None if places is None else places.find("DataArray")
    if element is None:
        raise GeometryReadError("damaged: its points are missing")
    points = file.array(element).astype(np.float64)
    if points.shape != (count, 3):
        raise GeometryReadError(
            f"truncated or damaged: {count} points are announced, an array of {points.shape} is there"
        )
    values = piece.find("PointData")
    arrays = {
        element.attributes.get("Name", ""): file.array(element)
        for element in ([] if values is None else values.all("DataArray"))
        if element.attributes.get("type") in _KINDS
    }
    return geometry_of(source, points, _cells(file, piece), named_values(source, arrays, count))


def _cells(file: _File, piece: XmlElement) -> Cells:
    grid = piece.find("Cells")
    if grid is not None:
        lists = _arrays(file, grid)
        cells = _listed(lists, None, "Cells")
        kinds = lists.get("types", np.empty(0)).astype(np.int64)
        if len(kinds) != len(cells.counts) or len(kinds) != _count(piece, "NumberOfCells", len(kinds)):
            raise GeometryReadError(f"truncated or damaged: {len(cells.counts)} cells, but {len(kinds)} kinds of them")
        return Cells(kinds, cells.corners, cells.counts)
    found = []
    for name, kind in _GROUPS.items():
        group = piece.find(name)
        announced = _count(piece, f"NumberOf{name}")
        cells = _listed({} if group is None else _arrays(file, group), kind, name)
        if len(cells.counts) != announced:
            raise GeometryReadError(
                f"truncated or damaged: {announced} {name} are announced, {len(cells.counts)} there"
            )
        found.append(cells)
    return Cells(
        *(np.concatenate([getattr(cells, name) for cells in found]) for name in ("kinds", "corners", "counts"))
    )


def _arrays(file: _File, group: XmlElement) -> dict[str, NDArray[np.generic]]:
    return {element.attributes.get("Name", ""): file.array(element) for element in group.all("DataArray")}


def _listed(lists: dict[str, NDArray[np.generic]], kind: int | None, name: str) -> Cells:
    ends: IntArray = lists.get("offsets", np.empty(0)).astype(np.int64)
    corners: IntArray = lists.get("connectivity", np.empty(0)).astype(np.int64)
    return cells_between(np.concatenate([[0], ends]), corners, kind or 0, name)


def cells_between(bounds: IntArray, corners: IntArray, kind: int, name: str) -> Cells:
    """Return cells of one kind from where each begins and the last ends.

    Raises:
        GeometryReadError: These places are not in order, or not within the list of corners.
    """
    counts = np.diff(bounds)
    if bounds[0] != 0 or (counts < 0).any() or bounds[-1] != len(corners) or corners.ndim != 1:
        raise GeometryReadError(
            f"truncated or damaged: the offsets of its {name} do not fit their {len(corners)} corners"
        )
    return Cells(np.full(len(counts), kind), corners, counts)


def _count(element: XmlElement, name: str, default: int = 0) -> int:
    text = element.attributes.get(name, str(default)) or str(default)
    if not text.isascii() or not text.isdecimal() or len(text) > 15:
        raise GeometryReadError(f"damaged: '{text[:20]}' of '{name}' should be a whole number")
    return int(text)
