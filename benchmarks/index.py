"""Search in an index: recall against comparing everything, time of a query, bytes a row, loss by compact storage.

Rows are mixtures of the signatures of real shapes with noise on top: as near to each other as shapes of one class
are. With the Princeton benchmark's models beside the project (``../data/psb_train``) they are mixed from these, else
from the samples.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import fsh3d_o3d as fsh
from benchmarks._measure import interleave
from benchmarks._table import Check, Column, Row, Table
from fsh3d_o3d.descriptors import ShapeSignature, SHDOption, descriptor_distances, signature_distances
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.index import (
    EXACT_BELOW,
    Described,
    FileState,
    IndexSearch,
    IndexStore,
    Query,
    decoded,
    describe,
    encoded,
    library_files,
    model_columns,
)

ROOT = Path(__file__).parents[1]
SIZES = (907, 10_000, 100_000)
"""Rows; ``python -m benchmarks.index ROWS`` takes others."""
_OPTION = SHDOption.best()
_BATCH = 2000
_TOP = 10
_PARTS = 25  # of a batch: one and its differences fit the cache
_NOISE = 0.3  # of each number's spread over the shapes
_SHARE = 0.4  # of the second shape in a mixture, at most


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of index sizes."""
    bases = _bases(12 if quick else 300)
    rows = [_case(bases, count, queries=5 if quick else 50) for count in ((300, 6000) if quick else SIZES)]
    loss = _loss(bases)
    yield Table(
        "index",
        f"Search in an index of mixtures of {len(bases)} shapes; exact below {EXACT_BELOW:,} rows",
        (
            Column("rows", "rows", ",d"),
            Column("write", "write s", ".1f"),
            Column("index", "index s", ".1f"),
            Column("bytes", "KB a row", ".2f", 1e-3),
            Column("recall", "recall@10", ".4f"),
            Column("query", "query ms", ".1f", 1e3),
            Column("rerank", "align 200 ms", ".1f", 1e3),
        ),
        tuple(rows),
        notes=(
            f"Distances of stored features differ from those computed by {100 * loss:.3f} % (median over pairs).",
            "A query is the search alone: the descriptor is not computed again. Files are in the page cache.",
        ),
    )


def _case(bases: list[ShapeSignature], count: int, queries: int) -> Row:
    random = np.random.default_rng(count)
    with tempfile.TemporaryDirectory() as folder:
        store = IndexStore.open(os.path.join(folder, "index"), _OPTION)  # noqa: PTH118 - text, as it is stored
        probes = [Query.of(signature, store.basis) for signature in _mixtures(bases, queries, random)]
        nearest = np.full((queries, _TOP), np.inf)
        written = 0.0
        for start in range(0, count, _BATCH):
            mixed = _mixtures(bases, min(_BATCH, count - start), random)
            found = [Described(FileState(0, 0), bytes(32), signature) for signature in mixed]
            names = [f"/library/model-{start + k}.off" for k in range(len(found))]
            begin = time.perf_counter()
            store.put(store.models, model_columns(names, found, _OPTION, store.basis))
            written += time.perf_counter() - begin
            # The truth is found on the way: all rows at once would not fit into memory.
            stored = decoded(*encoded(np.stack([signature.feature for signature in mixed])))
            for row, probe in zip(nearest, probes, strict=True):
                apart = np.concatenate(
                    [np.abs(part - probe.feature).sum(axis=1) for part in np.array_split(stored, _PARTS)]
                )
                row[:] = np.sort(np.concatenate((row, apart)))[:_TOP]
        search = IndexSearch(store, _OPTION)
        begin = time.perf_counter()
        search.index(moved=store.tidy())
        indexed = time.perf_counter() - begin
        # For an hour after rows were put together it is up to twice that: see docs/library.md.
        size = (store.models.stats()["total_bytes"] + store.basis.nbytes) / count
        answers = np.stack([search.nearest(store.latest(), probe, _TOP).distances for probe in probes])
        recall = np.mean(answers <= nearest[:, -1:] * (1 + 1e-6))
        turn = iter(range(10**9))
        candidates = search.nearest(store.latest(), probes[0], 200)
        timing = interleave(
            {
                "query": lambda: search.nearest(store.latest(), probes[next(turn) % queries], _TOP),
                "rerank": lambda: signature_distances(probes[0].coefficients, candidates.stored.coefficients),
            },
            rounds=21,
            budget=10.0,
        )
    checks = (
        Check("recall@10", float(recall), ">=", 0.99),
        Check("KB", size / 1000, "<=", 12.0),
        Check("query ms", 1e3 * timing["query"].median, "<=", 10.0),
        Check("align ms", 1e3 * timing["rerank"].median, "<=", 30.0),
    )
    cells = {"rows": count, "write": written, "index": indexed, "bytes": size, "recall": float(recall), **timing}
    return Row(cells, checks)


def _bases(most: int) -> list[ShapeSignature]:
    """Signatures of real shapes."""
    library = ROOT.parent / "data" / "psb_train" / "models"
    files = list(library_files(library if library.is_dir() else ROOT / "samples"))
    found = []
    for path in files[:: max(1, len(files) // most)]:
        try:
            found.append(describe(read_geometry_arrays(path), _OPTION))
        except fsh.GeometryError:  # noqa: PERF203 - the samples hold broken files, too
            continue
    return found[:most]


def _mixtures(bases: list[ShapeSignature], count: int, random: np.random.Generator) -> list[ShapeSignature]:
    features = np.stack([base.feature for base in bases])
    roots = np.copysign(np.sqrt(np.abs(features)), features)
    one, other = random.integers(len(bases), size=(2, count))
    share = _SHARE * random.random((count, 1), dtype=np.float32)
    mixed = (1 - share) * roots[one] + share * roots[other]
    mixed += _NOISE * roots.std(axis=0) * random.standard_normal(mixed.shape, dtype=np.float32)
    values = mixed * np.abs(mixed)
    values /= np.abs(values).sum(axis=1, keepdims=True)
    return [
        ShapeSignature(value, bases[k].coefficients, bases[k].centroid, bases[k].rms_radius, bases[k].axes)
        for value, k in zip(values, one, strict=True)
    ]


def _loss(bases: list[ShapeSignature]) -> float:
    features = np.stack([base.feature for base in bases])
    stored = decoded(*encoded(features))
    pairs = np.triu_indices(len(bases), 1)
    before, after = (descriptor_distances(rows, rows, _OPTION)[pairs] for rows in (features, stored))
    different = before > 0  # the library holds copies
    return float(np.median(np.abs(after[different] / before[different] - 1)))


if __name__ == "__main__":
    SIZES = tuple(map(int, sys.argv[1:])) or SIZES
    for result in run():
        print(result.text())
