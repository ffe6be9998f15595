"""What Lance has written, asked onto the disk: it renames files into place, but waits for none of them."""

from __future__ import annotations

import contextlib
import os

from fsh3d_o3d._atomic import sync_file, sync_folder

_MANIFESTS = "_versions"  # a manifest is worth nothing without what it speaks of


class DiskSync:
    """Remembers, for one index on a disk, which files are on it already: Lance changes none that it has written."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._done: set[str] = set()

    def table(self, name: str) -> None:
        """Wait until all files of a table are on the disk, and their names.

        Raises:
            OSError: The disk reports an error.
        """
        top = os.path.join(self._path, f"{name}.lance")  # noqa: PTH118 - keeps bytes that are not UTF-8
        folders = [(folder, files) for folder, _, files in os.walk(top)]
        folders.sort(key=lambda one: os.path.basename(one[0]) == _MANIFESTS)  # noqa: PTH119
        for folder, files in folders:
            new = {os.path.join(folder, file) for file in files} - self._done  # noqa: PTH118
            for file in sorted(new):
                with contextlib.suppress(FileNotFoundError):  # removed by another process that has tidied up
                    sync_file(file)
            if new or folder not in self._done:
                with contextlib.suppress(FileNotFoundError):
                    sync_folder(folder)
            # A hint is no new file each time: Lance writes it anew.
            self._done |= {file for file in new if not file.endswith(".json")} | {folder}
        for folder in (top, self._path, os.path.dirname(self._path)):  # noqa: PTH120
            if (place := f"name {folder}") not in self._done:
                sync_folder(folder)
                self._done.add(place)
