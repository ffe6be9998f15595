"""Models out of an index: those whose files are gone, and those that are named."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping

from fsh3d_o3d.files import absolute
from fsh3d_o3d.index.library_scan import ABSENT, missing_files, require_place
from fsh3d_o3d.index.moves import is_empty
from fsh3d_o3d.index.roots import inside, library_of, real_file, real_folder
from fsh3d_o3d.index.store import IndexStore
from fsh3d_o3d.jobs import FailedInput


def prune(store: IndexStore, folder: str | os.PathLike[str] | None, on_kept: Callable[[FailedInput], None]) -> int:
    """Remove models, and failures, whose files are gone; see ``ShapeIndex.prune``."""
    store.refresh()
    roots = store.roots()
    start = ""
    if folder is not None:
        place = real_folder(folder)
        try:
            require_place(place)
        except OSError as error:
            if error.errno not in ABSENT or place not in roots.locations.values():
                raise
        start = inside(place)
    removed = 0
    for table in (store.models, store.failures):
        kept = []
        by_library: dict[bytes | None, dict[str, bytes]] = defaultdict(dict)
        rows = store.columns(table, ["path"])["path"].to_pylist()
        roots = store.roots()  # after them, as another writer may have put in both
        for stored in rows:
            path = roots.path(stored)
            if path.startswith(start):
                by_library[library_of(stored)][path] = stored
        gone: list[bytes] = []
        for own, paths in by_library.items():
            missing, unknown = missing_files(list(paths))
            if own is not None and missing and not start and is_empty(roots.locations[own]):
                reason = f"nothing is there, so its {len(paths)} models are kept"
                kept.append(FailedInput(roots.locations[own], reason))
                continue
            gone += [paths[path] for path in missing]
            kept += _by_folder(unknown)
        if gone:
            store.remove(table, sorted(gone))
        if table is store.models:
            removed = len(gone)
            for one in kept:
                on_kept(one)
    return removed


def remove(store: IndexStore, paths: Iterable[str | os.PathLike[str]]) -> int:
    """Remove models, and failures, of these files, and of all files below these folders; return how many models."""
    store.refresh()
    names = {name for path in paths for name in (absolute(path), real_file(path), real_folder(path))}
    starts = tuple(map(inside, names))
    removed = 0
    for table in (store.models, store.failures):
        found = store.columns(table, ["path"])["path"].to_pylist()
        roots = store.roots()  # after them, as another writer may have put in both
        chosen = [one for one in found if (path := roots.path(one)) in names or path.startswith(starts)]
        if chosen:
            store.remove(table, sorted(chosen))
        removed += len(chosen) if table is store.models else 0
    return removed


def _by_folder(unknown: Mapping[str, str]) -> list[FailedInput]:
    """One for each folder with files of which it is not known whether they are there, and reason for that."""
    counts = Counter((os.path.dirname(path), reason) for path, reason in unknown.items())  # noqa: PTH120 - any bytes
    return [FailedInput(folder, f"{reason}, so {n} models in it are kept") for (folder, reason), n in counts.items()]
