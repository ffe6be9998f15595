"""Writers of volumes: NIfTI, NRRD, stacks of TIFF and NPY, and of packed files, the same bytes on every machine."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Labels = NDArray[np.uint8]
_STORED = 65_535  # bytes of a block that is packed but not made smaller


def gzip_bytes(data: bytes) -> bytes:
    """A file as gzip, not made smaller: other versions of zlib would make other bytes of it."""
    result = bytearray(b"\x1f\x8b\x08\0\0\0\0\0\0\xff")
    for at in range(0, max(len(data), 1), _STORED):
        block = data[at : at + _STORED]
        result += bytes([at + _STORED >= len(data)]) + struct.pack("<HH", len(block), len(block) ^ 0xFFFF) + block
    return bytes(result) + struct.pack("<II", zlib.crc32(data), len(data) % 2**32)


def nifti_bytes(labels: Labels, spacing: tuple[float, float, float]) -> bytes:
    """NIfTI 1 with its intent, labels, and the place of voxels in millimetres."""
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, *labels.shape, 1, 1, 1, 1)
    struct.pack_into("<hhh", header, 68, 1002, 2, 8)
    struct.pack_into("<8f", header, 76, 1, *spacing, 1, 1, 1, 1)
    struct.pack_into("<fff", header, 108, 352, 1, 0)
    header[123] = 2  # millimetres
    struct.pack_into("<hh", header, 252, 0, 1)
    rows = np.hstack([np.diag(spacing), np.zeros((3, 1))])
    struct.pack_into("<12f", header, 280, *rows.ravel())
    header[344:348] = b"n+1\0"
    return bytes(header) + labels.tobytes(order="F")


def nrrd_bytes(labels: Labels, spacing: tuple[float, float, float]) -> bytes:
    """NRRD with directions of space."""
    x, y, z = spacing
    header = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: right-anterior-superior\n"
        f"sizes: {' '.join(map(str, labels.shape))}\n"
        f"space directions: ({x},0,0) (0,{y},0) (0,0,{z})\nkinds: domain domain domain\nencoding: raw\n"
        "space origin: (0,0,0)\n\n"
    )
    return header.encode("ascii") + labels.tobytes(order="F")


def npy_bytes(labels: Labels) -> bytes:
    """NPY, which tells no size of voxels."""
    result = io.BytesIO()
    np.lib.format.write_array(result, np.ascontiguousarray(labels), version=(1, 0))
    return result.getvalue()


def tiff_bytes(labels: Labels, spacing: tuple[float, float, float]) -> bytes:
    """A stack of TIFF, a page for each layer along z, as ImageJ writes it: in millimetres."""
    width, height, layers = labels.shape
    about = f"ImageJ=1.53a\nimages={layers}\nslices={layers}\nspacing={spacing[2]}\nunit=mm\n".encode("ascii") + b"\0"
    pages = np.transpose(labels)
    size = width * height
    resolutions = b"".join(struct.pack("<II", 1000, round(1000 * step)) for step in spacing[:2])
    text_at = 8 + layers * size
    resolutions_at = text_at + len(about)
    data = about + resolutions
    first = text_at + len(data)
    data += bytes(first % 2)
    first += first % 2
    tags: dict[int, tuple[int, int, int]] = {
        256: (3, 1, width),
        257: (3, 1, height),
        258: (3, 1, 8),
        259: (3, 1, 1),
        262: (3, 1, 1),
        270: (2, len(about), text_at),
        277: (3, 1, 1),
        278: (3, 1, height),
        279: (4, 1, size),
        282: (5, 1, resolutions_at),
        283: (5, 1, resolutions_at + 8),
        296: (3, 1, 1),
    }
    length = 2 + 12 * (len(tags) + 1) + 4
    directories = b""
    for page in range(layers):
        entries = dict(sorted({**tags, 273: (4, 1, 8 + page * size)}.items()))
        directories += struct.pack("<H", len(entries))
        directories += b"".join(struct.pack("<HHII", tag, *entry) for tag, entry in entries.items())
        directories += struct.pack("<I", first + (page + 1) * length if page + 1 < layers else 0)
    return struct.pack("<2sHI", b"II", 42, first) + pages.tobytes() + data + directories


def write(path: Path, content: bytes) -> None:
    """A file."""
    path.write_bytes(content)
