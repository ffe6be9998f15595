"""Writers of surveys: E57 with one or more scans, LAS and LAZ. The same points give the same bytes on every machine."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from _writers import Array, rounded
from numpy.typing import NDArray

_PAGE = 1020  # bytes of content in a page; four more are its checksum
_RECORDS = 1000  # points in a packet, whose streams must stay below 64 KiB
_BITS = 19  # of a coordinate: a tenth of a millimetre in 52 metres, and not a whole number of bytes
_SCALE = 1e-4  # what a coordinate counts, in metres


@dataclass
class Scan:
    """Points as a scanner saw them, and where it stood."""

    name: str
    points: Array
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """A unit quaternion, w first, from the frame of the scanner to that of the survey."""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    colors: Array | None = None
    invalid: NDArray[np.bool_] | None = field(default=None)
    """Points that the scanner did not see."""


def packed_bits(values: NDArray[np.int64], bits: int) -> bytes:
    """Whole numbers of some bits each, one behind the other from the lowest bit on."""
    table = (values[:, None] >> np.arange(bits)) & 1
    return np.packbits(table.astype(np.uint8).ravel(), bitorder="little").tobytes()


def checksum(page: bytes) -> int:
    """CRC-32C."""
    crc = 0xFFFFFFFF
    for byte in page:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def e57_bytes(scans: Sequence[Scan]) -> bytes:
    """E57: coordinates as scaled whole numbers of 19 bits, colours of 8, states of 2."""
    body = bytearray(48)
    entries = []
    for number, scan in enumerate(scans):
        columns, prototype = _columns(scan)
        start = len(body)
        # Packets hold whole bytes of each stream; the numbers run on from one to the next.
        pieces = [[stream[at : at + _RECORDS] for at in range(0, len(stream), _RECORDS)] for stream in columns]
        packets = b"".join(
            _packet([piece[k] if k < len(piece) else b"" for piece in pieces]) for k in range(max(map(len, pieces)))
        )
        body += struct.pack("<B7xQQQ", 1, 32 + len(packets), _physical(start + 32), 0) + packets
        w, x, y, z = scan.rotation
        place = "".join(
            f'<{name} type="Float">{value!r}</{name}>' for name, value in zip("wxyz", (w, x, y, z), strict=True)
        )
        shift = "".join(
            f'<{name} type="Float">{value!r}</{name}>' for name, value in zip("xyz", scan.translation, strict=True)
        )
        entries.append(
            f'<vectorChild type="Structure"><guid type="String">{{scan-{number}}}</guid>'
            f'<name type="String"><![CDATA[{scan.name}]]></name><pose type="Structure">'
            f'<rotation type="Structure">{place}</rotation><translation type="Structure">{shift}</translation></pose>'
            f'<points type="CompressedVector" fileOffset="{_physical(start)}" recordCount="{len(scan.points)}">'
            f'<prototype type="Structure">{prototype}</prototype>'
            '<codecs type="Vector" allowHeterogeneousChildren="1"/></points></vectorChild>'
        )
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<e57Root type="Structure" '
        'xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0"><formatName type="String">ASTM E57 3D Imaging Data File'
        '</formatName><guid type="String">{survey}</guid><versionMajor type="Integer">1</versionMajor>'
        f'<data3D type="Vector" allowHeterogeneousChildren="1">{"".join(entries)}</data3D>'
        '<images2D type="Vector" allowHeterogeneousChildren="1"/></e57Root>\n'
    ).encode("ascii")
    where = len(body)
    body += xml
    body += bytes(-len(body) % _PAGE)
    length = len(body) // _PAGE * 1024
    struct.pack_into("<8sIIQQQQ", body, 0, b"ASTM-E57", 1, 0, length, _physical(where), len(xml), 1024)
    pages = [bytes(body[at : at + _PAGE]) for at in range(0, len(body), _PAGE)]
    return b"".join(page + checksum(page).to_bytes(4, "big") for page in pages)


def _columns(scan: Scan) -> tuple[list[bytes], str]:
    whole = np.rint(rounded(scan.points) / _SCALE).astype(np.int64)
    half = 1 << (_BITS - 1)
    columns = [packed_bits(whole[:, axis] + half, _BITS) for axis in range(3)]
    prototype = "".join(
        f'<cartesian{axis} type="ScaledInteger" minimum="{-half}" maximum="{half - 1}" scale="{_SCALE!r}" offset="0"/>'
        for axis in "XYZ"
    )
    if scan.invalid is not None:
        columns.append(packed_bits(scan.invalid.astype(np.int64) * 2, 2))
        prototype += '<cartesianInvalidState type="Integer" minimum="0" maximum="2"/>'
    if scan.colors is not None:
        octets = np.rint(scan.colors * 255).astype(np.uint8)
        columns += [octets[:, channel].tobytes() for channel in range(3)]
        prototype += "".join(
            f'<color{name} type="Integer" minimum="0" maximum="255"/>' for name in ("Red", "Green", "Blue")
        )
    return columns, prototype


def _packet(streams: list[bytes]) -> bytes:
    lengths = struct.pack(f"<{len(streams)}H", *map(len, streams))
    content = lengths + b"".join(streams)
    size = 6 + len(content)
    size += -size % 4
    return struct.pack("<BBHH", 1, 0, size - 1, len(streams)) + content + bytes(size - 6 - len(content))


def _physical(logical: int) -> int:
    page, rest = divmod(logical, _PAGE)
    return page * 1024 + rest


def write_e57(path: Path, scans: Sequence[Scan]) -> None:
    """E57 with one or more scans."""
    path.write_bytes(e57_bytes(scans))


def las_bytes(points: Array, colors: Array, *, packed: bool = False) -> bytes:
    """LAS 1.2 in steps of 1e-5 with colours; packed as LAZ by lazrs."""
    step, record = 1e-5, np.dtype([("xyz", "<i4", 3), ("rest", "u1", 8), ("rgb", "<u2", 3)])
    table = np.zeros(len(points), dtype=record)
    table["xyz"] = np.rint(rounded(points) / step)
    table["rest"][:, 2] = 0b001001  # the first return of one
    table["rgb"] = np.rint(colors * 255).astype(np.uint16) * 257
    notes = b""
    if packed:
        import lazrs

        vlr = lazrs.LazVlr.new_for_compression(2, 0)
        about = bytes(vlr.record_data())
        notes = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(about), b"lazrs") + about
    header = struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I",
        *(b"LASF", 0, 0, bytes(16), 1, 2, b"OTHER", b"samples/generate.py", 0, 0, 227, 227 + len(notes)),
        *(int(packed), 2 | 0x80 * packed, record.itemsize, len(table), len(table), 0, 0, 0, 0),
    )
    low, high = table["xyz"].min(axis=0) * step, table["xyz"].max(axis=0) * step
    header += (
        np.concatenate([np.full(3, step), np.zeros(3), np.stack([high, low], axis=1).ravel()]).astype("<f8").tobytes()
    )
    if not packed:
        return header + table.tobytes()
    stream = io.BytesIO()
    stream.write(header + notes)
    compressor = lazrs.LasZipCompressor(stream, vlr)
    compressor.compress_many(table.view(np.uint8))
    compressor.done()
    return stream.getvalue()
