"""The files in a ZIP file, unpacked in memory within bounds: no name in it is ever a name on the disk."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED

_MOST_PARTS = 65_536  # a choice: what the format without its extension can list
_ENCRYPTED = 0x1  # bit of a part's flags
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # the only ones that unpack piece by piece, within bounds
# An absolute name, a drive, or a way up: no program that packs files writes these.
_OUTSIDE = re.compile(r"/|[A-Za-z]:|(.*/)?\.\.(/|$)", re.DOTALL)


class ZipParts:
    """What a ZIP file holds."""

    def __init__(self, data: bytes) -> None:
        """Read the list of its parts.

        Raises:
            GeometryReadError: It is no ZIP file, cut off or damaged, or two parts have one name, or a name leads out.
        """
        try:
            self._file = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, OSError, struct.error, IndexError, NotImplementedError) as error:
            whole = data.startswith(b"PK")
            raise GeometryReadError(
                f"truncated or damaged: the list of parts at its end cannot be read ({_reason(error)})"
                if whole
                else "it is no ZIP file"
            ) from None
        self._room = MOST_UNPACKED
        self._parts: dict[str, zipfile.ZipInfo] = {}
        entries = self._file.infolist()
        if len(entries) > _MOST_PARTS:
            raise GeometryReadError(f"it holds {len(entries)} parts, more than {_MOST_PARTS}")
        for part in entries:
            name = part.filename.replace("\\", "/")
            if _OUTSIDE.match(name):
                raise GeometryReadError(f"a part is named '{name[:80]}', which leads out of it: not opened")
            if name in self._parts:
                raise GeometryReadError(f"damaged: two parts are named '{name[:80]}'")
            if not part.is_dir():
                self._parts[name] = part

    @property
    def names(self) -> list[str]:
        """Names of the parts, without folders, with slashes between these."""
        return list(self._parts)

    def content(self, name: str) -> bytes:
        """Return the bytes of a part; its length and checksum are checked.

        Raises:
            GeometryReadError: There is no such part, it is encrypted, packed in a way that is not read, damaged, or
                grows beyond ``MOST_UNPACKED``, all parts together.
        """
        part = self._parts.get(name)
        if part is None:
            raise GeometryReadError(f"there is no part '{name[:80]}' in it")
        shown = f"'{name[:80]}'"
        if part.flag_bits & _ENCRYPTED:
            raise GeometryReadError(f"{shown} is encrypted: unpack it with its password first")
        if part.compress_type not in _METHODS:
            raise GeometryReadError(f"{shown} is packed by method {part.compress_type}; only deflate is read")
        if part.file_size > self._room:
            raise GeometryReadError(f"{shown} grows to more than {MOST_UNPACKED} bytes when it is unpacked")
        try:
            with self._file.open(part) as stream:
                content = stream.read(part.file_size + 1)
                rest = stream.read(1)  # also where the checksum is compared
        except (zipfile.BadZipFile, EOFError, ValueError, OSError, struct.error, RuntimeError) as error:
            raise GeometryReadError(f"truncated or damaged: {shown} cannot be unpacked ({_reason(error)})") from None
        except zlib.error as error:
            raise GeometryReadError(f"damaged: {shown} cannot be unpacked ({_reason(error)})") from None
        if len(content) != part.file_size or rest:
            raise GeometryReadError(f"truncated or damaged: {shown} has other than its {part.file_size} bytes")
        self._room -= len(content)
        return content


def _reason(error: Exception) -> str:
    return str(error)[:80] or type(error).__name__
