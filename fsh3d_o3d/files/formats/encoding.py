"""Before a format is parsed: encodings of text, and pointers of Git LFS and git-annex that stand for a file."""

from __future__ import annotations

import codecs
import re

import numpy as np

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_ANNEX_POINTER = re.compile(rb"/annex/objects/\S+\s*")
_LARGEST_POINTER = 4096  # bytes; a pointer is one path, and PATH_MAX of Linux is as many
# UTF-32 first: its mark begins with that of UTF-16.
_WIDE_ENCODINGS = (
    (codecs.BOM_UTF32_LE, "utf-32-le", 4, 0),
    (codecs.BOM_UTF32_BE, "utf-32-be", 4, 3),
    (codecs.BOM_UTF16_LE, "utf-16-le", 2, 0),
    (codecs.BOM_UTF16_BE, "utf-16-be", 2, 1),
)  # mark, name, bytes of a character, place of the byte that ASCII uses
_INSPECTED = 2048  # bytes, a choice: more than the header of a binary STL, which may begin with anything
_ASCII_SHARE = 0.5  # of the characters, a choice: keywords and numbers are ASCII, a comment may be in any language
_UNMARKED = 16  # bytes that must all be ASCII where there is no mark, a choice: four characters of UTF-32


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
    for mark, encoding, width, place in _WIDE_ENCODINGS:
        marked = data.startswith(mark)
        body = data[len(mark) :] if marked else data
        # Without a mark, what comes first has to be ASCII as well: the header of a binary format is not wide.
        if not marked and not (len(data) >= _UNMARKED and _is_wide_ascii(body[:_UNMARKED], width, place, least=1.0)):
            continue
        if _is_wide_ascii(body[:_INSPECTED], width, place, least=_ASCII_SHARE):
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
