import numpy as np
import pytest

from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere_map.mobius import inverted, normalized
from fsh3d_o3d.sphere_map.untangle import untangled
from fsh3d_o3d.sphere_map.validity import is_valid, orientations


def test_a_valid_map_stays_to_the_bit():
    sphere, triangles = icosphere(8)
    assert untangled(sphere, triangles) is sphere


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [1, 10])
def test_vertices_thrown_over_their_neighbours_come_back(seed, count):
    sphere, triangles = icosphere(12)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(sphere), count, replace=False)
    tangled = sphere.copy()
    tangled[chosen] = normalized(tangled[chosen] + 0.3 * rng.normal(size=(count, 3)))
    if is_valid(tangled, triangles):
        tangled[chosen] = -tangled[chosen]
    mended = untangled(tangled, triangles)
    assert is_valid(mended, triangles)
    np.testing.assert_allclose(np.linalg.norm(mended, axis=1), 1, rtol=1e-14)


def test_what_is_far_from_the_tangle_stays():
    sphere, triangles = icosphere(20)
    tangled = sphere.copy()
    tangled[0] = normalized(tangled[:1] + 0.2)[0]
    assert (orientations(tangled, triangles) <= 0).any()
    mended = untangled(tangled, triangles)
    assert is_valid(mended, triangles)
    far = sphere @ sphere[0] < 0.5
    np.testing.assert_array_equal(mended[far], sphere[far])


def test_a_patch_of_a_millionth_is_mended_like_a_large_one():
    # A crowd some 1e-6 across: moves are solved for, so that rounding is relative to the patch and not to the sphere.
    sphere, triangles = icosphere(12)
    crowded = inverted(sphere, np.array([0, 0, 1 - 1e-6]))
    assert is_valid(crowded, triangles)
    chosen = np.flatnonzero(sphere[:, 2] > 0)[40]
    tangled = crowded.copy()
    tangled[chosen] += 4 * (crowded[chosen] - crowded[0])
    tangled = normalized(tangled)
    assert not is_valid(tangled, triangles)
    mended = untangled(tangled, triangles)
    assert is_valid(mended, triangles)
    np.testing.assert_allclose(mended[chosen], crowded[chosen], atol=1e-6)


def test_a_hopeless_map_comes_back_no_worse():
    sphere, triangles = icosphere(4)
    assert (orientations(untangled(-sphere, triangles), triangles) <= 0).all()
