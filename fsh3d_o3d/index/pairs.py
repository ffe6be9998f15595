"""Pairs of models of an index that are almost the same shape, and which of them are mirror images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from fsh3d_o3d.descriptors import SHDOption, fits_only_mirrored
from fsh3d_o3d.index.results import NearDuplicate
from fsh3d_o3d.index.rows import StoredRows, stored_rows
from fsh3d_o3d.index.search import IndexSearch
from fsh3d_o3d.index.version import TableVersion

_ROWS_AT_ONCE = 4096  # read with their thumbnails
_ALIGNED_AT_ONCE = 1024  # decoded: 6 kB each


def near_duplicates(
    models: TableVersion, search: IndexSearch, option: SHDOption, path_of: Callable[[bytes], str], limit: float
) -> tuple[NearDuplicate, ...]:
    """Return the pairs whose features are at most ``limit`` apart, closest first; ``path_of`` a column ``path``."""
    pairs = list(search.close_pairs(models, limit))
    rows = np.unique(np.array([pair[:2] for pair in pairs], dtype=np.int64))
    if not pairs:
        return ()
    paths: list[str] = []
    parts = []
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        read = models.checked_rows(rows[start : start + _ROWS_AT_ONCE])
        paths += map(path_of, read["path"].to_pylist())
        stored = stored_rows(read["signature"], option, models.path)
        # Without the features, which are four fifths of it: there may be many rows.
        parts.append(repack_fields(stored.numbers[["coefficients_step", "coefficients"]]))
    places = [(int(one), int(other)) for one, other in np.searchsorted(rows, [pair[:2] for pair in pairs])]
    mirrored = _mirrored(StoredRows(np.concatenate(parts), stored.functions), places)
    found = [
        NearDuplicate(min(paths[one], paths[other]), max(paths[one], paths[other]), pair[2], bool(only_mirrored))
        for (one, other), pair, only_mirrored in zip(places, pairs, mirrored, strict=True)
    ]
    return tuple(sorted(found, key=lambda pair: (pair.distance, pair.first, pair.second)))


def _mirrored(stored: StoredRows, places: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which pairs (n,) of places among rows only fit as mirror images."""
    result = np.zeros(len(places), dtype=bool)
    order = sorted(range(len(places)), key=lambda index: places[index])
    for first, group in groupby(order, key=lambda index: places[index][0]):
        indices = np.array(list(group))
        others = np.array([places[index][1] for index in indices])
        own = stored.numbers["coefficients"][first]
        differ = (stored.numbers["coefficients"][others] != own).any(axis=1)  # copies of a file need no alignment
        indices, others = indices[differ], others[differ]
        for start in range(0, len(others), _ALIGNED_AT_ONCE):
            part = slice(start, start + _ALIGNED_AT_ONCE)
            many = stored[others[part]].coefficients
            result[indices[part]] = fits_only_mirrored(stored[first : first + 1].coefficients[0], many)
    return result
