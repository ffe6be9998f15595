"""Shapes in files: an ``.npz`` of plain arrays with a format version, checked on loading. No pickle."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._npz import ENTRY, npz_arrays, packing, read_npz
from fsh3d_o3d.errors import GeometryReadError

FORMAT_VERSION = 1
"""Raised when files written now could not be read by older versions."""
STORED_NAMES = {"kind": "geometry"}
"""What a file calls a field of a shape where the names differ: ``kind`` is that of the shape."""
_MAXIMUM_BYTES = 4 * 2**30  # unpacked: 512 shells of bandwidth 1024; what says it holds more is refused


def write_arrays(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays of numbers and strings as an ``.npz`` that ``np.load`` reads too; same arrays, same bytes.

    Raises:
        ValueError: The name does not end in ``.npz``.
        OSError: The file cannot be written; what was there stays.
    """
    name = os.fspath(path)
    if not name.lower().endswith(".npz"):
        raise ValueError(f"a shape is saved as .npz, got {name!r}")
    header = {"format": np.array("fsh3d_o3d"), "version": np.array(FORMAT_VERSION), "kind": np.array(kind)}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in {**header, **arrays}.items():
            entry = io.BytesIO()
            np.lib.format.write_array(entry, np.array(value, order="C"), allow_pickle=False)
            data = entry.getvalue()
            # ZipInfo's own date, 1980, instead of today's.
            archive.writestr(zipfile.ZipInfo(key + ENTRY), data, packing(data))
    atomic_write_bytes(path, buffer.getvalue())


def read_arrays(path: str | os.PathLike[str], data: bytes | None = None) -> tuple[str, dict[str, NDArray[Any]]]:
    """Read what ``write_arrays`` wrote: the kind and the arrays.

    Args:
        path: The file.
        data: Its content, where it is known.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: Not such a file, damaged, too large, or of a newer version.
    """
    name = os.fspath(path)
    try:
        given = (
            read_npz(path, _MAXIMUM_BYTES) if data is None else npz_arrays(io.BytesIO(data), len(data), _MAXIMUM_BYTES)
        )
        arrays = dict(given)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise GeometryReadError(f"{name}: {error.strerror or error}") from None
    except ValueError as error:
        raise GeometryReadError(f"{name}: not a shape file, or damaged ({error})") from None
    return _checked(name, arrays)


def _checked(name: str, arrays: dict[str, NDArray[Any]]) -> tuple[str, dict[str, NDArray[Any]]]:
    """Return what the arrays of a file are, and those without what says so.

    Raises:
        GeometryReadError: Not such a file, or of a newer version.
    """
    if "format" not in arrays or str(arrays.pop("format")) != "fsh3d_o3d" or not {"version", "kind"} <= arrays.keys():
        raise GeometryReadError(f"{name}: an .npz, but not one of fsh3d_o3d")
    version = arrays.pop("version")
    if version.shape != () or version.dtype.kind not in "iu" or int(version) < 1:
        raise GeometryReadError(f"{name}: its format version is malformed")
    if int(version) > FORMAT_VERSION:
        raise GeometryReadError(
            f"{name}: format version {int(version)}; this version of fsh3d_o3d reads up to {FORMAT_VERSION}: upgrade it"
        )
    return str(arrays.pop("kind")), arrays


def field(
    path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], name: str, dimensions: int
) -> NDArray[np.float64]:
    """One array of finite numbers with so many axes, as float64."""
    if name not in arrays:
        raise GeometryReadError(f"{os.fspath(path)}: {name} is missing")
    array = arrays[name]
    if array.ndim != dimensions or array.dtype.kind not in "fiu" or not np.isfinite(array).all() or array.size == 0:
        raise GeometryReadError(f"{os.fspath(path)}: {name} is malformed ({array.dtype}, shape {array.shape})")
    return array.astype(np.float64, copy=False)
