"""Whole files or none, which also outlast a power failure.

A file is written under a temporary name, its bytes are asked onto the disk (``fsync``), it is given its name, and then
the folder that holds the name is asked onto the disk. So a reader sees the old content or the new, and so does whoever
starts the machine again after its power has failed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

# What file systems answer that cannot ask a folder onto the disk (some network and user-space ones).
_NOT_FOR_FOLDERS = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF, errno.EACCES, errno.EPERM, errno.EISDIR}


def atomic_write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write ``data`` to a new file beside ``path``, then give it the name: readers see the old content or the new.

    When this returns, the new content is on the disk. A link is followed, an existing file's permissions are kept, a
    new file's follow the umask.

    Raises:
        OSError: With ``path`` as its file name; the target is as it was and nothing else is left behind. Only where
            the disk fails when it is asked for the folder, the new content may be there.
    """
    given = os.fspath(path)
    try:
        with replacement(given) as file:
            file.write(data)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, given) from None


def sync_file(path: str | os.PathLike[str]) -> None:
    """Wait until what was written to a file is on the disk.

    Raises:
        OSError: There is no such file, or the disk reports an error.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path: str | os.PathLike[str]) -> None:
    """Wait until the names in a folder are on the disk, where its file system can be asked for that.

    Raises:
        OSError: There is no such folder, or the disk reports an error.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except PermissionError:  # a folder may be written and not listed
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NOT_FOR_FOLDERS:
            raise
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def replacement(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A block that writes a new file, which gets its name when the block is done; as ``atomic_write_bytes`` does.

    Raises:
        OSError: As there, with whatever file name it has.
    """
    target, mode = Path(os.path.realpath(path)), None
    with contextlib.suppress(FileNotFoundError):
        mode = target.stat().st_mode
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if mode is not None and not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "not a regular file, so it is not replaced")
    temporary = target.with_name(f".fsh3d-{secrets.token_hex(8)}{target.suffix[:16]}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        with open(descriptor, "wb") as file:  # noqa: PTH123 - a descriptor, not a path
            if mode is not None:
                os.fchmod(descriptor, stat.S_IMODE(mode) & 0o777)
            yield file
            file.flush()
            os.fsync(descriptor)
        temporary.replace(target)
    except BaseException:  # an interrupt too
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(target.parent)
