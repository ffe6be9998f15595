"""What a parser is given and gives back: a file's bytes, what lies beside it, what is to be said."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.geometry import MeshArrays, PointArrays

# A plain name: no folder, no drive, no scheme, nothing hidden in percent signs; file systems allow 255 bytes.
_PLAIN_NAME = re.compile(r"[^/\\:%\x00-\x1f\x7f]{1,255}")


def _nothing_beside(name: str) -> bytes:
    raise GeometryReadError(f"it needs the file '{name}' beside it, and was given alone")


@dataclass(frozen=True)
class Part:
    """A stretch of a file's geometry that the file tells apart from the rest: a component, a scan, a label."""

    name: str
    """What the file calls it, or what tells it apart."""
    points: int
    """How many vertices or points it has; those of the parts stand one after another."""
    triangles: int
    """How many triangles; 0 in a cloud."""


@dataclass(eq=False)
class Source:
    """A file while it is parsed."""

    data: bytes
    """The content."""
    content_beside: Callable[[str], bytes] = _nothing_beside
    """Returns the content of another file of the same folder by its plain name, or raises ``GeometryReadError``."""
    notes: list[str] = field(default_factory=list)
    """What was read in spite of something, one sentence without a full stop each."""
    used: dict[str, bytes] = field(default_factory=dict)
    """Content of the other files that were needed, by name."""
    parts: list[Part] = field(default_factory=list)
    """What the geometry consists of, where the file tells; all of it, in order."""

    def note(self, sentence: str) -> None:
        """Keep a sentence for the reader of the file; each is kept once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def beside(self, name: str) -> bytes:
        """Return the content of a file in the same folder.

        Raises:
            GeometryReadError: The name is more than a plain name, or the file cannot be read.
        """
        if name not in self.used:
            if not _PLAIN_NAME.fullmatch(name) or name in (os.curdir, os.pardir):
                raise GeometryReadError(f"it asks for '{name[:80]}': only plain names in the same folder are opened")
            self.used[name] = self.content_beside(name)
        return self.used[name]


@dataclass(frozen=True, eq=False)
class ReadFile:
    """A file that was read."""

    geometry: MeshArrays | PointArrays
    """What it holds."""
    notes: tuple[str, ...] = ()
    """What was read in spite of something, one sentence each."""
    used: tuple[bytes, ...] = ()
    """Content of the other files that were needed, in the order in which they were asked for; a reader process keeps
    them to itself."""
    parts: tuple[Part, ...] = ()
    """What the geometry consists of, where the file tells; all of it, in order."""


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number with its noun, in the plural where it is not one."""
    return f"{number} {noun}" if number == 1 else f"{number} {plural or noun + 's'}"
