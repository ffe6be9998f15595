"""A library that changes as people change theirs: files and folders renamed, moved, swapped, copied and replaced."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from fsh3d_o3d.index import library_files

_SPARE = 10  # one of so many files is kept back, to replace others
_FOLDERS = 4  # at least, below the library
_AT_ONCE = 4  # changes, at most

Identity = tuple[str, str]
"""What tells whether a file can be described: SHA-256 of its content, and the extension that it is read by."""


class ChangingLibrary:
    """A copy of a library, some of its files kept back."""

    def __init__(self, source: str, folder: Path, draw: random.Random) -> None:
        self._folder = Path(os.path.realpath(folder))
        self._draw = draw
        self._made = 0
        for number, path in enumerate(sorted(library_files(source))):
            # Copied without its times: no two files can be taken for each other by size and time.
            target = self._folder / f"part{number % _FOLDERS}" / f"{number}-{Path(path).name}"
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        self._spare: list[Path] = []

    @property
    def path(self) -> str:
        """Its folder."""
        return os.fspath(self._folder)

    def keep_back(self, elsewhere: Path) -> None:
        """Take some files out, with which others are replaced later."""
        elsewhere.mkdir()
        files = self.files()
        for file in self._draw.sample(files, len(files) // _SPARE):
            self._spare.append(file.rename(elsewhere / file.name))

    def files(self) -> list[Path]:
        """Return all files, in an order that depends on nothing but their names."""
        return sorted(Path(path) for path in library_files(self.path))

    def identities(self) -> dict[str, Identity]:
        """Return what each file holds, by its path."""
        return {os.fspath(path): identity_of(path) for path in self.files()}

    def change(self) -> list[str]:
        """Make some changes; returns their names."""
        changes: Mapping[str, Callable[[], None]] = {
            "a file renamed": self._rename_file,
            "a file moved": self._move_file,
            "two files swapped": self._swap_files,
            "a file replaced": self._replace_file,
            "a file copied": self._copy_file,
            "a folder renamed": self._rename_folder,
            "a folder moved": self._move_folder,
            "two folders swapped": self._swap_folders,
        }
        names = self._draw.choices(sorted(changes), k=self._draw.randint(1, _AT_ONCE))
        for name in names:
            changes[name]()
        return names

    def _file(self) -> Path:
        return self._draw.choice(self.files())

    def _folders(self) -> list[Path]:
        return sorted(path for path in self._folder.rglob("*") if path.is_dir())

    def _new_name(self, suffix: str = "") -> str:
        self._made += 1
        return f"new{self._made}{suffix}"

    def _rename_file(self) -> None:
        file = self._file()
        file.rename(file.with_name(self._new_name(file.suffix)))

    def _move_file(self) -> None:
        file = self._file()
        file.rename(self._draw.choice(self._folders()) / self._new_name(file.suffix))

    def _swap_files(self) -> None:
        one = self._file()
        other = self._draw.choice([file for file in self.files() if file.suffix == one.suffix])
        _swap(one, other)

    def _replace_file(self) -> None:
        file = self._file()
        others = [path for path in self._spare or self.files() if path.suffix == file.suffix and path != file]
        if others:
            shutil.copyfile(self._draw.choice(others), file)

    def _copy_file(self) -> None:
        file = self._file()
        shutil.copyfile(file, self._draw.choice(self._folders()) / self._new_name(file.suffix))

    def _rename_folder(self) -> None:
        folder = self._draw.choice(self._folders())
        folder.rename(folder.with_name(self._new_name()))

    def _move_folder(self) -> None:
        folder = self._draw.choice(self._folders())
        into = [other for other in [self._folder, *self._folders()] if folder not in (other, *other.parents)]
        folder.rename(self._draw.choice(into) / self._new_name())

    def _swap_folders(self) -> None:
        one = self._draw.choice(self._folders())
        apart = [other for other in self._folders() if one not in (other, *other.parents) and other not in one.parents]
        if apart:
            _swap(one, self._draw.choice(apart))


def identity_of(path: Path) -> Identity:
    """Return what a file holds, and how it is read."""
    return hashlib.sha256(path.read_bytes()).hexdigest(), path.suffix.lower()


def _swap(one: Path, other: Path) -> None:
    if one == other:
        return
    between = one.with_name(f"between{one.suffix}")
    one.rename(between)
    other.rename(one)
    between.rename(other)
