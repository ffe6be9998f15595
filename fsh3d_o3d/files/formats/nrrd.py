"""NRRD: a volume behind, or beside, a header of lines."""

from __future__ import annotations

import bz2
import math
import re

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED, gunzipped
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.text import numbers
from fsh3d_o3d.files.formats.volumes import surfaces_of
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_KINDS = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_KIND_OF = {name: kind for kind, names in _KINDS.items() for name in names.split(", ")}
_HEADER = re.compile(rb"NRRD000\d\r?\n(.*?)(?:\r?\n\r?\n|\Z)", re.DOTALL)
_LARGEST_HEADER = 1 << 20  # bytes, a choice; those of segmentations have some thousand
_VECTOR = re.compile(r"none|\([^)]*\)")
_SEGMENT = re.compile(r"Segment(\d+)_(Name|LabelValue)")


def parse_nrrd(source: Source) -> MeshArrays | PointArrays:
    """Return the surfaces of a volume, in the coordinates of the space that its header names."""
    header = _HEADER.match(source.data[:_LARGEST_HEADER])
    if header is None:
        raise GeometryReadError("it does not begin with 'NRRD' and a version")
    fields, values = _fields(header[1])
    try:
        sizes = [int(word) for word in fields["sizes"].split()]
        kind = _KIND_OF[fields["type"].lower()]
        encoding = fields["encoding"].lower()
        rank = int(fields["dimension"])
    except (KeyError, ValueError) as error:
        raise GeometryReadError(f"damaged: its header lacks, or misspells, {str(error)[:60]}") from None
    if len(sizes) != rank or min(sizes, default=0) < 1 or math.prod(sizes) > MOST_UNPACKED:
        raise GeometryReadError(f"damaged: its sizes are {sizes} in {rank} dimensions")
    body = _body(source, fields, source.data[header.end() :])
    count = math.prod(sizes)
    voxels = _voxels(body, fields, encoding, kind, count).reshape(sizes, order="F")
    placement, order = _placement(fields, rank)
    names = _segments(values)
    return surfaces_of(source, np.transpose(voxels, order), placement, labels=bool(names), names=names)


def _fields(header: bytes) -> tuple[dict[str, str], dict[str, str]]:
    """Return the fields of the format, and the keys and values that programs have added."""
    fields: dict[str, str] = {}
    values: dict[str, str] = {}
    for line in header.decode("utf-8", "replace").splitlines():
        if line.startswith("#"):
            continue
        key, mark, value = line.partition(":=")
        if mark:
            values[key.strip()] = value.strip()
            continue
        name, mark, value = line.partition(":")
        if not mark:
            raise GeometryReadError(f"damaged: its header has a line '{line[:40]}'")
        fields[name.strip().lower().replace(" ", "")] = value.strip()
    return fields, values


def _segments(values: dict[str, str]) -> dict[int, str]:
    """Return the names of labels that 3D Slicer keeps among the values."""
    numbered = {found[1] for found in map(_SEGMENT.fullmatch, values) if found is not None}
    labels = {number: values.get(f"Segment{number}_LabelValue", "") for number in numbered}
    return {
        int(label): values.get(f"Segment{number}_Name", f"label {label}")
        for number, label in labels.items()
        if label.isdecimal()
    }


def _body(source: Source, fields: dict[str, str], behind: bytes) -> bytes:
    name = fields.get("datafile")
    if name is None:
        body = behind
    elif name.upper().startswith("LIST") or "%" in name:
        raise GeometryReadError("its voxels are in several other files, which are not read")
    else:
        body = source.beside(name.removeprefix("./"))
    try:
        lines, skipped = int(fields.get("lineskip", "0")), int(fields.get("byteskip", "0"))
    except ValueError:
        raise GeometryReadError("damaged: what is to be skipped is no number") from None
    for _ in range(min(lines, len(body))):
        body = body.partition(b"\n")[2]
    fields["skipped"] = str(skipped)
    return body


def _voxels(body: bytes, fields: dict[str, str], encoding: str, kind: str, count: int) -> np.ndarray:
    if encoding in ("gzip", "gz"):
        body = gunzipped(body)
    elif encoding in ("bzip2", "bz2"):
        try:
            engine = bz2.BZ2Decompressor()
            body = engine.decompress(body, MOST_UNPACKED)
        except (OSError, ValueError, EOFError):
            raise GeometryReadError("damaged: its voxels cannot be unpacked") from None
        if not engine.eof:
            raise GeometryReadError("truncated: its voxels break off, or grow beyond what is read")
    elif encoding in ("ascii", "text", "txt"):
        listed = numbers(body)
        if len(listed) != count:
            raise GeometryReadError(f"truncated or damaged: {count} voxels are announced, {len(listed)} follow")
        return listed.astype(np.dtype(kind))
    elif encoding == "hex":
        try:
            body = bytes.fromhex(body.decode("ascii"))
        except ValueError:
            raise GeometryReadError("damaged: its voxels are not in hexadecimal digits") from None
    elif encoding != "raw":
        raise GeometryReadError(f"its voxels are in the encoding '{encoding[:20]}', which is not read")
    dtype = np.dtype(kind)
    if dtype.itemsize > 1 and fields.get("endian", "").lower() not in ("little", "big"):
        raise GeometryReadError("damaged: its header does not say 'endian: little' or 'endian: big'")
    dtype = dtype.newbyteorder(">" if fields.get("endian", "").lower() == "big" else "<")
    needed = count * dtype.itemsize
    skipped = int(fields["skipped"])
    start = len(body) - needed if skipped == -1 else skipped
    if start < 0 or len(body) - start < needed:
        raise GeometryReadError(f"truncated or damaged: {count} voxels need {needed} bytes, but {len(body)} follow")
    return np.frombuffer(body, dtype=dtype, count=count, offset=start)


def _placement(fields: dict[str, str], rank: int) -> tuple[Float64Array, list[int]]:
    """Return (3, 4), from indices to coordinates, and the order of the axes: those of space first."""
    directions = _VECTOR.findall(fields.get("spacedirections", ""))
    if not directions:
        words = fields.get("spacings", " ".join(["1"] * rank)).split()
        steps = [abs(_number(word)) for word in words]
        steps = [step if np.isfinite(step) else 1.0 for step in steps]
        if len(steps) != rank:
            raise GeometryReadError(f"damaged: {len(steps)} spacings for {rank} dimensions")
        return np.hstack([np.diag([*steps, 1.0, 1.0][:3]), np.zeros((3, 1))]), list(range(rank))
    spatial = [axis for axis, vector in enumerate(directions) if vector != "none"]
    if len(directions) != rank or len(spatial) != 3:
        raise GeometryReadError(f"its space has {len(spatial)} dimensions instead of 3")
    columns = [_vector(directions[axis]) for axis in spatial]
    origin = _vector(fields.get("spaceorigin", "(0,0,0)"))
    return np.column_stack([*columns, origin]), [*spatial, *(axis for axis in range(rank) if axis not in spatial)]


def _vector(text: str) -> list[float]:
    values = [_number(word) for word in text.strip().strip("()").split(",")]
    if len(values) != 3:
        raise GeometryReadError(f"damaged: '{text[:40]}' is no vector of three numbers")
    return values


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise GeometryReadError(f"damaged: '{word[:20]}' should be a number") from None
