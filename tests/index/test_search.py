"""Search by the inverted file finds what comparing everything finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from fsh3d_o3d.descriptors.shd import ShapeSignature, compute_signature
from fsh3d_o3d.geometry.surface import surface_of
from fsh3d_o3d.index.extraction import Described, FileState, similarity
from fsh3d_o3d.index.rows import Query, model_columns
from fsh3d_o3d.index.search import IndexSearch
from fsh3d_o3d.index.store import IndexStore
from tests.index.index_cases import QUICK, blob


def variants(count, seed):
    """Query.of shapes like a few given ones."""
    random = np.random.default_rng(seed)
    bases = [compute_signature(blob(n), QUICK, bandwidth=4) for n in range(8)]
    for _ in range(count):
        one, other = (bases[k] for k in random.integers(8, size=2))
        share = random.random() / 2
        feature = (1 - share) * one.feature + share * other.feature
        feature = feature * (1 + 0.1 * random.standard_normal(len(feature)))
        yield ShapeSignature(
            feature=(feature / np.abs(feature).sum()).astype(np.float32),
            coefficients=one.coefficients,
            centroid=one.centroid,
            rms_radius=one.rms_radius,
            axes=one.axes,
        )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    found = [Described(FileState(1, 1), bytes(32), signature) for signature in variants(1500, 1)]
    store = IndexStore.open(str(tmp_path_factory.mktemp("store") / "index"), QUICK)
    store.put(store.models, model_columns([f"/{n}" for n in range(1500)], found, QUICK, store.basis))
    return store


def test_inverted_file_finds_the_same(store):
    exact, inverted = IndexSearch(store, QUICK), IndexSearch(store, QUICK, exact_below=100)
    queries = [Query.of(signature, store.basis) for signature in variants(20, 2)]
    expected = [exact.nearest(store.latest(), query, 10) for query in queries]
    recall = []
    for indexed in (False, True):
        if indexed:
            inverted.index()
            assert store.models.index_stats("sketch_idx").num_indexed_rows == 1500
        for query, true in zip(queries, expected, strict=True):
            found = inverted.nearest(store.latest(), query, 10)
            recall.append(np.isin(true.rows, found.rows).mean())
            if recall[-1] == 1:
                np.testing.assert_array_equal(found.distances, true.distances)
                np.testing.assert_array_equal(found.stored.coefficients, true.stored.coefficients)
    assert np.mean(recall) >= 0.99


@pytest.mark.parametrize("exact_below", [10**6, 100])
def test_close_pairs_are_all_pairs_that_close(store, exact_below):
    search = IndexSearch(store, QUICK, exact_below=exact_below)
    everything = IndexSearch(store, QUICK)._everything(store.latest())
    rows, features = everything.rows, everything.features
    distances = squareform(pdist(features, "cityblock"))
    limit = float(np.quantile(distances[distances > 0], 0.0005))
    left, right = np.nonzero(np.triu(distances <= limit, k=1))
    expected = {frozenset((int(rows[i]), int(rows[j]))): distances[i, j] for i, j in zip(left, right, strict=True)}
    found = {frozenset((one, other)): distance for one, other, distance in search.close_pairs(store.latest(), limit)}
    assert len(found) > 100
    assert found == pytest.approx(expected, abs=1e-6)


def test_index_is_not_made_anew_without_need(store):
    search = IndexSearch(store, QUICK, exact_below=100)
    search.index()
    version = store.refresh()
    search.index()
    IndexSearch(store, QUICK).index()  # too few rows to need one
    assert store.refresh() == version


def test_similarity_takes_one_frame_to_another(random_rotation):
    mesh = blob(3)
    one = surface_of(mesh, 256)
    frame = np.concatenate((one.centroid, [one.rms_radius], np.eye(3).ravel()))
    turned = np.concatenate(([1.0, 2.0, 3.0], [2 * one.rms_radius], random_rotation.ravel()))
    onto = similarity(turned, frame, np.eye(3))
    expected = (mesh.vertices - one.centroid) @ random_rotation * 2 + [1.0, 2.0, 3.0]
    # Rounding of a few products of order one.
    np.testing.assert_allclose(mesh.vertices @ onto[:3, :3].T + onto[:3, 3], expected, atol=1e-12)
