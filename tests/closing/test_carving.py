"""Carving a ball around any set of grid vertices."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp
from scipy.ndimage import label

from fsh3d_o3d.closing.carving import carve
from fsh3d_o3d.closing.kuhn_grid import NEIGHBORS, between, flat_offsets, simple_vertices, structure
from fsh3d_o3d.geometry.measures import measure_mesh


def radii(size):
    place = np.indices((size,) * 3) - (size - 1) / 2
    return np.hypot(place[0], place[1]), place[2]


def measures_of(body):
    return measure_mesh(between(body, np.ones(body.shape), 0.1)[0])


def require_ball(kept, body):
    measures = measures_of(body)
    assert (measures.genus, measures.outward) == (0, True)
    assert body[kept].all()


@given(hnp.arrays(bool, (7, 6, 8)))
def test_any_set_gets_a_ball_that_cannot_be_smaller(labels):
    kept = np.pad(labels, 1)
    kept[3, 3, 3] = True
    body = carve(kept)
    require_ball(kept, body)
    added = np.flatnonzero(body & ~kept)
    code = body.ravel()[added[:, None] + flat_offsets(NEIGHBORS, body.shape)] @ (1 << np.arange(14))
    assert not simple_vertices()[code].any()


def test_a_ball_stays():
    across, along = radii(20)
    kept = np.hypot(across, along) < 7
    assert np.array_equal(carve(kept), kept)


def test_a_handle_gets_one_membrane():
    across, along = radii(28)
    kept = np.hypot(across - 9, along) < 3
    assert measures_of(kept).genus == 1
    body = carve(kept)
    require_ball(kept, body)
    added = body & ~kept
    assert label(added, structure())[1] == 1
    # A disc of one layer, no higher than the tube; a flat one would have π 6² vertices.
    assert np.abs(along[added]).max() < 3
    assert added.sum() < 1.5 * np.pi * 6**2


def test_a_void_is_filled():
    across, along = radii(20)
    radius = np.hypot(across, along)
    kept = (radius < 8) & (radius > 5)
    assert np.array_equal(carve(kept), radius < 8)


def test_parts_are_joined_by_straight_threads():
    kept = np.zeros((24, 9, 9), dtype=bool)
    kept[2:5, 3:6, 3:6] = kept[18:21, 3:6, 3:6] = True
    body = carve(kept)
    require_ball(kept, body)
    added = np.argwhere(body & ~kept)
    assert np.array_equal(np.sort(added[:, 0]), np.arange(5, 18))  # one a plane
    assert np.abs(added[:, 1:] - 4).max() <= 1


def test_the_mirror_image_is_carved_alike():
    """Turning all axes over maps the tetrahedra onto themselves; only ties may then fall otherwise."""
    across, along = radii(22)
    kept = np.hypot(across - 6, along) < 2
    body = carve(kept)
    assert np.count_nonzero(body) == np.count_nonzero(carve(kept[::-1, ::-1, ::-1]))
    assert np.array_equal(body, carve(kept.copy()))
