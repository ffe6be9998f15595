"""One byte a number: what comes back, and distances of sketches."""

from __future__ import annotations

import hypothesis.extra.numpy as arrays
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from fsh3d_o3d.index.codec import SKETCH_LENGTH, decoded, encoded, shortened, signed_roots, sketches

VECTORS = arrays.arrays(np.float32, (3, 40), elements=st.floats(-100, 100, width=32))


@given(VECTORS)
def test_what_comes_back_is_half_a_step_of_the_root_away(vectors):
    codes, steps = encoded(vectors)
    assert codes.dtype == np.int8
    back = decoded(codes, steps)
    root = lambda x: np.copysign(np.sqrt(np.abs(x.astype(np.float64))), x)  # noqa: E731
    # Half a step, and the rounding of float32: of the root, of the step, and of squares that are subnormal.
    assert (np.abs(root(back) - root(vectors)) <= 0.5 * steps[:, None] + 1e-5 * np.abs(root(vectors)) + 1e-18).all()


@given(VECTORS)
def test_stored_vectors_are_stored_as_they_are(vectors):
    once = decoded(*encoded(vectors))
    # The step is computed anew from the largest, which may differ in its last bit.
    np.testing.assert_allclose(decoded(*encoded(once)), once, rtol=1e-6, atol=1e-30)


def test_zeros_stay_zeros():
    codes, steps = encoded(np.zeros((2, 8), dtype=np.float32))
    assert not decoded(codes, steps).any()


def orthogonal(rng, length: int) -> np.ndarray:
    basis = np.linalg.qr(rng.standard_normal((length, SKETCH_LENGTH)))[0]
    return (64 * basis).astype(np.float16)


def test_sketches_are_projections(rng):
    vectors = rng.standard_normal((5, 600)).astype(np.float32)
    basis = orthogonal(rng, 600)
    short = sketches(vectors, basis)
    assert (short.dtype, short.shape) == (np.float16, (5, SKETCH_LENGTH))
    np.testing.assert_allclose(short, vectors.astype(np.float64) @ basis, rtol=1e-3, atol=1e-2)  # float16
    assert np.isfinite(sketches(1e6 * vectors, basis)).all()


def test_no_two_are_further_apart_in_short(rng):
    """Vectors within the basis' own span are the hardest: a projection takes nothing from them."""
    basis = orthogonal(rng, 600)
    inside = basis.astype(np.float32) @ rng.standard_normal((SKETCH_LENGTH, 40)).astype(np.float32)
    vectors = np.concatenate((inside.T, rng.standard_normal((40, 600)).astype(np.float32)))
    short = shortened(vectors, basis)
    distances = pdist(vectors.astype(np.float64))
    assert (pdist(short.astype(np.float64)) <= distances).all()
    assert pdist(short.astype(np.float64)).max() > 0.97 * distances.max()


@given(VECTORS)
def test_near_is_near_in_roots(vectors):
    """The inequality on which the search for near duplicates rests."""
    roots = signed_roots(*encoded(vectors)).astype(np.float64)
    values = roots * np.abs(roots)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = np.square(roots[one] - roots[other]).sum()
        assert apart <= 2 * np.abs(values[one] - values[other]).sum() * (1 + 1e-12)
