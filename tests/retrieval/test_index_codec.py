"""One byte a number: what comes back, and distances of sketches."""

from __future__ import annotations

import hypothesis.extra.numpy as arrays
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fsh3d_o3d.retrieval._index_codec import SKETCH_LENGTH, decoded, encoded, sketches

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
    assert not sketches(codes, steps).any()


def test_sketches_keep_distances_of_roots(rng):
    vectors = rng.standard_normal((60, 600)).astype(np.float32) ** 3
    codes, steps = encoded(vectors)
    roots = codes.astype(np.float64) * steps[:, None]
    short = sketches(codes, steps).astype(np.float64)
    assert short.shape == (60, SKETCH_LENGTH)
    true = np.square(roots[:30] - roots[30:]).sum(axis=1)
    ratio = np.square(short[:30] - short[30:]).sum(axis=1) / true
    # The ratio's standard deviation is √(2/128) = 0.125: five of them.
    assert np.abs(ratio - 1).max() < 0.63
    assert abs(ratio.mean() - 1) < 5 * 0.125 / np.sqrt(30)


def test_signs_are_the_same_everywhere():
    one = np.zeros((1, 3600), dtype=np.int8)
    one[0, 0] = 1
    row = sketches(one, np.ones(1, dtype=np.float32))[0].astype(np.float64)
    # The first bytes of the hash stream, as hashlib gives them: stored sketches would be lost if they changed.
    assert "".join("1" if value > 0 else "0" for value in row[:16]) == FIRST_BITS
    np.testing.assert_allclose(np.abs(row), 1 / np.sqrt(SKETCH_LENGTH), rtol=1e-3)  # float16


FIRST_BITS = "0000011110101100"
