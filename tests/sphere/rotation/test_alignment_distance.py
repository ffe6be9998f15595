"""The distance of functions at their best rotation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.sphere.coefficients import degree_energies
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.rotation.alignment_distance import aligned_distance
from fsh3d_o3d.sphere.rotation.rotation import rotate_coefficients

ROTATIONS = Rotation.random(6, random_state=3).as_matrix()


def functions(seed, shells=3, bandwidth=6):
    degree = degrees_and_orders(bandwidth)[0]
    return np.random.default_rng(seed).standard_normal((shells, bandwidth**2)) / (1 + degree)


@pytest.mark.parametrize("rotation", ROTATIONS[:3])
def test_rotated_copies_are_at_zero(rotation):
    rows = functions(0)
    # The root of a rounding error of the squared norms.
    assert aligned_distance(rows, rotate_coefficients(rows, rotation)) < 1e-7 * np.linalg.norm(rows)


def test_it_is_symmetric_and_does_not_depend_on_poses():
    one, other = functions(1), functions(2)
    expected = aligned_distance(one, other)
    assert aligned_distance(other, one) == pytest.approx(expected, rel=1e-9)
    for rotation in ROTATIONS:
        # Another pose starts the search elsewhere; it ends at the same maximum.
        assert aligned_distance(one, rotate_coefficients(other, rotation)) == pytest.approx(expected, rel=1e-9)


def test_it_lies_between_the_distances_of_energies_and_of_coefficients():
    one, other = functions(3), functions(4)
    distance = aligned_distance(one, other)
    assert np.linalg.norm(degree_energies(one) - degree_energies(other)) <= distance
    assert distance <= np.linalg.norm(one - other)
    # No rotation tried by hand is nearer.
    tried = [
        np.linalg.norm(one - rotate_coefficients(other, turn))
        for turn in Rotation.random(500, random_state=0).as_matrix()
    ]
    assert distance <= min(tried) + 1e-12


def test_degrees_beyond_the_bandwidth_count_by_their_energies():
    one, other = functions(5), functions(5)
    other[:, 16:] = rotate_coefficients(other, ROTATIONS[0])[:, 16:]  # degrees 4 and 5 turned by themselves
    assert aligned_distance(one, other, bandwidth=4) < 1e-7 * np.linalg.norm(one)
    assert aligned_distance(one, other, bandwidth=6) > 0.1 * np.linalg.norm(one[:, 16:])


def test_mirror_images_are_alike_where_asked_for():
    one = functions(6)
    mirrored = one * np.where(degrees_and_orders(6)[1] < 0, -1.0, 1.0)  # y → −y
    assert aligned_distance(one, mirrored, reflections=True) < 1e-7 * np.linalg.norm(one)
    assert aligned_distance(one, mirrored) > 0.1 * np.linalg.norm(one)


def test_constants_have_only_their_means():
    sphere, other = np.zeros((2, 16)), functions(7, shells=2, bandwidth=4)
    sphere[:, 0] = (1.0, 2.0)
    expected = np.linalg.norm(np.concatenate((degree_energies(other)[:, 1:].ravel(), sphere[:, 0] - other[:, 0])))
    assert aligned_distance(sphere, other) == pytest.approx(expected, rel=1e-12)
    assert aligned_distance(np.zeros(9), np.zeros(9)) == 0


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (np.ones((2, 9)), np.ones((3, 9)), "same shape"),
        (np.ones((2, 9)), np.ones((2, 16)), "same shape"),
        (np.ones(9), np.full(9, np.nan), "finite"),
        (np.ones(8), np.ones(8), "square number"),
    ],
)
def test_bad_input_is_refused(first, second, message):
    with pytest.raises(ValueError, match=message):
        aligned_distance(first, second)
