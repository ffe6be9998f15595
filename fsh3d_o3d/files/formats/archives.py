"""Files packed as ``.gz`` or ``.zip``: the one that is meant, taken out in memory."""

from __future__ import annotations

import os
from collections.abc import Callable

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import gunzipped
from fsh3d_o3d.files.formats.table import PARSERS

ARCHIVES = (".gz", ".zip")
"""Extensions of files that hold other files."""
_NAMED = 3  # names that a message lists, a choice


def format_of(name: str) -> str:
    """Return the extension that tells the format, in small letters, of ``part.stl.gz`` both: ``".stl.gz"``."""
    stem, extension = os.path.splitext(name)  # noqa: PTH122 - keeps bytes that are not UTF-8
    if extension.lower() != ".gz":
        return extension.lower()
    inner = os.path.splitext(stem)[1].lower()  # noqa: PTH122 - same
    return f"{inner}.gz" if inner in PARSERS else ".gz"


def is_readable(name: str) -> bool:
    """Return whether a file's name says that it may be read: a format that is, packed or not, or a ZIP file."""
    extension = format_of(name)
    return extension in PARSERS or extension == ".zip" or extension.removesuffix(".gz") in PARSERS


def unpacked(path: str, data: bytes, beside: Callable[[str], bytes]) -> tuple[str, bytes, Callable[[str], bytes]]:
    """Return the name, the content and what lies beside the file that an archive holds; of all others, what was given.

    Args:
        path: Name of the file.
        data: Its content.
        beside: Returns the content of another file in its folder by name.

    Raises:
        GeometryReadError: The archive is damaged, encrypted, too large when unpacked, or it does not hold exactly one
            file that is read.
    """
    extension = format_of(path)
    if extension.endswith(".gz"):
        return path[: -len(".gz")], gunzipped(data), beside
    if extension != ".zip":
        return path, data, beside
    from fsh3d_o3d.files.formats.zip_parts import ZipParts  # here: a process that meets none starts without it

    parts = ZipParts(data)
    visible = [name for name in parts.names if not _hidden(name)]
    found = [name for name in visible if format_of(name) in PARSERS]
    packed = [name for name in visible if format_of(name).endswith(ARCHIVES)]
    if not found and packed:
        raise GeometryReadError(f"it holds an archive, {_listed(packed)}: unpack it first")
    if not found:
        raise GeometryReadError(f"none of its {len(visible)} files is of a format that is read: {_listed(visible)}")
    if len(found) > 1:
        raise GeometryReadError(f"it holds {len(found)} files that could be meant: {_listed(found)}; unpack it first")
    folder = found[0].rpartition("/")[0]

    def beside_it(name: str) -> bytes:
        return parts.content(f"{folder}/{name}" if folder else name)

    return found[0], parts.content(found[0]), beside_it


def _hidden(name: str) -> bool:
    """Whether a file is one that systems add by themselves."""
    return any(part.startswith((".", "__MACOSX")) for part in name.split("/"))


def _listed(names: list[str]) -> str:
    shown = ", ".join(f"'{name[:60]}'" for name in names[:_NAMED])
    return f"{shown} …" if len(names) > _NAMED else shown or "it holds none"
