"""Regular files and nothing else: a pipe would be waited for, a device may be endless."""

from __future__ import annotations

import errno
import os
import stat
from typing import BinaryIO


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file, or a link to one, for reading its bytes.

    Raises:
        OSError: There is none, it cannot be read, or it is something else.
    """
    _require_regular(os.stat(path), path)  # noqa: PTH116 - some devices do something when they are opened
    # O_NONBLOCK: it may have become a pipe since. It changes nothing for regular files.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _require_regular(os.fstat(descriptor), path)
        return open(descriptor, "rb")  # noqa: PTH123 - a descriptor, not a path
    except BaseException:
        os.close(descriptor)
        raise


def _require_regular(about: os.stat_result, path: str | os.PathLike[str]) -> None:
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, "is not a regular file but a folder", os.fspath(path))
    if not stat.S_ISREG(about.st_mode):
        raise OSError(errno.EINVAL, "is not a regular file", os.fspath(path))
