"""What an index is: its models, how many of which libraries, and what it takes."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator

from fsh3d_o3d.files import is_uri, list_objects
from fsh3d_o3d.index.errors import translated
from fsh3d_o3d.index.results import IndexedModel, IndexSummary
from fsh3d_o3d.index.roots import library_of
from fsh3d_o3d.index.store import FORMAT, IndexStore


def indexed_models(store: IndexStore) -> Iterator[IndexedModel]:
    """Yield what is known of each model, in the order of their paths."""
    names = ["path", "size", "mtime", "vertices", "triangles", "watertight"]
    columns = store.reading(lambda models: models.columns(names)).to_pydict()
    roots = store.roots()
    paths = [roots.path(stored) for stored in columns["path"]]
    for row in sorted(range(len(paths)), key=paths.__getitem__):
        yield IndexedModel(paths[row], *(columns[name][row] for name in names[1:]))


def summary(store: IndexStore) -> IndexSummary:
    """Return what an index is."""
    models = store.latest()
    counts = Counter(map(library_of, models.columns(["path"])["path"].to_pylist()))
    libraries: Counter[str] = Counter()
    for own, folder in store.roots().locations.items():
        if counts[own]:  # what libraries once were costs nothing, and is no news
            libraries[folder] += counts[own]
    searchable = 0
    with translated(store.path, "reading it"):
        if any(index.columns == ["sketch"] for index in models.table.list_indices()):
            about = models.table.index_stats("sketch_idx")
            searchable = 0 if about is None else int(about.num_indexed_rows)
    return IndexSummary(
        format=FORMAT,
        models=models.count,
        failures=store.latest("failures").count,
        libraries=dict(sorted(libraries.items())),
        single_files=counts[None],
        searchable=searchable,
        bytes_on_disk=_bytes(store.path),
    )


def _bytes(path: str) -> int:
    if is_uri(path):
        return sum(one.size for one in list_objects(path, recursive=True))
    total = 0
    for folder, _, names in os.walk(path):
        for name in names:
            try:
                total += os.lstat(os.path.join(folder, name)).st_size  # noqa: PTH118 - keeps bytes that are not UTF-8
            except FileNotFoundError:  # noqa: PERF203 - another writer has tidied up
                continue
    return total
