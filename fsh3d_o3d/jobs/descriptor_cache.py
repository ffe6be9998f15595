"""Descriptors kept by the content of their files, so that a second run over a library is quick.

One SQLite file in the user's cache folder (``FSH3D_CACHE_DIR`` moves it) serves any number of processes at once. Every
entry carries a checksum; one that does not match is computed again. A cache that cannot be opened, read or written is
no error: descriptors are then computed each time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import sqlite3
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._cache_folder import cache_folder
from fsh3d_o3d._regular_file import open_regular
from fsh3d_o3d._value import value
from fsh3d_o3d._version import __version__
from fsh3d_o3d.files import format_of

__all__ = ["clear_descriptor_cache", "descriptor_cache_path"]

_FORMAT = 1  # of the table; raised, and with it the file's name, when older code could not read it
_TABLE = "CREATE TABLE IF NOT EXISTS descriptors (key BLOB PRIMARY KEY, seconds REAL, value BLOB, digest BLOB)"
_KEYS_A_QUERY = 500  # SQLite before 3.32 takes 999 parameters at most
_ENTRIES_A_TRANSACTION = 64  # lost at most if the process is killed: a second or two of work; a choice
_LOCK_TIMEOUT = 30.0  # seconds to wait for another process's transaction
_CHUNK = 2**20  # bytes of a file that are hashed at once: larger reads are no faster
_WITHOUT_INFLUENCE = {"cli", "report", "index", "evaluation", "jobs"}  # folders that only handle descriptors

_log = logging.getLogger("fsh3d_o3d")


def descriptor_cache_path() -> Path:
    """Return the file where descriptors are kept; it need not exist."""
    return cache_folder() / "descriptors" / f"v{_FORMAT}.sqlite"


def clear_descriptor_cache() -> int:
    """Remove the cached descriptors; returns the number of files.

    Example:
        >>> removed = fsh.clear_descriptor_cache()
        >>> fsh.clear_descriptor_cache()  # nothing is left
        0
    """
    removed = 0
    for path in descriptor_cache_path().parent.glob("*.sqlite*"):
        with contextlib.suppress(OSError):
            path.unlink()
            removed += 1
    return removed


@value
class CachedDescriptor:
    """A descriptor and what it cost."""

    values: NDArray[np.float32]
    """(d,) values."""
    seconds: float
    """CPU time that reading and describing took."""


def descriptor_key(path: str | os.PathLike[str], fingerprint: str) -> bytes | None:
    """A key made of a file's content and format, the descriptor's options and this package's code.

    None for what is no readable regular file.
    """
    digest = hashlib.sha256()
    try:
        with open_regular(path) as file:
            while chunk := file.read(_CHUNK):
                digest.update(chunk)
    except OSError:
        return None
    return key_of(digest.digest(), os.fsencode(format_of(os.fsdecode(path))), fingerprint.encode())


def key_of(*parts: bytes) -> bytes:
    """A key made of what a value depends on, and of this package's code."""
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in (*parts, _code_digest()))).digest()


@functools.cache
def _code_digest() -> bytes:
    """A digest of the code that may influence a descriptor: another version must not answer for this one."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] not in _WITHOUT_INFLUENCE:
            digest.update(path.read_bytes())
    return digest.digest()


class DescriptorCache:
    """The cache, opened by one process; used by one thread, in a ``with`` block that keeps what was put into it."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path or descriptor_cache_path()
        self._connection: sqlite3.Connection | None = None
        self._pending: list[tuple[bytes, float, bytes, bytes]] = []
        with self._tolerant():
            self._open()

    def __enter__(self) -> DescriptorCache:
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def find(self, keys: Iterable[bytes]) -> dict[bytes, CachedDescriptor]:
        """The descriptors under those of the keys that are there, and whole."""
        wanted = list(keys)
        found: dict[bytes, CachedDescriptor] = {}
        for start in range(0, len(wanted), _KEYS_A_QUERY):
            part = wanted[start : start + _KEYS_A_QUERY]
            for key, seconds, stored, digest in self._select(part):
                entry = _decoded(key, seconds, stored, digest)
                if entry is None:
                    _log.warning("ignoring a damaged entry in %s", self._path)
                else:
                    found[key] = entry
        return found

    def keep(self, key: bytes, entry: CachedDescriptor) -> None:
        """Put a descriptor under a key, in place of what may be there."""
        value = np.ascontiguousarray(entry.values, dtype="<f4").tobytes()
        self._pending.append((key, entry.seconds, value, _digest(key, entry.seconds, value)))
        if len(self._pending) >= _ENTRIES_A_TRANSACTION:
            self._flush()

    def _open(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._connection = sqlite3.connect(self._path, timeout=_LOCK_TIMEOUT)
        # Not waiting for the disk: what a power failure damages is found by its checksum, and computed again.
        self._connection.execute("PRAGMA synchronous = OFF")
        with self._connection:
            self._connection.execute(_TABLE)

    def _select(self, keys: Sequence[bytes]) -> list[Any]:
        with self._tolerant():
            if self._connection is not None:
                marks = ",".join("?" * len(keys))
                query = f"SELECT key, seconds, value, digest FROM descriptors WHERE key IN ({marks})"
                return self._connection.execute(query, keys).fetchall()
        return []

    def _flush(self) -> None:
        rows, self._pending = self._pending, []
        with self._tolerant():
            if self._connection is not None and rows:
                with self._connection:
                    self._connection.executemany("INSERT OR REPLACE INTO descriptors VALUES (?, ?, ?, ?)", rows)

    @contextlib.contextmanager
    def _tolerant(self) -> Iterator[None]:
        """A block that may fail: a file that is no database is started anew, what else fails switches the cache off."""
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            if self._connection is not None:
                self._connection.close()
                self._connection = None
            if isinstance(error, (sqlite3.OperationalError, OSError)):
                _log.debug("descriptors not cached in %s: %s", self._path, error)
                return
            _log.warning("starting the damaged cache file %s anew: %s", self._path, error)
            with contextlib.suppress(sqlite3.Error, OSError):
                # Another process may have it open; that one goes on with a file that has no name any more.
                self._path.unlink(missing_ok=True)
                Path(f"{self._path}-journal").unlink(missing_ok=True)
                self._open()


def _decoded(key: Any, seconds: Any, value: Any, digest: Any) -> CachedDescriptor | None:
    if not (isinstance(value, bytes) and isinstance(seconds, float) and digest == _digest(key, seconds, value)):
        return None
    return CachedDescriptor(cast(NDArray[np.float32], np.frombuffer(value, dtype="<f4")), seconds)


def _digest(key: bytes, seconds: float, value: bytes) -> bytes:
    return hashlib.sha256(key + struct.pack("<d", seconds) + value).digest()
