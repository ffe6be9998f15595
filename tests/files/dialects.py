"""Files as programs write them: each sound in its own odd way, with what it must be read as."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from tests.files.mutations import VERTICES

NOT_COUNTED = "nothing in the file tells how many lines there must be"
NO_READER = "it has no reader for this format"


@dataclass(frozen=True)
class Dialect:
    """A sound file."""

    name: str
    """File name with extension, different for each."""
    data: bytes
    """Content."""
    shape: str = "octahedron"
    """What it holds: the "octahedron" of ``mutations``, a "box" of 1 x 2 x 3 in polygons, or "cloud", its vertices."""
    normals: bool = False
    """A cloud has the normals of ``mutations``; where False it must have none."""
    colors: bool = False
    """A cloud has the colours of ``mutations``; where False it must have none."""
    tail: int = 0
    """How many bytes at the end may be missing without loss."""
    trimesh: str = ""
    """Why trimesh is no witness: what it does instead."""
    cut: str = ""
    """Why it need not show that the file was cut off."""
    beside: dict[str, bytes] = field(default_factory=dict)
    """Other files in the same folder."""

    @property
    def prefixes(self) -> Iterator[bytes]:
        """The file cut off at a third, at half and further behind."""
        whole = len(self.data) - self.tail
        for part in (0.35, 0.5, 0.65, 0.8, 0.93):
            yield self.data[: int(whole * part)]


def line_ends(text: bytes) -> dict[str, bytes]:
    """The same text with the line ends of three systems."""
    return {"lf": text, "crlf": text.replace(b"\n", b"\r\n"), "cr": text.replace(b"\n", b"\r")}


def encodings(text: bytes) -> dict[str, bytes]:
    """The same text with a byte-order mark, and in UTF-16 and UTF-32, with and without."""
    letters = text.decode("ascii")
    return {
        "utf8mark": codecs.BOM_UTF8 + text,
        "utf16le": codecs.BOM_UTF16_LE + letters.encode("utf-16-le"),
        "utf16be": codecs.BOM_UTF16_BE + letters.encode("utf-16-be"),
        "utf16none": letters.encode("utf-16-le"),
        "utf32": codecs.BOM_UTF32_LE + letters.encode("utf-32-le"),
    }


def spellings(numbers: str) -> dict[str, str]:
    """Lines of whole and decimal numbers, written in other ways; what is no number stays."""
    plain = re.compile(r"(?<![\w.])-?\d+\.\d+")

    def each(form: str) -> str:
        return plain.sub(lambda found: form % float(found[0]), numbers)

    short = plain.sub(lambda found: f"{float(found[0]):g}".replace("0.", ".") or "0", numbers)
    return {
        "six": each("%.6f"),
        "signed": each("%+.3f"),
        "exponent": each("%.9e"),
        "capital": each("%.4E"),
        "long": each("%.25f"),
        "short": short,
    }


def rows(table: np.ndarray, pattern: str = "%r %r %r") -> str:
    """Lines of a table."""
    return "".join(pattern % tuple(row) + "\n" for row in table.tolist())


POINTS = rows(VERTICES)
