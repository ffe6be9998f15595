"""The files of a library: a folder and all below it, and nothing outside of it (private).

A folder of a file system, or what begins with one name in object storage, like ``s3://bucket/parts``.
"""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Iterator, Sequence

from fsh3d_o3d.adapters._object_storage import absolute, is_uri, list_objects, object_states, require_bucket
from fsh3d_o3d.adapters.reading import READABLE_FORMATS


def library_files(folder: str | os.PathLike[str], *, leave_out: str | os.PathLike[str] | None = None) -> Iterator[str]:
    """Yield the absolute paths of all readable formats below a folder, in order of their names.

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
        yield from _stored_files(root, None if leave_out is None else absolute(leave_out))
        return
    if not os.path.isdir(root):  # noqa: PTH112 - keeps bytes that are not UTF-8
        reason = errno.ENOTDIR if os.path.exists(root) else errno.ENOENT  # noqa: PTH110 - same
        raise OSError(reason, os.strerror(reason), root)
    os.scandir(root).close()  # raises where the folder cannot be listed at all
    excluded = None if leave_out is None else os.path.realpath(os.fsdecode(leave_out))
    for parent, folders, names in os.walk(root, onerror=_warn):
        folders[:] = sorted(name for name in folders if os.path.realpath(os.path.join(parent, name)) != excluded)  # noqa: PTH118
        for name in sorted(names):
            path = os.path.join(parent, name)  # noqa: PTH118 - same
            if _readable(name) and not os.path.islink(path):  # noqa: PTH114
                yield path


def is_folder(path: str) -> bool:
    """Return whether ``library_files`` can be asked for a path; in storage, where there are no folders, by its name."""
    return not _readable(path) if is_uri(path) else os.path.isdir(path)  # noqa: PTH112 - keeps any bytes


def require_place(folder: str) -> None:
    """Find out whether a folder, or the bucket of one, is there.

    Raises:
        OSError: It is not.
    """
    if is_uri(folder):
        require_bucket(folder)
    else:
        os.scandir(folder).close()


def missing_files(paths: Sequence[str]) -> list[str]:
    """Return the paths that lead to nothing; a link that does is something.

    Raises:
        OSError: A storage does not answer, refuses, or has no such bucket.
    """
    stored = object_states(path for path in paths if is_uri(path))
    return [path for path in paths if not (path in stored if is_uri(path) else os.path.lexists(path))]


def _stored_files(root: str, excluded: str | None) -> Iterator[str]:
    found = [one.uri for one in list_objects(root, recursive=True)]
    if not found:
        raise FileNotFoundError(errno.ENOENT, "No files below this name", root)
    for uri in sorted(found):
        if _readable(uri) and not (excluded is not None and uri.startswith(f"{excluded}/")):
            yield uri


def _readable(name: str) -> bool:
    return os.path.splitext(name)[1].lower() in READABLE_FORMATS  # noqa: PTH122 - same


def _warn(error: OSError) -> None:
    warnings.warn(f"{error.filename}: {error.strerror}, so files in it are not found", stacklevel=2)
