"""Distances by common neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from fsh3d_o3d.evaluation.metrics import retrieval_metrics
from fsh3d_o3d.evaluation.neighborhood import neighborhood_distances


def chains(seed=0, members=12):
    """Two long classes side by side: their ends are farther from each other than from the other class."""
    along = np.linspace(0, 6, members)
    noise = np.random.default_rng(seed).normal(scale=0.02, size=(2 * members, 2))
    points = np.concatenate((np.column_stack((along, 0 * along)), np.column_stack((along, 0 * along + 1.5))))
    return cdist(points + noise, points + noise), np.repeat(("a", "b"), members)


def test_classes_hang_together_by_their_neighbours():
    distances, labels = chains()
    before = retrieval_metrics(distances, labels).micro.first_tier
    after = retrieval_metrics(neighborhood_distances(distances, neighbors=4), labels).micro.first_tier
    assert after > before


def test_far_clusters_are_at_the_largest_jaccard_distance():
    points = np.array([[0.0], [0.1], [0.2], [10.0], [10.1], [10.2]])
    distances = cdist(points, points)
    result = neighborhood_distances(distances, neighbors=2)
    own = 0.3 * distances * 2 / distances.max()
    # Neighbourhoods of different clusters share nothing: 0.7 of a Jaccard distance of 1.
    np.testing.assert_allclose(result[:3, 3:], own[:3, 3:] + 0.7, atol=1e-12)
    # Within a cluster all three are mutual neighbours, of unlike weights.
    assert (result - own)[:3, :3].max() < 0.6
    np.testing.assert_allclose(np.diag(result), 0, atol=1e-12)


def test_order_of_models_does_not_matter():
    distances, _ = chains(seed=1)
    order = np.random.default_rng(2).permutation(len(distances))
    moved = neighborhood_distances(distances[np.ix_(order, order)], neighbors=5)
    np.testing.assert_allclose(moved, neighborhood_distances(distances, neighbors=5)[np.ix_(order, order)], atol=1e-6)


def test_equal_models_and_more_neighbours_than_models():
    assert np.isfinite(neighborhood_distances(np.zeros((4, 4)), neighbors=50)).all()


@pytest.mark.parametrize(
    ("distances", "neighbors", "message"),
    [
        (np.zeros((3, 4)), 5, "shape"),
        (np.zeros((1, 1)), 5, "N >= 2"),
        (np.full((3, 3), np.nan), 5, "finite"),
        (np.zeros((3, 3)), 1, "neighbors"),
    ],
)
def test_bad_input_is_refused(distances, neighbors, message):
    with pytest.raises(ValueError, match=message):
        neighborhood_distances(distances, neighbors=neighbors)
