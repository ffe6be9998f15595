"""E57: scans of surveys, each moved by its pose into one frame."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.xml_tree import XmlElement, xml_root
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_HEADER = struct.Struct("<8sIIQQQQ")  # name, versions, length, place and length of the XML, size of a page
_PAGE, _CHECK = 1024, 4  # bytes of a page, the only size in use, and of the checksum at its end
_CASTAGNOLI = 0x82F63B78  # polynomial of the checksum, CRC-32C, its bits reversed
_SECTION = struct.Struct("<B7xQQQ")  # of points: kind, length, place of the first packet, of the index
_PACKET = struct.Struct("<BBHH")  # kind, flags, length − 1, number of streams
_DATA = 1  # kind of a packet that holds points
_MOST_POINTS = 2**28  # of a scan, a choice: 6.4 GB of coordinates
_BLOCK = 1 << 20  # numbers unpacked at a time, a choice: their temporaries stay below 100 MB
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")


def parse_e57(source: Source) -> MeshArrays | PointArrays:
    """Return all scans as one cloud, each a part: placed by their poses, without the points marked as invalid."""
    file = _File(source.data)
    root = file.root
    scans = root.find("data3D")
    assembly = Assembly(source)
    invalid = 0
    for number, scan in enumerate([] if scans is None else scans.children):
        points = scan.find("points")
        if points is None or _whole(points, "recordCount") == 0:
            source.note(f"scan {number} has no points")
            continue
        table = file.table(points)
        places, valid = _places(table)
        colors = _unit_colors(scan, table)
        invalid += int((~valid).sum())
        if not valid.any():
            source.note(f"all points of scan {number} are marked as invalid")
            continue
        name = scan.find("name")
        title = name.text.strip() if name is not None and name.text.strip() else f"scan {number}"
        moved = _moved(scan, places[valid])
        assembly.add_cloud(title, moved, colors=None if colors is None else colors[valid])
    if invalid:
        source.note(f"{counted(invalid, 'point')} marked as invalid left out")
    return assembly.result()


@dataclass(frozen=True)
class _Field:
    """A column of a table of points."""

    name: str
    kind: str
    low: int
    high: int
    scale: float
    offset: float

    @property
    def bits(self) -> int:
        """Bits of one number."""
        return {"f4": 32, "f8": 64}.get(self.kind) or (self.high - self.low).bit_length()


class _File:
    """The pages of a file, their checksums compared and taken out."""

    def __init__(self, data: bytes) -> None:
        if data[:8] != b"ASTM-E57":
            raise GeometryReadError("it does not begin with 'ASTM-E57'")
        if len(data) < _HEADER.size:
            raise GeometryReadError("truncated: the header breaks off")
        _, major, _, length, xml_at, xml_size, page = _HEADER.unpack_from(data)
        if major != 1 or page != _PAGE:
            raise GeometryReadError(f"damaged, or of a version that is not known: {major}, with pages of {page} bytes")
        if length > len(data) or length % _PAGE:
            raise GeometryReadError(f"truncated: the header announces {length} bytes, the file has {len(data)}")
        pages = np.frombuffer(data, dtype=np.uint8, count=length).reshape(-1, _PAGE)
        wrong = np.flatnonzero(_checksums(pages[:, :-_CHECK]) != pages[:, -_CHECK:].copy().view(">u4").ravel())
        if len(wrong):
            raise GeometryReadError(f"damaged: the checksum of page {wrong[0]} and {len(wrong) - 1} more is wrong")
        self._data = pages[:, :-_CHECK].tobytes()
        start = self._logical(xml_at)
        if start + xml_size > len(self._data):
            raise GeometryReadError("truncated or damaged: its XML lies beyond its end")
        self.root = xml_root(self._data[start : start + xml_size], "its XML")

    def table(self, points: XmlElement) -> dict[str, Float64Array]:
        """Return the columns of a table of points by name."""
        prototype = points.find("prototype")
        fields = [] if prototype is None else [_field(element) for element in prototype.children]
        count = _whole(points, "recordCount")
        if not 0 < count <= _MOST_POINTS:
            raise GeometryReadError(f"a scan of {count} points, where at most {_MOST_POINTS} are read")
        codecs = points.find("codecs")
        if codecs is not None and codecs.children:
            raise GeometryReadError("its points are packed by a codec that is not read")
        streams = self._streams(_whole(points, "fileOffset"), len(fields))
        return {
            field.name: _column(field, stream, count)
            for field, stream in zip(fields, streams, strict=True)
            if field.name in {*_CARTESIAN, *_SPHERICAL, *_COLORS, "cartesianInvalidState", "sphericalInvalidState"}
        }

    def _logical(self, physical: int) -> int:
        page, rest = divmod(physical, _PAGE)
        return page * (_PAGE - _CHECK) + rest

    def _streams(self, physical: int, count: int) -> list[bytes]:
        at = self._logical(physical)
        if at + _SECTION.size > len(self._data):
            raise GeometryReadError("truncated or damaged: its points lie beyond its end")
        kind, length, first, _ = _SECTION.unpack_from(self._data, at)
        stop, at = at + length, self._logical(first)
        if kind != 1 or stop > len(self._data) or at < _HEADER.size:
            raise GeometryReadError("damaged: where its points should be, there are none")
        pieces: list[list[bytes]] = [[] for _ in range(count)]
        while at + 4 <= stop:
            size = int.from_bytes(self._data[at + 2 : at + 4], "little") + 1
            if self._data[at] == _DATA:
                self._packet(at, size, pieces)
            at += size
        return [b"".join(stream) for stream in pieces]

    def _packet(self, at: int, size: int, pieces: list[list[bytes]]) -> None:
        if at + max(size, _PACKET.size) > len(self._data):
            raise GeometryReadError("truncated or damaged: a packet of points breaks off")
        *_, streams = _PACKET.unpack_from(self._data, at)
        lengths = np.frombuffer(self._data, dtype="<u2", count=min(streams, size // 2), offset=at + _PACKET.size)
        start = at + _PACKET.size + lengths.nbytes
        if streams != len(pieces) or start + int(lengths.sum()) > at + size:
            raise GeometryReadError("damaged: a packet of points has other columns than announced")
        for stream, length in zip(pieces, lengths.tolist(), strict=True):
            stream.append(self._data[start : start + length])
            start += length


def _field(element: XmlElement) -> _Field:
    kind = element.attributes.get("type", "")
    if kind == "Float":
        return _Field(element.name, "f4" if element.attributes.get("precision") == "single" else "f8", 0, 0, 1.0, 0.0)
    if kind not in ("Integer", "ScaledInteger"):
        raise GeometryReadError(f"its points have a column of kind '{kind[:20]}', which is not read")
    low, high = _whole(element, "minimum", -(2**63)), _whole(element, "maximum", 2**63 - 1)
    if low > high:
        raise GeometryReadError(f"damaged: column '{element.name[:30]}' runs from {low} to {high}")
    scale, offset = _real(element, "scale", 1.0), _real(element, "offset", 0.0)
    return _Field(element.name, "int", low, high, scale, offset)


def _column(field: _Field, stream: bytes, count: int) -> Float64Array:
    needed = (field.bits * count + 7) // 8
    if len(stream) < needed:
        raise GeometryReadError(
            f"truncated: {count} points need {needed} bytes of '{field.name[:30]}', but {len(stream)} are there"
        )
    if field.kind != "int":
        return np.frombuffer(stream, dtype=f"<{field.kind}", count=count).astype(np.float64)
    whole = _unpacked(stream, field.bits, count)
    return (whole.astype(np.float64) + field.low) * field.scale + field.offset


def _unpacked(stream: bytes, bits: int, count: int) -> NDArray[np.uint64]:
    """Return whole numbers of some bits each, packed one behind the other from the lowest bit on."""
    result = np.zeros(count, dtype=np.uint64)
    if not bits:
        return result
    data = np.frombuffer(stream + bytes(16), dtype=np.uint8)
    mask = np.uint64((1 << bits) - 1)
    for start in range(0, count, _BLOCK):
        first = np.arange(start, min(start + _BLOCK, count), dtype=np.int64) * bits
        place, shift = first >> 3, (first & 7).astype(np.uint64)
        word = np.zeros(len(first), dtype=np.uint64)
        for byte in range(8):
            word |= data[place + byte].astype(np.uint64) << np.uint64(8 * byte)
        word >>= shift
        crossing = np.flatnonzero(shift)  # shifting by 64 bits is not defined
        word[crossing] |= data[place[crossing] + 8].astype(np.uint64) << (np.uint64(64) - shift[crossing])
        result[start : start + len(first)] = word & mask
    return result


def _places(table: dict[str, Float64Array]) -> tuple[Float64Array, NDArray[np.bool_]]:
    """Return the points in the frame of their scan, and which are not marked as invalid."""
    if all(name in table for name in _CARTESIAN):
        places = np.stack([table[name] for name in _CARTESIAN], axis=1)
        state = table.get("cartesianInvalidState")
    elif all(name in table for name in _SPHERICAL):
        distance, longitude, elevation = (table[name] for name in _SPHERICAL)
        across = distance * np.cos(elevation)
        places = np.stack(
            [across * np.cos(longitude), across * np.sin(longitude), distance * np.sin(elevation)], axis=1
        )
        state = table.get("sphericalInvalidState")
    else:
        raise GeometryReadError("a scan has neither Cartesian nor spherical coordinates")
    valid = np.asarray(np.isfinite(places).all(axis=1))
    return places, valid if state is None else np.asarray(valid & (state == 0))


def _moved(scan: XmlElement, points: Float64Array) -> Float64Array:
    pose = scan.find("pose")
    if pose is None:
        return points
    rotation, translation = pose.find("rotation"), pose.find("translation")
    if rotation is not None:
        w, *axis = (_child(rotation, name) for name in "wxyz")
        length = np.sqrt(w * w + sum(part * part for part in axis))
        if not np.isfinite(length) or length == 0:
            raise GeometryReadError("damaged: the rotation of a scan is zero or not finite")
        vector = np.array(axis) / length
        across = 2 * np.cross(vector, points)
        points = points + w / length * across + np.cross(vector, across)
    if translation is not None:
        points = points + np.array([_child(translation, name) for name in "xyz"])
    return points


def _unit_colors(scan: XmlElement, table: dict[str, Float64Array]) -> Float64Array | None:
    """Return colours in [0, 1] by the limits that the scan tells; where it tells none, 255."""
    if not all(name in table for name in _COLORS):
        return None
    colors = np.stack([table[name] for name in _COLORS], axis=1)
    limits = scan.find("colorLimits")
    low, high = np.zeros(3), np.full(3, 255.0)
    if limits is not None:
        for place, name in enumerate(_COLORS):
            low[place], high[place] = _child(limits, f"{name}Minimum", 0.0), _child(limits, f"{name}Maximum", 255.0)
    if not (np.isfinite([low, high]).all() and (high > low).all() and np.isfinite(colors).all()):
        return None
    return np.asarray(np.clip((colors - low) / (high - low), 0, 1))


def _child(element: XmlElement, name: str, default: float = 0.0) -> float:
    found = element.find(name)
    if found is None:
        return default
    text = found.text.strip()
    try:
        return float(text) if text else 0.0  # an empty element is zero
    except ValueError:
        raise GeometryReadError(f"damaged: '{text[:20]}' of '{name}' should be a number") from None


def _real(element: XmlElement, name: str, default: float) -> float:
    try:
        return float(element.attributes.get(name, default))
    except ValueError:
        raise GeometryReadError(f"damaged: '{name}' of a column is no number") from None


def _whole(element: XmlElement, name: str, default: int = 0) -> int:
    text = element.attributes.get(name, str(default))
    try:
        value = int(text)
    except ValueError:
        raise GeometryReadError(f"damaged: '{text[:20]}' of '{name}' should be a whole number") from None
    if abs(value) > 2**63:
        raise GeometryReadError(f"damaged: '{name}' is {value:.3g}")
    return value


def _checksums(pages: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the CRC-32C of each row, all rows side by side."""
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_CASTAGNOLI), table >> 1).astype(np.uint32)
    crc = np.full(len(pages), 0xFFFFFFFF, dtype=np.uint32)
    for column in np.ascontiguousarray(pages.T):
        crc = table[(crc ^ column) & 0xFF] ^ (crc >> 8)
    return ~crc
