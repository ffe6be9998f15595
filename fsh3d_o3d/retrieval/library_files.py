"""The files of a library: a folder and all below it, and nothing outside of it (private)."""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Iterator

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
    root = os.path.abspath(os.fsdecode(folder))  # noqa: PTH100 - resolves no links, and keeps bytes that are not UTF-8
    if not os.path.isdir(root):  # noqa: PTH112 - same
        reason = errno.ENOTDIR if os.path.exists(root) else errno.ENOENT  # noqa: PTH110 - same
        raise OSError(reason, os.strerror(reason), root)
    os.scandir(root).close()  # raises where the folder cannot be listed at all
    excluded = None if leave_out is None else os.path.realpath(os.fsdecode(leave_out))
    for parent, folders, names in os.walk(root, onerror=_warn):
        folders[:] = sorted(name for name in folders if os.path.realpath(os.path.join(parent, name)) != excluded)  # noqa: PTH118
        for name in sorted(names):
            path = os.path.join(parent, name)  # noqa: PTH118 - same
            if os.path.splitext(name)[1].lower() in READABLE_FORMATS and not os.path.islink(path):  # noqa: PTH114, PTH122
                yield path


def _warn(error: OSError) -> None:
    warnings.warn(f"{error.filename}: {error.strerror}, so files in it are not found", stacklevel=2)
