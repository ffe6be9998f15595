"""Which rows of an index are nearest to a query: all of them compared, or those an inverted file leads to."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.index.codec import shortened, signed_roots
from fsh3d_o3d.index.columns import identifiers
from fsh3d_o3d.index.errors import translated
from fsh3d_o3d.index.rows import Query, StoredRows, stored_rows
from fsh3d_o3d.index.store import IndexStore
from fsh3d_o3d.index.version import TableVersion

EXACT_BELOW = 5_000
"""Rows below which a query is compared with all of them; see ``docs/library.md``."""
_ROWS_A_PARTITION = 400  # of the inverted file: the 16 that are looked into hold about as many as are compared exactly
_PROBES = 16  # partitions that are looked into at least, or √ of their number
_CANDIDATES_A_HIT = 2  # candidates by sketches for each row that is wanted, at least
_LEAST_CANDIDATES = 256  # the first 160 by sketches hold 99.9 % of the ten nearest of 907 models
_CANDIDATES_A_ROOT = 0.8  # times √(rows): where there are more rows, more of them are alike
_STALE_SHARE = 0.05  # of the rows, new since the inverted file was made, are too many
_BLOCK = 512  # rows compared at once: 7 MB of features, so that a block and its differences fit the cache
_ROWS_DECODED = 64  # rows decoded at once, as many as `codec` decodes
_PAIRS_A_BLOCK = 2**24  # compared by their sketches at once: 64 MB a table of distances
_ROUNDING = 1.001  # of a bound, for what sums in float32 are off; a pair too many costs an exact comparison
_NUMBERS_A_SUM = 10  # of a feature: |Σa − Σb| ≤ Σ|a − b| excludes pairs at a tenth of the cost


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rows near a query, nearest first."""

    rows: IntArray
    """(n,) ``_rowid``."""
    distances: Float64Array
    """(n,) of the features, in the option's metric."""
    stored: StoredRows
    """(n)."""


@dataclass(frozen=True, eq=False)
class _Everything:
    """All rows of one version, where they are few enough to compare all."""

    version: TableVersion
    rows: IntArray
    stored: StoredRows
    features: NDArray[np.float32]


class IndexSearch:
    """Search in one store, in the version that each call is given. Any number of threads may share it."""

    def __init__(self, store: IndexStore, option: SHDOption, *, exact_below: int = EXACT_BELOW) -> None:
        self._store = store
        self._l1 = option.metric == "l1"
        self._option = option
        self._exact_below = exact_below
        self._lock = threading.Lock()  # so that threads that ask at once do not all read everything
        self._kept: _Everything | None = None

    def nearest(self, models: TableVersion, query: Query, count: int) -> Candidates:
        """Return the ``count`` rows nearest to a query, or all if there are fewer."""
        if models.count < self._exact_below:
            everything = self._everything(models)
            rows, found = everything.rows, everything.stored
            distances = self._distances(query.feature, everything.features)
        else:
            rows, found = self._approximately_nearest(models, query, count)
            # Block by block: decoded all at once they would not fit the cache.
            parts = (found[start : start + _ROWS_DECODED] for start in range(0, len(found), _ROWS_DECODED))
            distances = np.concatenate([np.empty(0), *(self._distances(query.feature, p.features) for p in parts)])
        order = np.argsort(distances, kind="stable")[:count]
        return Candidates(rows[order], distances[order], found[order])

    def index(self, *, moved: bool = False) -> None:
        """Make the inverted file, or bring it up to date, where the rows are too many to compare all.

        After rows were ``moved`` it is made anew: Lance carries it over to their new places, but then it is slower.
        """
        IvfFlat = import_installed("lancedb.index").IvfFlat

        table, count = self._store.models, self._store.latest().count
        if count < self._exact_below:
            return
        with translated(self._store.path, "indexing it"):
            if not moved and any(index.columns == ["sketch"] for index in table.list_indices()):
                statistics = table.index_stats("sketch_idx")
                if statistics is not None and statistics.num_unindexed_rows <= _STALE_SHARE * count:
                    return
        partitions = max(1, count // _ROWS_A_PARTITION)
        config = IvfFlat(distance_type="l2", num_partitions=partitions, max_iterations=20, sample_rate=64)
        self._store.commit(table, lambda: table.create_index("sketch", config=config, replace=True), "indexing it")

    def close_pairs(self, models: TableVersion, limit: float) -> Iterator[tuple[int, int, float]]:
        """Yield pairs of ``_rowid`` whose features are at most ``limit`` apart, and how far they are."""
        features = None
        if models.count < self._exact_below:
            everything = self._everything(models)
            features = everything.features
            found = [(everything.rows, *self._lower_bounds(everything.stored))]
        else:
            tables = models.batches(["signature"])
            found = [(identifiers(table), *self._lower_bounds(self._read(table))) for table in tables]
        rows, sketch, sums = (np.concatenate(parts) for parts in zip(*found, strict=True))
        norm = np.square(sketch).sum(axis=1)
        # No two rows this close are further apart in their sketches.
        bound = np.float32((2 * limit if self._l1 else limit * limit) * _ROUNDING) + 1e-5 * norm.max(initial=0)
        step = max(1, _PAIRS_A_BLOCK // max(1, len(rows)))
        for start in range(0, len(rows), step):
            part = slice(start, start + step)
            squared = norm[part, None] + norm[None, start:] - 2 * (sketch[part] @ sketch[start:].T)
            left, right = np.nonzero(np.triu(squared <= bound, k=1))
            left, right = _still_close(left + start, right + start, sums, limit * _ROUNDING)
            for begin in range(0, len(left), _BLOCK):
                one, two = left[begin : begin + _BLOCK], right[begin : begin + _BLOCK]
                distance = self._pair_distances(models, one, two, rows, features)
                for index in np.flatnonzero(distance <= limit):
                    yield int(rows[one[index]]), int(rows[two[index]]), float(distance[index])

    def _lower_bounds(self, stored: StoredRows) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """What excludes: sketches of the roots, and sums over parts of features; in L2 sketches of features alone."""
        features = stored.features
        if not self._l1:
            return shortened(features, self._store.basis), np.empty((len(stored), 0), np.float32)
        roots = signed_roots(stored.numbers["feature"], stored.numbers["feature_step"])
        sums = np.add.reduceat(features, np.arange(0, features.shape[1], _NUMBERS_A_SUM), axis=1)
        return shortened(roots, self._store.basis), sums

    def _pair_distances(
        self, models: TableVersion, one: IntArray, two: IntArray, rows: IntArray, features: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Distances of pairs of places among ``rows``; ``features`` are read where they are None."""
        if features is None:
            needed, place = np.unique(np.concatenate((one, two)), return_inverse=True)
            features = self._read(models.rows(rows[needed], ["signature"])).features
            one, two = place[: len(one)], place[len(one) :]
        difference = np.abs(features[one] - features[two])
        return np.asarray(difference.sum(axis=1) if self._l1 else np.linalg.norm(difference, axis=1))

    def _everything(self, models: TableVersion) -> _Everything:
        with self._lock:
            kept = self._kept
            if kept is None or kept.version is not models:
                table = models.columns(["signature"])
                stored = self._read(table)
                kept = _Everything(models, identifiers(table), stored, stored.features)
                if self._kept is None or self._kept.version.number < models.number:
                    self._kept = kept
            return kept

    def _approximately_nearest(self, models: TableVersion, query: Query, count: int) -> tuple[IntArray, StoredRows]:
        probes = max(_PROBES, math.isqrt(models.count // _ROWS_A_PARTITION))
        wanted = max(_LEAST_CANDIDATES, _CANDIDATES_A_HIT * count, int(_CANDIDATES_A_ROOT * math.sqrt(models.count)))
        with translated(self._store.path, "searching it"):
            search = models.table.search(query.sketch, vector_column_name="sketch").distance_type("l2")
            columns = ["signature", "_distance"]
            table: Any = search.nprobes(probes).limit(wanted).select(columns).with_row_id(True).to_arrow()
        return identifiers(table), self._read(table)

    def _read(self, table: Any) -> StoredRows:
        return stored_rows(table["signature"], self._option, self._store.path)

    def _distances(self, query: NDArray[np.float32], others: NDArray[np.float32]) -> Float64Array:
        if not self._l1:
            return np.asarray(cdist(query[None], others, "euclidean")[0])
        result = np.empty(len(others))
        for start in range(0, len(others), _BLOCK):  # a block and its differences fit the cache
            part = slice(start, start + _BLOCK)
            result[part] = np.abs(others[part] - query).sum(axis=1)
        return result


def _still_close(left: IntArray, right: IntArray, sums: NDArray[np.float32], limit: float) -> tuple[IntArray, IntArray]:
    """Leave out the pairs of rows whose sums are further apart in L1, as their features then are."""
    kept = np.ones(len(left), dtype=bool)
    for start in range(0, len(left) if sums.size else 0, _BLOCK):
        part = slice(start, start + _BLOCK)
        kept[part] = np.abs(sums[left[part]] - sums[right[part]]).sum(axis=1) <= limit
    return left[kept], right[kept]
