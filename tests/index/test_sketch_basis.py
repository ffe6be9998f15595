"""The basis of sketches: orthogonal, the same everywhere, and good for shapes that it was not learned from."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from fsh3d_o3d.descriptors.shd import SHDOption
from fsh3d_o3d.geometry.measures import enclosed_volume
from fsh3d_o3d.index.codec import SKETCH_LENGTH, sketches
from fsh3d_o3d.index.extraction import describe
from fsh3d_o3d.index.sketch_basis import example_shape, sketch_basis
from fsh3d_o3d.jobs.descriptor_cache import clear_descriptor_cache
from tests.index.index_cases import QUICK, blob


def test_columns_are_orthogonal_and_of_one_length():
    basis = sketch_basis(QUICK).astype(np.float64)
    length = QUICK.feature_shape[0] * QUICK.feature_shape[1]
    assert basis.shape == (length, SKETCH_LENGTH)
    gram = basis.T @ basis / np.square(basis[:, 0]).sum()
    np.testing.assert_allclose(gram, np.eye(SKETCH_LENGTH), atol=2e-3)  # float16


def test_fewer_numbers_than_a_sketch_has():
    option = SHDOption(bandwidth=4, shells=8, voxels=24, samples=512)  # energies: 4 · 8 numbers
    basis = sketch_basis(option)
    assert np.linalg.matrix_rank(basis.astype(np.float64)) == 32
    assert not basis[:, 32:].any()


def test_made_anew_it_is_the_same():
    before = sketch_basis(QUICK)
    for clear in (lambda: None, clear_descriptor_cache):  # from the cache on disk, and from nothing
        sketch_basis.cache_clear()
        clear()
        np.testing.assert_array_equal(sketch_basis(QUICK), before)


def test_sketches_find_the_neighbours_of_other_shapes():
    features = np.stack([describe(blob(number), QUICK).feature for number in range(120)])
    short = sketches(features, sketch_basis(QUICK)).astype(np.float64)
    exact, near = cdist(features, features, "cityblock"), cdist(short, short)
    for distances in (exact, near):
        np.fill_diagonal(distances, np.inf)
    neighbours = np.argsort(exact, axis=1)[:, :5]
    candidates = np.argsort(near, axis=1)[:, :15]
    found = [np.isin(true, those).mean() for true, those in zip(neighbours, candidates, strict=True)]
    assert np.mean(found) >= 0.97  # by chance 0.13


def test_examples_are_closed_and_all_different():
    meshes = [example_shape(number) for number in range(40)]
    assert all((enclosed_volume(mesh) or 0) > 0 for mesh in meshes)
    assert len({mesh.vertices.tobytes() for mesh in meshes}) == 40
    assert {round(np.log2(len(mesh.vertices))) for mesh in meshes} >= {6, 7, 8, 9}
