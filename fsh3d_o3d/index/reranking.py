"""Hits of a query: its nearest candidates, aligned with it and ranked anew by how far they then are from it.

All of it is read from one version of the index.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.descriptors import mixed_distances, signature_distances
from fsh3d_o3d.index.checksums import require_checksums
from fsh3d_o3d.index.extraction import similarity
from fsh3d_o3d.index.results import Hit
from fsh3d_o3d.index.roots import LibraryRoots
from fsh3d_o3d.index.rows import Query
from fsh3d_o3d.index.search import Candidates, IndexSearch
from fsh3d_o3d.index.version import TableVersion

_COLUMNS = ["path", "vertices", "triangles", "watertight", "thumbnail"]


def reranked_hits(
    models: TableVersion, search: IndexSearch, query: Query, roots: Callable[[], LibraryRoots], top: int, rerank: int
) -> tuple[Hit, ...]:
    """Return the ``top`` models most like a query, of ``rerank`` aligned ones; ``roots`` tells where libraries are."""
    candidates = search.nearest(models, query, max(top, rerank) if rerank else top)
    if len(candidates.rows) == 0:
        return ()
    aligned, rotations = signature_distances(query.coefficients, candidates.stored.coefficients)
    distances = mixed_distances(candidates.distances, aligned) if rerank else candidates.distances
    order = np.argsort(distances, kind="stable")[:top]
    table = _rows(models, candidates, order)
    known = roots()  # after the rows: another writer may have put in both
    frames = candidates.stored.frames
    hits = []
    for place, index in enumerate(order):
        onto = similarity(query.frame, frames[index], rotations[index])
        turn = onto[:3, :3] / np.cbrt(np.linalg.det(onto[:3, :3]))
        for array in (onto, turn):
            array.setflags(write=False)
        hits.append(
            Hit(
                path=known.path(table["path"][place]),
                distance=float(distances[index]),
                rank=place + 1,
                rotation=turn,
                transformation=onto,
                feature_distance=float(candidates.distances[index]),
                vertices=table["vertices"][place],
                triangles=table["triangles"][place],
                watertight=table["watertight"][place],
                thumbnail=table["thumbnail"][place],
            )
        )
    return tuple(hits)


def _rows(models: TableVersion, candidates: Candidates, order: IntArray) -> dict[str, list[Any]]:
    """What is told of hits, by column."""
    pa = import_installed("pyarrow")

    rows = models.rows(candidates.rows[order], [name for name in models.table.schema.names if name != "signature"])
    # With the numbers that were ranked: a row's checksum ties them to its path.
    ranked = pa.array([numbers.tobytes() for numbers in candidates.stored.numbers[order]], pa.binary())
    require_checksums(rows.append_column("signature", ranked), models.path)
    return dict(rows.select(_COLUMNS).to_pydict())
