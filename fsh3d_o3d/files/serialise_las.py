"""LAS and LAZ of points: whole numbers, scaled to a billionth of the cloud's extent or finer."""

from __future__ import annotations

import io
import struct

import numpy as np

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._version import __version__
from fsh3d_o3d.files.serialise import Content, color_bytes

_HEADER_BYTES = 227  # of version 1.2, which every program reads
_SOFTWARE = f"fsh3d_o3d {__version__}".encode("ascii").ljust(32, b"\0")
_LARGEST = 2.0e9  # of the whole numbers, which have 31 bits
_LASZIP = (b"laszip encoded", 22204)  # user and number of the record that tells how points are compressed
_EIGHT_TO_SIXTEEN = 257  # 255 becomes 65535
_POINT = [("xyz", "<i4", 3), ("rest", "u1", 8)]
_RETURNS = 0b001001  # the first return of one


def las_bytes(surface: Content) -> bytes:
    """LAS 1.2, with colours of eight bits where there are any; no normals."""
    return _bytes(surface, packed=False)


def laz_bytes(surface: Content) -> bytes:
    """LAZ: the same, compressed.

    Raises:
        ValueError: The package lazrs is not installed.
    """
    return _bytes(surface, packed=True)


def _bytes(surface: Content, *, packed: bool) -> bytes:
    kind = 0 if surface.colors is None else 2
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    offset, scale = _frame(low, high)
    table = np.zeros(len(surface.points), dtype=_POINT + ([("rgb", "<u2", 3)] if kind else []))
    table["xyz"] = np.rint((surface.points - offset) / scale)
    table["rest"][:, 2] = _RETURNS
    if surface.colors is not None:
        table["rgb"] = color_bytes(surface.colors).astype(np.uint16) * _EIGHT_TO_SIXTEEN
    notes = b""
    if packed:
        vlr, about = _laszip(kind)
        notes = struct.pack("<H16sHH32s", 0, _LASZIP[0], _LASZIP[1], len(about), b"lazrs") + about
    box = table["xyz"].min(axis=0) * scale + offset, table["xyz"].max(axis=0) * scale + offset
    header = struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I",
        *(b"LASF", 0, 0, bytes(16), 1, 2, b"OTHER", _SOFTWARE, 0, 0, _HEADER_BYTES, _HEADER_BYTES + len(notes)),
        *(int(packed), kind | (0x80 if packed else 0), table.itemsize, len(table), len(table), 0, 0, 0, 0),
    )
    header += np.concatenate([np.full(3, scale), offset, np.stack(box[::-1], axis=1).ravel()]).astype("<f8").tobytes()
    if not packed:
        return header + table.tobytes()
    result = io.BytesIO()
    result.write(header + notes)
    compressor = import_installed("lazrs").LasZipCompressor(result, vlr)
    compressor.compress_many(table.view(np.uint8))
    compressor.done()
    return result.getvalue()


def _frame(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the offset (3,) and the scale, a power of ten, of coordinates between two corners."""
    span = max(float((high - low).max()), float(np.spacing(np.abs([low, high]).max())) * _LARGEST)
    scale = 10.0 ** np.ceil(np.log10(span / _LARGEST))
    return np.floor(low / scale) * scale, float(scale)


def _laszip(kind: int) -> tuple[object, bytes]:
    try:
        lazrs = import_installed("lazrs")
    except ImportError:
        raise ValueError(".laz needs the package lazrs: pip install 'fsh3d-o3d[formats]'; .las does not") from None
    vlr = lazrs.LazVlr.new_for_compression(kind, 0)
    return vlr, bytes(vlr.record_data())
