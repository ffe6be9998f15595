"""Checksums of all that a query returns: storage that flips a bit is found out, not believed.

A row has one over its columns. Numbers that many rows are compared by have one of their own in ``signature``, so that a
candidate costs no other column. What is not in rows, and yet decides what is found, has them too: the basis of
sketches, and of each version of a table the files that Lance keeps beside the data, which are in a small file of ours
(``checksums/models-12.json``): the manifest, the lists of deleted rows, the inverted file of the sketches. A version
without such a file, because its writer was killed in that moment or wrote to object storage, is read without them.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import uuid
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.index.columns import vectors
from fsh3d_o3d.index.errors import ShapeIndexError

CHECKSUM = "checksum"
"""The column that holds the others' checksum: four bytes of BLAKE2b."""
FOLDER = "checksums"
"""Where those of files are, beside the tables."""
_CHUNK = 2**20  # bytes of a file that are read at once: larger reads are no faster
_LATEST = 2**64 - 1  # Lance names manifests by what is left to this, so that a list begins with the newest


def row_checksums(table: Any) -> NDArray[np.uint32]:
    """Return the checksum (n,) of each row of an Arrow table, over all columns but its own."""
    pa = import_installed("pyarrow")

    fixed: list[NDArray[Any]] = [np.zeros((table.num_rows, 0), np.uint8)]
    varying: list[list[Any]] = []
    for name in sorted(set(table.column_names) - {CHECKSUM, "_rowid"}):
        column = table[name]
        if pa.types.is_fixed_size_list(column.type):
            fixed.append(vectors(column, column.type.value_type.to_pandas_dtype()))
        elif pa.types.is_integer(column.type) or pa.types.is_boolean(column.type):
            fixed.append(column.is_null().to_numpy()[:, None])
            fixed.append(column.cast(pa.int64()).fill_null(0).to_numpy()[:, None])
        else:
            varying.append(column.to_pylist())
    numbers = np.concatenate([_bytes(values) for values in fixed], axis=1)
    return np.array(
        [_digest(numbers[row].data, (values[row] for values in varying)) for row in range(table.num_rows)],
        dtype=np.uint32,
    )


def require_checksums(table: Any, where: str) -> None:
    """Check rows that were read with all their columns.

    Raises:
        ShapeIndexError: A row does not fit its checksum.
    """
    try:
        found = row_checksums(table)
        wrong = int(np.count_nonzero(found != table[CHECKSUM].to_numpy()))
    except (TypeError, ValueError) as error:  # of a number that is none any more, say
        raise ShapeIndexError(f"{where}: the index is damaged: its rows cannot be decoded ({error})") from None
    if wrong:
        raise ShapeIndexError(f"{where}: the index is damaged: {wrong} rows do not fit their checksums")


class FileChecksums:
    """Those of the files that Lance keeps of one index on a disk. Each file is read once: Lance never changes one."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._sound: set[str] = set()

    def newest(self, table: str) -> int | None:
        """Return the newest version of a table, by the names of its manifests; None if there is none."""
        return max(self._versions(table), default=None)

    def write(self, table: str, version: int) -> None:
        """Take down those of a version, right after it was made."""
        manifest = self._versions(table).get(version)
        if manifest is None:
            return
        files = {name: _crc(self._in(table, name)) for name in [manifest, *self._files_of_manifest(table, manifest)]}
        os.makedirs(self._in(FOLDER), exist_ok=True)  # noqa: PTH103 - keeps bytes that are not UTF-8
        text = json.dumps({"version": version, "files": files, "checksum": _of_text(version, files)})
        atomic_write_bytes(self._name(table, version), text.encode("ascii"))

    def require(self, table: str, version: int) -> None:
        """Check what a version of a table consists of beside its data.

        Raises:
            ShapeIndexError: A file is missing or does not fit its checksum.
        """
        try:
            with open(self._name(table, version), "rb") as file:  # noqa: PTH123
                text = file.read()
        except FileNotFoundError:
            return
        try:
            about = json.loads(text)
            files = dict(about["files"])
            sound = about["version"] == version and about["checksum"] == _of_text(version, files)
        except (ValueError, TypeError, LookupError, RecursionError):
            sound, files = False, {}
        if not sound:
            raise ShapeIndexError(f"{self._path}: the index is damaged: checksums of version {version} of its {table}")
        for name, expected in files.items():
            place = self._in(table, name)
            if place in self._sound:
                continue
            try:
                found = _crc(place)
            except FileNotFoundError:
                raise ShapeIndexError(f"{self._path}: the index is damaged: {name} of its {table} is missing") from None
            if found != expected:
                raise ShapeIndexError(
                    f"{self._path}: the index is damaged: {name} of its {table} does not fit its checksum"
                )
            self._sound.add(place)

    def tidy(self, table: str) -> None:
        """Remove those of versions that are gone."""
        there = self._versions(table)
        for name in _names(self._in(FOLDER)):
            kind, _, version = name.removesuffix(".json").rpartition("-")
            if kind == table and version.isdigit() and int(version) not in there:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(self._in(FOLDER, name))  # noqa: PTH108

    def _versions(self, table: str) -> dict[int, str]:
        """The versions there are, and the names of their manifests."""
        found = {}
        for name in _names(self._in(table, "_versions")):
            number = name.removesuffix(".manifest")
            if number != name and number.isdigit():
                version = int(number)
                found[_LATEST - version if version > _LATEST // 2 else version] = f"_versions/{name}"
        return found

    def _files_of_manifest(self, table: str, manifest: str) -> Iterator[str]:
        """Names of the files that a manifest speaks of, lists of deleted rows and inverted files.

        A manifest holds their random numbers, of eight and of sixteen bytes, as they are: one that holds them by
        chance is as good as impossible. Other files may be another writer's, not complete yet.
        """
        with open(self._in(table, manifest), "rb") as file:  # noqa: PTH123
            content = file.read()
        for name in _names(self._in(table, "_deletions")):
            number = name.partition(".")[0].rpartition("-")[2]
            if number.isdigit() and _varint(int(number)) in content:
                yield f"_deletions/{name}"
        for name in _names(self._in(table, "_indices")):
            with contextlib.suppress(ValueError):
                if uuid.UUID(name).bytes in content:
                    yield from (f"_indices/{name}/{part}" for part in _names(self._in(table, "_indices", name)))

    def _in(self, table: str, *parts: str) -> str:
        return os.path.join(self._path, table if table == FOLDER else f"{table}.lance", *parts)  # noqa: PTH118

    def _name(self, table: str, version: int) -> str:
        return self._in(FOLDER, f"{table}-{version}.json")


def _digest(numbers: Any, values: Iterator[Any]) -> int:
    # Not a CRC: a CRC of what ends in a CRC of its own, as signatures do, is the same for all of them.
    digest = hashlib.blake2b(numbers, digest_size=4)
    for value in values:
        data = b"" if value is None else value.encode() if isinstance(value, str) else value
        length = -1 if value is None else len(data)
        digest.update(length.to_bytes(8, "little", signed=True))
        digest.update(data)
    return int.from_bytes(digest.digest(), "little")


def _bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    rows = np.ascontiguousarray(values)
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)


def _crc(path: str) -> int:
    checksum = 0
    with open(path, "rb") as file:  # noqa: PTH123 - keeps bytes that are not UTF-8
        while chunk := file.read(_CHUNK):
            checksum = zlib.crc32(chunk, checksum)
    return checksum


def _of_text(version: int, files: dict[str, int]) -> int:
    return zlib.crc32(json.dumps([version, sorted(files.items())]).encode())


def _names(folder: str) -> list[str]:
    try:
        return sorted(os.listdir(folder))  # noqa: PTH208 - keeps bytes that are not UTF-8
    except FileNotFoundError:
        return []


def _varint(number: int) -> bytes:
    """A number as protocol buffers write it: seven bits a byte, lowest first."""
    parts = []
    while number > 127:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])
