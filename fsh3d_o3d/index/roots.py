"""Where the files of an index lie: paths below libraries that can move, and what rows hold of them.

A row of a file in a library holds a NUL, eight bytes that stand for the library, and the path below it. Where the
library lies is in the table ``roots``, once, so that a library that moves costs one row. A row of a file that was given
by itself holds its absolute path.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping

from fsh3d_o3d.files import absolute, is_uri
from fsh3d_o3d.index.errors import ShapeIndexError

_PREFIX = 9  # bytes: a NUL, with which no path begins, and the library's


def real_folder(path: str | os.PathLike[str]) -> str:
    """Return the absolute name of a folder without links, which is the same by whatever links it is reached."""
    name = absolute(path)
    return name if is_uri(name) else os.path.realpath(name)


def real_file(path: str | os.PathLike[str]) -> str:
    """Return the absolute name of a file in a folder without links; the file may be a link, which is kept."""
    return next(real_files([path]))


def real_files(paths: Iterable[str | os.PathLike[str]]) -> Iterator[str]:
    """Yield ``real_file`` of each path; each folder is looked at once."""
    folders: dict[str, str] = {}
    for path in paths:
        name = absolute(path)
        if is_uri(name):
            yield name
            continue
        folder, own = os.path.split(name)
        if folder not in folders:
            folders[folder] = os.path.realpath(folder)
        yield os.path.join(folders[folder], own)  # noqa: PTH118 - keeps bytes that are not UTF-8


def inside(folder: str) -> str:
    """Return what the names of all files below a folder begin with."""
    return os.path.join(folder, "")  # noqa: PTH118 - same


class LibraryRoots:
    """The libraries of an index, and where each lies now."""

    def __init__(self, index: str, locations: Mapping[bytes, str]) -> None:
        self._index = index
        self.locations = dict(locations)
        """The folder of each library, by what the paths in its rows begin with."""
        # The innermost first; of two in the same place, as after a library took the place of another, always the same.
        ordered = sorted(self.locations.items(), key=lambda item: (-len(item[1]), item))
        self._folders = [(inside(folder), own) for own, folder in ordered]
        self._starts = {own: folder for folder, own in self._folders}

    def path(self, stored: bytes) -> str:
        """Return the absolute path that a row holds.

        Raises:
            ShapeIndexError: It is of no known library.
        """
        if not stored.startswith(b"\0"):
            return os.fsdecode(stored)
        start = self._starts.get(stored[:_PREFIX])
        if start is None:
            raise ShapeIndexError(f"{self._index}: the index is damaged: it does not know where a library lies")
        return start + os.fsdecode(stored[_PREFIX:])

    def stored(self, path: str) -> bytes:
        """Return what a new row holds of an absolute path: the innermost library counts."""
        for folder, own in self._folders:
            if path.startswith(folder):
                return own + os.fsencode(path[len(folder) :])
        return os.fsencode(path)

    def all_stored(self, path: str) -> list[bytes]:
        """Return all that a row may hold of an absolute path: libraries may have come to lie inside of others."""
        below = [own + os.fsencode(path[len(folder) :]) for folder, own in self._folders if path.startswith(folder)]
        return [*below, os.fsencode(path)]

    def holds(self, folder: str) -> bool:
        """Return whether a folder is a library or lies in one."""
        return any(inside(folder).startswith(start) for start, _ in self._folders)

    def below(self, folder: str) -> dict[bytes, str]:
        """Return the libraries that are a folder or lie in it, and the rest of their names after it."""
        start = inside(folder)
        return {own: root[len(start) :] for root, own in self._folders if root.startswith(start)}

    def new(self, folder: str) -> bytes:
        """Return what paths of a library that is not known yet are to begin with.

        Two writers that meet the same library at once choose the same.
        """
        for attempt in range(len(self.locations) + 1):
            own = b"\0" + hashlib.sha256(os.fsencode(folder) + bytes([attempt % 256])).digest()[: _PREFIX - 1]
            if own not in self.locations:
                return own
        raise ShapeIndexError(f"{self._index}: the index is damaged: it knows too many libraries")


def library_of(stored: bytes) -> bytes | None:
    """Return what a row's path begins with; None for a file that was given by itself."""
    return stored[:_PREFIX] if stored.startswith(b"\0") else None
