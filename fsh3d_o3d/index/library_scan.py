"""The files of a library: a folder and all below it, and nothing outside of it.

A folder of a file system, or what begins with one name in object storage, like ``s3://bucket/parts``.
"""

from __future__ import annotations

import errno
import os
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from fsh3d_o3d._printable import printable
from fsh3d_o3d.files import absolute, format_of, is_readable, is_uri, list_objects, object_states, require_bucket
from fsh3d_o3d.jobs import FailedInput

ABSENT = (errno.ENOENT, errno.ENOTDIR)
"""What the system says of a name that leads to nothing. All else, a denied access or a dead disk, is no absence."""
_LONGEST_EXTENSION = 12  # characters; what is longer is a part of a name with a full stop in it


@dataclass
class LibraryScan:
    """What is below a folder."""

    files: list[str] = field(default_factory=list)
    """Absolute paths of the readable formats, in order of their names."""
    other_formats: Counter[str] = field(default_factory=Counter)
    """How many files of other formats there are, by extension in small letters; hidden ones do not count."""
    links: int = 0
    """Symbolic links to folders, and to files of readable formats; they are not followed."""
    not_listed: list[FailedInput] = field(default_factory=list)
    """Folders that could not be listed, so that nothing is known of what is in them."""


def scan_library(folder: str | os.PathLike[str], *, leave_out: str | os.PathLike[str] | None = None) -> LibraryScan:
    """Return what is below a folder.

    Symbolic links below the folder are not followed: what they point to is in the library anyway, or outside of it.
    Names may hold any byte; those that are not UTF-8 come as surrogates (``os.fsdecode``).

    Args:
        folder: Where to look; may itself be a link.
        leave_out: A folder that is not entered, such as the index.

    Raises:
        OSError: The folder does not exist, is none or cannot be listed.
    """
    root = absolute(folder)
    if is_uri(root):
        return _stored(root, None if leave_out is None else absolute(leave_out))
    os.scandir(root).close()  # raises where there is no folder, or one that cannot be listed
    excluded = None if leave_out is None else os.path.realpath(os.fsdecode(leave_out))
    found = LibraryScan()

    def not_listed(error: OSError) -> None:
        found.not_listed.append(
            FailedInput(os.fsdecode(error.filename), f"{error.strerror}, so its files are not found")
        )

    for parent, folders, names in os.walk(root, onerror=not_listed):
        folders[:] = sorted(name for name in folders if os.path.realpath(os.path.join(parent, name)) != excluded)  # noqa: PTH118
        found.links += sum(os.path.islink(os.path.join(parent, name)) for name in folders)  # noqa: PTH114, PTH118
        for name in sorted(names):
            path = os.path.join(parent, name)  # noqa: PTH118 - keeps bytes that are not UTF-8
            if not is_readable(name):
                found.other_formats.update(_other_format(path[len(root) :]))
            elif os.path.islink(path):  # noqa: PTH114 - same
                found.links += 1
            else:
                found.files.append(path)
    return found


def library_files(folder: str | os.PathLike[str], *, leave_out: str | os.PathLike[str] | None = None) -> Iterator[str]:
    """Yield the files that ``scan_library`` finds; folders that cannot be listed are warned of."""
    found = scan_library(folder, leave_out=leave_out)
    for one in found.not_listed:
        warnings.warn(printable(f"{one.path}: {one.reason}"), stacklevel=2)
    yield from found.files


def is_folder(path: str) -> bool:
    """Return whether ``library_files`` can be asked for a path; in storage, where there are no folders, by its name."""
    return not is_readable(path) if is_uri(path) else os.path.isdir(path)  # noqa: PTH112 - keeps any bytes


def require_place(folder: str) -> None:
    """Find out whether a folder, or the bucket of one, is there.

    Raises:
        OSError: It is not.
    """
    if is_uri(folder):
        require_bucket(folder)
    else:
        os.scandir(folder).close()


def missing_files(paths: Sequence[str]) -> tuple[set[str], dict[str, str]]:
    """Return the paths that lead to nothing, and those of which that cannot be told, with the reasons.

    A link that leads to nothing is something.

    Raises:
        OSError: A storage does not answer, refuses, or has no such bucket.
    """
    stored = object_states(path for path in paths if is_uri(path))
    missing = {path for path in paths if is_uri(path) and path not in stored}
    unknown = {}
    for path in paths:
        if is_uri(path):
            continue
        try:
            os.lstat(path)
        except OSError as error:
            if error.errno in ABSENT:
                missing.add(path)
            else:
                unknown[path] = error.strerror or str(error)
    return missing, unknown


def _stored(root: str, excluded: str | None) -> LibraryScan:
    listed = sorted(one.uri for one in list_objects(root, recursive=True))
    if not listed:
        raise FileNotFoundError(errno.ENOENT, "No files below this name", root)
    found = LibraryScan()
    for uri in listed:
        if excluded is not None and uri.startswith(f"{excluded}/"):
            continue
        if is_readable(uri):
            found.files.append(uri)
        else:
            found.other_formats.update(_other_format(uri[len(root) :]))
    return found


def _other_format(below: str) -> list[str]:
    """The extension by which a file is counted, unless it or a folder on the way to it is hidden."""
    if any(part.startswith(".") for part in below.split("/")):
        return []
    extension = format_of(below)
    return [extension if len(extension) <= _LONGEST_EXTENSION else ""]
