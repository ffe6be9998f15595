"""NIfTI 1 and 2 in one file: volumes of medicine, in millimetres of the scanner's or a standard space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import gunzipped
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.volumes import surfaces_of
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_KINDS = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
_LABEL = 1002  # the intent of a file whose values are labels
_MILLIMETRES = {1: 1000.0, 3: 0.001}  # in units: metre, micrometre; all else is taken for millimetres
_UNIT_OF_LENGTH = 0b111  # bits of the units


@dataclass(frozen=True)
class _Layout:
    """Where the fields of a version are, and what numbers they hold."""

    size: int
    integer: str
    real: str
    kind: int
    shape: tuple[int, str]
    spacing: int
    start: tuple[int, str]
    slope: int
    codes: tuple[int, str]
    quaternion: int
    rows: int
    units: tuple[int, str]
    intent: tuple[int, str]


_FIRST = _Layout(348, "i2", "f4", 70, (40, "i2"), 76, (108, "f4"), 112, (252, "i2"), 256, 280, (123, "u1"), (68, "i2"))
_SECOND = _Layout(
    540, "i4", "f8", 12, (16, "i8"), 104, (168, "i8"), 176, (344, "i4"), 352, 400, (500, "i4"), (504, "i4")
)
_MAGIC = {b"n+1\0": (344, _FIRST), b"n+2\0": (4, _SECOND)}
_APART = (b"ni1\0", b"ni2\0")  # the header alone, of two files


def parse_nifti(source: Source) -> MeshArrays | PointArrays:
    """Return the surfaces of a volume in millimetres; labels where the file says so, or where they look like some."""
    data = gunzipped(source.data) if source.data[:2] == b"\x1f\x8b" else source.data
    layout = _layout(data)
    order = "<" if int.from_bytes(data[:4], "little") == layout.size else ">"

    def field(at: int, kind: str, count: int = 1) -> NDArray[np.generic]:
        return np.frombuffer(data, dtype=order + kind, count=count, offset=at)

    shape = field(*layout.shape, 8).astype(np.int64)
    rank = int(shape[0])
    if not 1 <= rank <= 7 or (shape[1 : rank + 1] < 1).any():
        raise GeometryReadError(f"damaged: its sizes are {shape[1:].tolist()} in {rank} dimensions")
    sizes = tuple(int(length) for length in shape[1 : rank + 1])
    kind = _KINDS.get(int(field(layout.kind, "i2")[0]))
    if kind is None:
        raise GeometryReadError(f"its voxels are of kind {int(field(layout.kind, 'i2')[0])}, which is not read")
    start = float(field(*layout.start)[0])
    needed = int(np.prod([float(length) for length in sizes]) * np.dtype(kind).itemsize)
    if not layout.size <= start <= len(data) or start + needed > len(data):
        raise GeometryReadError(
            f"truncated or damaged: {' x '.join(map(str, sizes))} voxels need {needed} bytes from byte {start:.0f} on, "
            f"the file has {len(data)}"
        )
    voxels = field(int(start), kind, needed // np.dtype(kind).itemsize).reshape(sizes, order="F")
    slope, shift = field(layout.slope, layout.real, 2).astype(np.float64)
    if np.isfinite([slope, shift]).all() and slope != 0 and (slope, shift) != (1, 0):
        voxels = voxels * slope + shift
    placement = _placement(field, layout)
    return surfaces_of(source, voxels, placement, labels=int(field(*layout.intent)[0]) == _LABEL)


def _layout(data: bytes) -> _Layout:
    for magic, (at, layout) in _MAGIC.items():
        if data[at : at + 4] == magic:
            if len(data) < layout.size + 4:
                break
            if layout.size not in (int.from_bytes(data[:4], "little"), int.from_bytes(data[:4], "big")):
                raise GeometryReadError("damaged: its first number is not the length of its header")
            return layout
        if data[at : at + 4] in _APART:
            raise GeometryReadError("its voxels are in another file, .img: save both as one, .nii")
    raise GeometryReadError("truncated, or no NIfTI: the marks 'n+1' and 'n+2' are missing")


def _placement(field: object, layout: _Layout) -> Float64Array:
    """Return (3, 4), from indices to millimetres: the rows of the header, its rotation, or the spacing alone."""
    get = field
    assert callable(get)
    quaternion_code, row_code = (int(code) for code in get(*layout.codes, 2))
    real = layout.real
    spacing = get(layout.spacing, real, 4).astype(np.float64)
    unit = int(get(*layout.units)[0]) & _UNIT_OF_LENGTH
    scale = _MILLIMETRES.get(unit, 1.0)
    if row_code > 0:
        return np.asarray(get(layout.rows, real, 12).astype(np.float64).reshape(3, 4) * scale)
    steps = np.abs(spacing[1:4])
    if quaternion_code <= 0:
        return np.asarray(np.hstack([np.diag(steps), np.zeros((3, 1))]) * scale)
    b, c, d, *shift = get(layout.quaternion, real, 6).astype(np.float64)
    a = np.sqrt(max(0.0, 1 - b * b - c * c - d * d))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    steps[2] *= -1 if spacing[0] < 0 else 1
    return np.asarray(np.column_stack([rotation * steps, shift]) * scale)
