"""Libraries and files that were moved: found out by what is gone here and the same there."""

from __future__ import annotations

import hashlib
import os
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import file_content, is_uri, list_objects
from fsh3d_o3d.index.extraction import FileState, has_buffers
from fsh3d_o3d.index.library_scan import ABSENT, missing_files
from fsh3d_o3d.index.roots import LibraryRoots, inside, library_of

_SAMPLE = 16  # files whose content is compared, a choice; the others are by name and size
_CONTENT = 32  # bytes of a SHA-256, with which an identity begins


@dataclass(frozen=True)
class ModelRows:
    """Some columns of the models of an index, in one order."""

    stored: Sequence[bytes]
    """What they hold of their paths."""
    states: Sequence[FileState]
    """Of their files, when they were described."""
    identities: Sequence[bytes]
    """Content, and how it is read."""


@value
class LibraryMove:
    """A library that lies elsewhere now."""

    old: str
    """Where it lay."""
    new: str
    """Where it lies."""


def moved_libraries(
    roots: LibraryRoots,
    rows: ModelRows,
    folder: str,
    states: Mapping[str, FileState | str],
    moved_from: Collection[str] = (),
) -> dict[bytes, LibraryMove]:
    """Return the libraries of an index that now lie in a folder.

    Those that were there where the caller says; and those that are gone, at least half of whose files are in the folder
    under the same names with the same size and, of a sample, the same content. What lay in such a library moves along.

    Args:
        roots: The libraries.
        rows: All models.
        folder: The folder, real.
        states: The files there are below it.
        moved_from: Names of one folder, all that was in which is to be looked for in ``folder``.
    """
    total = Counter(library_of(stored) for stored in rows.stored)
    alike: dict[bytes, list[_Namesake]] = defaultdict(list)
    start = inside(folder)
    for stored, before, content in zip(rows.stored, rows.states, rows.identities, strict=True):
        own = library_of(stored)
        if own is not None and roots.locations.get(own) != folder:
            path = start + os.fsdecode(stored[len(own) :])
            if has_buffers(path):  # its content is known only after it is parsed, which is not done in this process
                continue
            state = states.get(path)
            if isinstance(state, FileState) and state.size == before.size:
                alike[own].append(_Namesake(path, content[:_CONTENT], state == before))
    found: dict[bytes, LibraryMove] = {}
    for own, location in roots.locations.items():
        told = location in moved_from
        enough = 2 * len(alike[own]) >= total[own] > 0
        if told or (enough and _is_gone(location) and 2 * _unchanged_count(alike[own]) >= total[own]):
            found[own] = LibraryMove(location, folder)
    for old in [*moved_from, *(move.old for move in found.values())]:
        for own, rest in roots.below(old).items():
            location = roots.locations[own]
            if own not in found and (old in moved_from or _is_gone(location)):
                found[own] = LibraryMove(location, start + rest.rstrip("/"))
    return found


@dataclass(frozen=True)
class _Namesake:
    """A file that is called and as large as one that an index knows."""

    path: str
    content: bytes  # of the other, its SHA-256
    same_time: bool


def _unchanged_count(files: Sequence[_Namesake]) -> float:
    """Estimate, from a sample, how many files have the content they had.

    None, if one has another content though it tells the same time: then what is known of no file can be believed, and
    all are to be read.
    """
    chosen = files[:: max(1, len(files) // _SAMPLE)]
    same = [_content(one.path) == one.content for one in chosen]
    if any(one.same_time and not is_same for one, is_same in zip(chosen, same, strict=True)):
        return 0.0
    return len(files) * sum(same) / len(same)


def moved_rows(roots: LibraryRoots, rows: ModelRows, there: Collection[str]) -> list[bytes]:
    """Return what the rows hold of the paths of files that are gone while another file has their content.

    Of a library that is gone as a whole, perhaps only for now, these are given where they are at least half of it.

    Args:
        roots: The libraries.
        rows: All models.
        there: Files that are known to be there.
    """
    counts = Counter(rows.identities)
    shared = [(s, i, roots.path(s)) for s, i in zip(rows.stored, rows.identities, strict=True) if counts[i] > 1]
    elsewhere = [path for _, _, path in shared if path not in there]
    missing, unknown = _missing(elsewhere)
    alive = {identity for _, identity, path in shared if path not in missing and path not in unknown}
    gone: dict[bytes | None, list[bytes]] = defaultdict(list)
    for stored, identity, path in shared:
        if path in missing and identity in alive:
            gone[library_of(stored)].append(stored)
    total = Counter(map(library_of, rows.stored))
    return [
        stored
        for own, found in gone.items()
        if own is None or 2 * len(found) >= total[own] or not is_empty(roots.locations[own])
        for stored in found
    ]


def is_empty(folder: str) -> bool:
    """Return whether nothing can be seen in a folder, as where a disk is not mounted, or there is none."""
    try:
        if is_uri(folder):
            return not list_objects(folder, recursive=False)
        with os.scandir(folder) as entries:
            return next(entries, None) is None
    except OSError:
        return True


def _is_gone(folder: str) -> bool:
    """Whether a folder is certainly not there; a denied access or a storage that does not answer says nothing."""
    try:
        if is_uri(folder):
            return not list_objects(folder, recursive=True)
        os.stat(folder)  # noqa: PTH116 - any bytes
    except OSError as error:
        return error.errno in ABSENT
    return False


def _missing(paths: Sequence[str]) -> tuple[set[str], Collection[str]]:
    """As ``missing_files``, but of a storage that gives no answer nothing is known."""
    stored = [path for path in paths if is_uri(path)]
    missing, unknown = missing_files([path for path in paths if not is_uri(path)])
    try:
        return missing | missing_files(stored)[0], unknown
    except OSError:
        return missing, {*unknown, *stored}


def _content(path: str) -> bytes:
    try:
        return hashlib.sha256(file_content(path)).digest()
    except (OSError, GeometryError):
        return b""
