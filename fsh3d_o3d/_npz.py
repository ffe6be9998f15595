"""Arrays in ``.npz`` files that may say anything of themselves: sizes are checked before memory is asked for.

``np.load`` believes what the file says: a header can ask for any memory, a few megabytes unpack to gigabytes.
"""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._regular_file import open_regular

ENTRY = ".npy"
"""What the name of an array ends in, in the archive."""
_MOST_ENTRIES = 64  # arrays, a choice: far more than the package writes into a file
_LARGEST_DIRECTORY = 2**16  # bytes, a choice: a kilobyte for each entry, of which names take most
_LARGEST_HEADER = 1000  # bytes; those of plain arrays have 128
_CHUNK = 2**20  # bytes at a time: larger reads are no faster, and so little is lost on a file that lies
_FREE_BYTES = 64 * 2**20  # a choice, that an array may take however well it is packed
_LARGEST_RATIO = 100  # of packing, beyond, a choice; noise in the last digits keeps that of measured numbers below 2
# At the end of a file without a comment: the end of the directory, and before it what an archive beyond 4 GiB has.
_END, _END_BYTES = b"PK\x05\x06", 22
_LOCATOR, _LOCATOR_BYTES = b"PK\x06\x07", 20


def packing(data: bytes) -> int:
    """Return how an array is to be packed so that ``read_npz`` takes it back."""
    if len(data) > _FREE_BYTES and len(zlib.compress(data, 1)) * _LARGEST_RATIO < len(data):
        return zipfile.ZIP_STORED
    return zipfile.ZIP_DEFLATED


def read_npz(path: str | os.PathLike[str], largest: int) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of a file by name; only numbers and strings, which together take ``largest`` bytes at most.

    Raises:
        OSError: It cannot be read, or is not a regular file.
        ValueError: It is no such file, damaged, or too large; without the file's name.
    """
    with open_regular(path) as file:
        return npz_arrays(file, os.fstat(file.fileno()).st_size, largest)


def npz_arrays(file: BinaryIO, size: int, largest: int) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of an open file of so many bytes, as ``read_npz`` does.

    Raises:
        ValueError: It is no such file, damaged, or too large.
    """
    if size > largest:
        raise ValueError(_too_large(size, largest))
    _require_small_directory(file, size)
    try:
        with zipfile.ZipFile(file) as archive:
            return _arrays(archive, size, largest)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OverflowError) as error:
        raise ValueError(str(error)) from None
    except MemoryError:
        raise ValueError("its arrays need more memory than there is") from None


def _arrays(archive: zipfile.ZipFile, size: int, largest: int) -> Mapping[str, NDArray[Any]]:
    entries = archive.infolist()
    if sum(entry.file_size for entry in entries) > largest:
        raise ValueError(_too_large(sum(entry.file_size for entry in entries), largest))
    if sum(entry.compress_size for entry in entries) > size or len({entry.filename for entry in entries}) < len(
        entries
    ):
        raise ValueError("its entries overlap")
    for entry in entries:
        if entry.file_size > max(_FREE_BYTES, _LARGEST_RATIO * entry.compress_size):
            raise ValueError(f"{entry.compress_size} bytes unpack to {entry.file_size}")
    return {entry.filename.removesuffix(ENTRY): _array(archive, entry) for entry in entries}


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(entry) as opened:
        stream = cast(Any, opened)  # its stubs lack readinto
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"an array of version {version}")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream, max_header_size=_LARGEST_HEADER)
        if dtype.kind not in "fiuU":
            raise ValueError(f"unexpected dtype {dtype}")
        count = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or stream.tell() + count != entry.file_size:
            raise ValueError(f"an array of shape {shape} and {dtype} in an entry of {entry.file_size} bytes")
        data = np.empty(count, dtype=np.uint8)
        rest = memoryview(cast(Any, data))
        while rest:
            got = stream.readinto(rest[:_CHUNK])
            if got == 0:
                raise ValueError("truncated")
            rest = rest[got:]
        if stream.read(1):  # which also looks at the checksum
            raise ValueError("more bytes than announced")
    return data.view(dtype).reshape(shape, order="F" if fortran else "C")


def _require_small_directory(file: BinaryIO, size: int) -> None:
    """Look at what ``zipfile`` would read whole, before it does."""
    file.seek(max(0, size - _END_BYTES - _LOCATOR_BYTES))
    tail = file.read()
    end = tail[-_END_BYTES:]
    if not end.startswith(_END) or len(end) < _END_BYTES:
        raise ValueError("File is not a zip file, or its end is missing")
    if tail[:-_END_BYTES].startswith(_LOCATOR):
        raise ValueError("an archive of a kind for more than 4 GiB")
    entries, length = int.from_bytes(end[10:12], "little"), int.from_bytes(end[12:16], "little")
    if entries > _MOST_ENTRIES or length > _LARGEST_DIRECTORY:
        raise ValueError(f"{entries} entries, where there are {_MOST_ENTRIES} at most")
    file.seek(0)


def _too_large(size: int, largest: int) -> str:
    return f"the arrays would take more than {largest / 2**20:.4g} MiB: {size / 2**20:.4g} MiB"
