"""Point Cloud Data, the format of PCL: text, binary and LZF-compressed."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import cloud_of
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import TextLines, text_reason
from fsh3d_o3d.geometry import PointArrays

_HEADER = re.compile(rb"(?:[^\n]*\n)*?[ \t]*DATA[ \t]+(\w+)[ \t]*(?:\r?\n|$)", re.IGNORECASE)
_MAXIMUM_HEADER = 1 << 16  # bytes; PCL writes some hundred, and what is no PCD is not searched to its end
_OTHER_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z", "red": "r", "green": "g", "blue": "b"}
_NORMALS = ("normal_x", "normal_y", "normal_z")
_KINDS = ("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8")
_FILLING = b"\0\n\r "  # PCL fills up to whole pages of memory
_LZF_LARGEST_RATIO = 88  # unpacked over packed bytes: three stand for at most 264


@dataclass(frozen=True)
class _Cloud:
    """What the header says."""

    fields: tuple[str, ...]
    """Names of the fields."""
    dtypes: tuple[np.dtype[np.generic], ...]
    """Type of each field's values."""
    counts: tuple[int, ...]
    """How many values each field has."""
    points: int
    """Number of points."""

    @property
    def record(self) -> np.dtype[np.void]:
        """One point as a structured type; fields go by number, as names may repeat (padding is called _)."""
        return np.dtype([(str(i), d, (c,)) for i, (d, c) in enumerate(zip(self.dtypes, self.counts, strict=True))])


def parse_pcd(source: Source) -> PointArrays:
    """Return a PCD file with its normals and colours, without the NaN points that mark what was not seen."""
    data = source.data
    if b"\n" not in data[:_MAXIMUM_HEADER]:  # line ends of the old Mac OS
        data = data.replace(b"\r", b"\n")
    header = _HEADER.match(data[:_MAXIMUM_HEADER])
    if header is None:
        raise GeometryReadError("truncated: the header has no DATA line")
    cloud = _cloud(source, data[: header.start(1)])
    body = data[header.end() :]
    match header[1].lower():
        case b"ascii":
            columns = _text(body, cloud)
        case b"binary":
            columns = _binary(source, body, cloud)
        case b"binary_compressed":
            columns = _compressed(source, body, cloud)
        case other:
            raise GeometryReadError(f"DATA must be ascii, binary or binary_compressed, found {text_reason(other)}")
    named = _named(cloud.fields, columns)
    if any(name not in named or named[name].shape[1] != 1 for name in "xyz"):
        raise GeometryReadError("there are no fields x, y and z")
    normals = _stack(named, _NORMALS) if all(name in named for name in _NORMALS) else None
    return cloud_of(source, _stack(named, "xyz"), normals, _colors(named))


def _named(fields: tuple[str, ...], columns: list[NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """Return the fields by name; ``X`` and ``nx`` are ``x`` and ``normal_x`` where those are not there themselves."""
    named = {name: column for name, column in zip(fields, columns, strict=True) if name != "_"}
    for name, column in list(named.items()):
        lower = name.lower()
        named.setdefault(_OTHER_NAMES.get(lower, lower), column)
    return named


def _cloud(source: Source, header: bytes) -> _Cloud:
    entries: dict[str, list[str]] = {}
    for line in header.decode("latin-1").splitlines():
        words = line.split("#", 1)[0].split()
        if words:
            entries[words[0].upper()] = words[1:]
    try:
        fields = tuple(entries["COLUMNS"] if "COLUMNS" in entries else entries["FIELDS"])  # the older name first
        kinds = _kinds(source, entries, len(fields))
        counts = tuple(int(c) for c in entries.get("COUNT", ["1"] * len(fields)))
        points = _points(source, entries)
        stated = int(entries.get("POINTS", [str(points)])[0])
    except (KeyError, IndexError, ValueError) as error:
        raise GeometryReadError(f"the header is damaged ({_reason(error)})") from None
    if not fields or not len(fields) == len(kinds) == len(counts) or min(counts) < 1 or max(counts) > 1 << 16:
        raise GeometryReadError("the header is damaged: FIELDS, SIZE, TYPE and COUNT disagree")
    if points != stated or points < 1:
        raise GeometryReadError(f"the header announces {stated} points, width times height is {points}")
    return _Cloud(fields, tuple(np.dtype("<" + kind) for kind in kinds), counts, points)


def _kinds(source: Source, entries: dict[str, list[str]], fields: int) -> list[str]:
    if "SIZE" not in entries and "TYPE" not in entries:
        source.note("the header gives no SIZE and TYPE; the fields were taken for float32, as in the first versions")
        return ["f4"] * fields
    kinds = [f"{t.lower()}{int(s)}" for t, s in zip(entries["TYPE"], entries["SIZE"], strict=True)]
    if not all(kind in _KINDS for kind in kinds):
        raise ValueError("TYPE and SIZE name no number")
    return kinds


def _points(source: Source, entries: dict[str, list[str]]) -> int:
    missing = [name for name in ("WIDTH", "HEIGHT") if name not in entries]
    if not missing:
        return int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    if "POINTS" in entries:
        source.note(f"the header gives no {' and '.join(missing)}; POINTS tells how many points there are")
        return int(entries["POINTS"][0])
    if missing == ["HEIGHT"]:
        source.note("the header gives no HEIGHT; it was taken for 1")
        return int(entries["WIDTH"][0])
    raise ValueError("neither WIDTH and HEIGHT nor POINTS is there")


def _reason(error: Exception) -> str:
    return f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)[:80]


def _text(body: bytes, cloud: _Cloud) -> list[NDArray[np.generic]]:
    lines = TextLines.of(body)
    if len(lines) != cloud.points:
        raise GeometryReadError(f"the header announces {cloud.points} points, but {len(lines)} lines follow")
    table = lines.span(0, len(lines)).columns("point", minimum=1)
    if table.shape[1] != sum(cloud.counts):
        raise GeometryReadError(f"each point needs {sum(cloud.counts)} numbers, found {table.shape[1]}")
    with np.errstate(over="ignore", invalid="ignore"):
        # Coordinates stay as printed; only packed colours need the type of the header.
        return [
            column.astype(dtype) if name.lower() in ("rgb", "rgba") else column
            for name, dtype, column in zip(
                cloud.fields, cloud.dtypes, np.split(table, np.cumsum(cloud.counts)[:-1], axis=1), strict=True
            )
        ]


def _binary(source: Source, body: bytes, cloud: _Cloud) -> list[NDArray[np.generic]]:
    needed = cloud.points * cloud.record.itemsize
    if len(body) < needed:
        raise GeometryReadError(f"truncated: {cloud.points} points need {needed} bytes, but {len(body)} follow")
    extra = len(body) - needed
    if body[needed:].strip(_FILLING):
        if extra >= cloud.record.itemsize:
            raise GeometryReadError(f"{extra} bytes follow the {cloud.points} points that the header announces")
        source.note(f"{counted(extra, 'byte')} behind the {cloud.points} points that the header announces passed over")
    table = np.frombuffer(body, dtype=cloud.record, count=cloud.points)
    return [table[str(number)] for number in range(len(cloud.fields))]


def _compressed(source: Source, body: bytes, cloud: _Cloud) -> list[NDArray[np.generic]]:
    """Read what PCL compresses: sizes, then the fields one after another (not point by point) as one LZF block."""
    packed, unpacked = (int.from_bytes(body[at : at + 4], "little") for at in (0, 4))
    if len(body) < 8 or len(body) - 8 < packed:
        raise GeometryReadError(
            f"truncated: {packed} compressed bytes are announced, but {max(0, len(body) - 8)} follow"
        )
    if unpacked != cloud.points * cloud.record.itemsize or unpacked > packed * _LZF_LARGEST_RATIO:
        raise GeometryReadError(f"damaged: {cloud.points} points cannot unpack from {packed} to {unpacked} bytes")
    raw = _lzf(body[8 : 8 + packed], unpacked)
    if body[8 + packed :].strip(_FILLING):
        source.note(f"{counted(len(body) - 8 - packed, 'byte')} behind the compressed points passed over")
    columns: list[NDArray[np.generic]] = []
    offset = 0
    for dtype, count in zip(cloud.dtypes, cloud.counts, strict=True):
        column = np.frombuffer(raw, dtype=dtype, count=cloud.points * count, offset=offset)
        columns.append(column.reshape(cloud.points, count))
        offset += column.nbytes
    return columns


def _lzf(packed: bytes, size: int) -> bytes:
    """Unpack LZF: runs of literals, and copies of bytes unpacked before. Each depends on the last: a plain loop."""
    out = bytearray()
    at = 0
    try:
        while at < len(packed):
            control = packed[at]
            at += 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            back = len(out) - ((control & 31) << 8) - packed[at] - 1
            at += 1
            if back < 0:
                raise GeometryReadError("damaged: a copy from before the beginning of the compressed data")
            chunk = out[back : back + length + 2]
            # A copy may overlap its own end: the bytes between repeat.
            out += (chunk * ((length + 1) // len(chunk) + 1))[: length + 2]
            if len(out) > size:
                break
    except IndexError:
        raise GeometryReadError("truncated inside the compressed data") from None
    if at != len(packed) or len(out) != size:
        raise GeometryReadError(f"damaged: the compressed data unpack to {len(out)} bytes instead of {size}")
    return bytes(out)


def _stack(named: dict[str, NDArray[np.generic]], names: str | tuple[str, ...]) -> Float64Array:
    if any(named[name].shape[1] != 1 for name in names):
        raise GeometryReadError("coordinates and normals must be single values")
    return np.concatenate([named[name] for name in names], axis=1).astype(np.float64)


def _colors(named: dict[str, NDArray[np.generic]]) -> Float64Array | None:
    """Colours packed as 0x00RRGGBB in four bytes, which often claim to be a float, or one byte each."""
    column = named.get("rgb", named.get("rgba"))
    if column is not None and column.dtype.itemsize == 4 and column.shape[1] == 1:
        packed = np.ascontiguousarray(column).view("<u4")
        return ((packed >> np.array([16, 8, 0], dtype=np.uint32)) & 255) / 255.0
    if not all(name in named and named[name].shape[1] == 1 for name in "rgb"):
        return None
    apart = _stack(named, "rgb")
    if not ((apart >= 0) & (apart <= 255)).all():
        return None
    return apart if named["r"].dtype.kind == "f" and apart.max(initial=0) <= 1 else apart / 255
