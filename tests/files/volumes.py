"""Volumes of voxels to be written into files: labels and values."""

from __future__ import annotations

import gzip
import struct

import numpy as np

SPACING = np.array([0.5, 0.75, 2.0])
SHAPE = (40, 30, 14)


def labels() -> np.ndarray:
    """(40, 30, 14) labels: 3 is an ellipsoid, 7 a box of 8 x 6 x 4 voxels that touches the end of the volume."""
    volume = np.zeros(SHAPE, dtype=np.uint8)
    i, j, k = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    volume[((i - 14) * 0.5) ** 2 + ((j - 14) * 0.75) ** 2 + ((k - 6) * 2.0) ** 2 < 36] = 3  # a ball of 6 mm
    volume[32:, 20:26, 2:6] = 7
    return volume


def values() -> np.ndarray:
    """(40, 30, 14) float32: 100 − 10 · the distance in mm from (7, 10.5, 12)."""
    i, j, k = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    return (100 - 10 * np.sqrt((i * 0.5 - 7) ** 2 + (j * 0.75 - 10.5) ** 2 + (k * 2.0 - 12) ** 2)).astype("<f4")


def nifti(volume: np.ndarray, affine: np.ndarray | None = None, intent: int = 0) -> bytes:
    """NIfTI 1."""
    header = bytearray(352)
    kinds = {"u1": 2, "i2": 4, "f4": 16, "f8": 64}
    shape = [*volume.shape, 1, 1, 1, 1][:7]
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, volume.ndim, *shape)
    struct.pack_into("<hhh", header, 68, intent, kinds[volume.dtype.str[1:]], volume.dtype.itemsize * 8)
    struct.pack_into("<8f", header, 76, 1, *SPACING, 1, 1, 1, 1)
    struct.pack_into("<ffffB", header, 108, 352, 1, 0, 0, 0)
    header[123] = 2  # millimetres
    if affine is not None:
        struct.pack_into("<hh", header, 252, 0, 1)
        struct.pack_into("<12f", header, 280, *affine[:3].ravel())
    header[344:348] = b"n+1\0"
    return bytes(header) + volume.tobytes(order="F")


def nrrd(volume: np.ndarray, encoding: str = "raw", more: str = "", name: str = "") -> tuple[bytes, bytes]:
    """Header and body of NRRD."""
    kind = {"u1": "uint8", "f4": "float", "i2": "short"}[volume.dtype.str[1:]]
    x, y, z = SPACING
    header = (
        f"NRRD0004\n# made by hand\ntype: {kind}\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {' '.join(map(str, volume.shape))}\nspace directions: ({x},0,0) (0,{y},0) (0,0,{z})\n"
        f"kinds: domain domain domain\nendian: little\nencoding: {encoding}\nspace origin: (0,0,0)\n{more}"
        + (f"data file: {name}\n" if name else "")
        + "\n"
    ).encode()
    raw = volume.tobytes(order="F")
    bodies = {
        "raw": lambda: raw,
        "gzip": lambda: gzip.compress(raw, mtime=0),
        "hex": lambda: raw.hex().encode(),
        "ascii": lambda: " ".join(map(str, volume.ravel(order="F").tolist())).encode(),
    }
    return header, bodies[encoding]()
