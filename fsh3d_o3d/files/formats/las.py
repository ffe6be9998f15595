"""LAS and LAZ: clouds of surveys, whose coordinates are whole numbers, scaled and moved."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED
from fsh3d_o3d.files.formats.optional import guarded, optional_module
from fsh3d_o3d.files.formats.result import cloud_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.geometry import PointArrays

_HEADER_SIZES = {2: 227, 3: 235, 4: 375}  # bytes of the header by the minor version; before 2 as in 2
_NOTE_HEADER = struct.Struct("<H16sHH32s")  # of a record of variable length: user, number, bytes that follow
_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # least bytes of a point by its format, 0 … 10
_COLORS_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}  # bytes from a point's beginning to its colours, by format
_FLAGS_AT = 15  # bytes from a point's beginning to its flags, in all formats
_PACKED = 0x80  # bit of the format of points that are compressed by LASzip
_FIRST_EXTENDED = 6  # format from which on flags lie elsewhere
_WITHHELD = (0x80, 0x04)  # bit of what counts as deleted, in formats 0 … 5, and from 6 on


@dataclass(frozen=True)
class _Header:
    """What is needed of a LAS header."""

    start: int
    """Where the points begin, in bytes from the beginning of the file."""
    points: int
    """How many there are."""
    size: int
    """Bytes of each."""
    kind: int
    """Their format, 0 … 10."""
    packed: bool
    """Whether they are compressed."""
    scale: Float64Array
    offset: Float64Array
    notes: int
    """Records of variable length in front of the points."""
    first_note: int
    """Where the first one begins."""


def parse_las(source: Source) -> PointArrays:
    """Return a LAS or LAZ file: scale · number + offset, in float64, so that millimetres survive at 500 km."""
    data = source.data
    header = _header(data)
    raw = _unpacked(data, header) if header.packed else data[header.start : header.start + header.points * header.size]
    if len(raw) < header.points * header.size:
        raise GeometryReadError(
            f"truncated: {header.points} points need {header.points * header.size} bytes, but {len(raw)} follow"
        )
    fields: dict[str, tuple[str, int]] = {"xyz": ("<i4", 0), "flags": ("u1", _FLAGS_AT)}
    if header.kind in _COLORS_AT:
        fields["rgb"] = ("<u2", _COLORS_AT[header.kind])
    table = np.frombuffer(
        raw,
        dtype=np.dtype(
            {
                "names": list(fields),
                "formats": [(kind, 1 if name == "flags" else 3) for name, (kind, _) in fields.items()],
                "offsets": [at for _, at in fields.values()],
                "itemsize": header.size,
            }
        ),
    )
    withheld = table["flags"][:, 0] & _WITHHELD[header.kind >= _FIRST_EXTENDED] != 0
    if withheld.any():
        source.note(f"{counted(int(withheld.sum()), 'point')} marked as deleted left out")
        table = table[~withheld]
    if not len(table):
        raise GeometryReadError("all its points are marked as deleted")
    return cloud_of(source, table["xyz"] * header.scale + header.offset, colors=_colors(table))


def _header(data: bytes) -> _Header:
    if data[:4] != b"LASF":
        raise GeometryReadError("it does not begin with 'LASF'")
    if len(data) < min(_HEADER_SIZES.values()):
        raise GeometryReadError("truncated: the header breaks off")
    major, minor = data[24], data[25]
    if major != 1 or minor > max(_HEADER_SIZES):
        raise GeometryReadError(f"damaged, or of a version that is not known: {major}.{minor}")
    least = _HEADER_SIZES[max(minor, min(_HEADER_SIZES))]
    size, start, notes, kind, record, points = struct.unpack_from("<HIIBHI", data, 94)
    if size < least or start < size or len(data) < start:
        raise GeometryReadError(f"truncated or damaged: the points should begin at byte {start} of {len(data)}")
    if minor >= 4:
        points = struct.unpack_from("<Q", data, 247)[0] or points
    packed, kind = bool(kind & _PACKED), kind & ~(_PACKED | 0x40)
    if kind >= len(_RECORD_SIZES) or record < _RECORD_SIZES[kind]:
        raise GeometryReadError(f"damaged: points of format {kind} cannot have {record} bytes")
    if not points:
        raise GeometryReadError("the header announces 0 points")
    scale, offset = np.frombuffer(data, dtype="<f8", count=6, offset=131).reshape(2, 3).astype(np.float64)
    if not (np.isfinite(scale).all() and np.isfinite(offset).all() and (scale != 0).all()):
        raise GeometryReadError("damaged: scale or offset of the coordinates are zero or not finite")
    return _Header(start, points, record, kind, packed, scale, offset, notes, size)


def _unpacked(data: bytes, header: _Header) -> NDArray[np.uint8]:
    lazrs = optional_module("lazrs", extra="formats", what="LAZ files")
    size = header.points * header.size
    if size > MOST_UNPACKED:
        raise GeometryReadError(f"its points unpack to more than {MOST_UNPACKED} bytes")
    about = _laszip_note(data, header)
    _check_chunks(data, header)
    points = np.zeros(size, dtype=np.uint8)
    with guarded("its points cannot be unpacked"):
        stream = io.BytesIO(data)
        stream.seek(header.start)
        lazrs.LasZipDecompressor(stream, about).decompress_many(points)
    return points


def _laszip_note(data: bytes, header: _Header) -> bytes:
    """Return what LASzip says of itself, in a record of variable length."""
    at = header.first_note
    for _ in range(header.notes):
        if at + _NOTE_HEADER.size > header.start:
            break
        _, user, number, size, _ = _NOTE_HEADER.unpack_from(data, at)
        at += _NOTE_HEADER.size
        if user.rstrip(b"\0") == b"laszip encoded" and number == 22204:
            if at + size > header.start:
                break
            return data[at : at + size]
        at += size
    raise GeometryReadError("damaged: it is compressed, but does not say how")


def _check_chunks(data: bytes, header: _Header) -> None:
    """The list of chunks stands behind the points: where it is there, no point is missing."""
    if len(data) < header.start + 8:
        raise GeometryReadError("truncated: the points are missing")
    (at,) = struct.unpack_from("<q", data, header.start)
    if at == -1:  # written to what could not be written twice: then it stands at the end
        (at,) = struct.unpack_from("<q", data, len(data) - 8)
    if not header.start + 8 <= at <= len(data) - 8:
        raise GeometryReadError(f"truncated or damaged: the list of chunks should be at byte {at} of {len(data)}")


def _colors(table: NDArray[np.void]) -> Float64Array | None:
    """Colours of 16 bits, or of 8 where none is larger, as many programs write them."""
    if "rgb" not in (table.dtype.names or ()):
        return None
    colors = table["rgb"].astype(np.float64)
    largest = colors.max()
    return None if largest == 0 else colors / (255 if largest <= 255 else 65535)
