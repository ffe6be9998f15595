"""What stands before any format: encodings of text, and pointers that stand for a file."""

from __future__ import annotations

import codecs
import re

import numpy as np

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_ANNEX_POINTER = re.compile(rb"/annex/objects/\S+\s*")
_LARGEST_POINTER = 4096  # bytes
# UTF-32 first: its mark begins with that of UTF-16.
_WIDE = (
    (codecs.BOM_UTF32_LE, "utf-32-le", 4, 0),
    (codecs.BOM_UTF32_BE, "utf-32-be", 4, 3),
    (codecs.BOM_UTF16_LE, "utf-16-le", 2, 0),
    (codecs.BOM_UTF16_BE, "utf-16-be", 2, 1),
)  # mark, name, bytes of a character, place of the byte that ASCII uses
_LOOKED_AT = 2048  # bytes; more than the header of a binary STL, which may begin with anything
_MOSTLY = 0.5  # share of ASCII; a comment may be in any language
_LEAST = 16  # bytes without a mark that can be told to be text


def check_not_a_pointer(data: bytes) -> None:
    """Raise ``GeometryReadError`` where the content only tells where the file is."""
    if data.startswith(_LFS_POINTER):
        raise GeometryReadError("a Git LFS pointer, not the file itself: fetch it with 'git lfs pull'")
    if len(data) <= _LARGEST_POINTER and _ANNEX_POINTER.fullmatch(data):
        raise GeometryReadError("a git-annex pointer, not the file itself: fetch it with 'git annex get'")


def plain_text(source: Source) -> bytes:
    """Return the content without a byte-order mark, in UTF-8 where it was UTF-16 or UTF-32; what is not text stays.

    Raises:
        GeometryReadError: UTF-16 or UTF-32 breaks off or is damaged.
    """
    data = source.data
    if data.startswith(codecs.BOM_UTF8):
        return data[len(codecs.BOM_UTF8) :]
    for mark, encoding, width, place in _WIDE:
        marked = data.startswith(mark)
        body = data[len(mark) :] if marked else data
        # Without a mark, what comes first has to be ASCII as well: the header of a binary format is not wide.
        if not marked and not (len(data) >= _LEAST and _is_wide_ascii(body[:_LEAST], width, place, least=1.0)):
            continue
        if _is_wide_ascii(body[:_LOOKED_AT], width, place, least=_MOSTLY):
            return _decoded(source, body, encoding, marked=marked)
    return data


def _is_wide_ascii(head: bytes, width: int, place: int, *, least: float) -> bool:
    """Whether characters of ``width`` bytes are text, and ``least`` is ASCII among it.

    A binary file may begin with the bytes of a mark, but not go on with a letter and zeros in turn.
    """
    units = np.frombuffer(head[: len(head) // width * width], dtype=np.uint8).reshape(-1, width)
    low = units[:, place]
    high = np.delete(units, place, axis=1)
    letters = ((low >= 32) | ((low >= 9) & (low <= 13))) & ~high.any(axis=1)
    empty = ~units.any(axis=1)
    return len(units) > 0 and bool(letters.mean() >= least) and not empty.any()


def _decoded(source: Source, body: bytes, encoding: str, *, marked: bool) -> bytes:
    name = encoding[:6].upper()
    try:
        text = body.decode(encoding).encode("utf-8")
    except UnicodeError:
        raise GeometryReadError(f"truncated or damaged: the text is {name}, but not all of it") from None
    source.note(f"the text is {name}" if marked else f"the text is {name} without a byte-order mark")
    return text
