"""Symmetries of bodies whose groups are known, in any pose."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh

Function = Callable[[np.ndarray], np.ndarray]
GOLDEN = (1 + math.sqrt(5)) / 2


def bumps(points: object, sharpness: float = 14.0) -> Function:
    """A sum of equal bumps in given directions: its symmetries are those of the points."""
    centres = np.array(points, dtype=float)
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    return lambda directions: np.exp(sharpness * (directions @ centres.T - 1)).sum(axis=1)


def ring(n: int, heights: tuple[float, ...]) -> Function:
    turn = 2 * np.pi * np.arange(n) / n
    return bumps([(math.cos(a), math.sin(a), height) for a in turn for height in heights])


def ellipsoid(*axes: float) -> Function:
    return lambda directions: 1 / np.linalg.norm(directions / axes, axis=1)


def posed(function: Function, rotation: np.ndarray, bandwidth: int = 16) -> np.ndarray:
    transform = fsh.SphericalHarmonicTransform(bandwidth)
    return np.asarray(transform.forward(function(transform.grid.directions @ rotation)))


def cyclic(points: tuple[float, float, float]) -> list[tuple[float, float, float]]:
    x, y, z = points
    return [(s * x, t * y, u * z) for s in (1, -1) for t in (1, -1) for u in (1, -1)]


TETRAHEDRON = bumps([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
CUBE = bumps(cyclic((1, 1, 1)))
ICOSAHEDRON = bumps(cyclic((0, 1, GOLDEN)) + cyclic((1, GOLDEN, 0)) + cyclic((GOLDEN, 0, 1)), 24.0)
BOX = bumps(cyclic((1, 0.7, 0.5)))
CASES: list[tuple[str, Function, dict[int, int], int, bool]] = [
    ("tetrahedron", TETRAHEDRON, {3: 4, 2: 3}, 6, False),
    ("cube", CUBE, {4: 3, 3: 4, 2: 6}, 9, True),
    ("icosahedron", ICOSAHEDRON, {5: 6, 3: 10, 2: 15}, 15, True),
    ("box", BOX, {2: 3}, 3, True),
    ("ellipsoid", ellipsoid(1, 1.5, 2.2), {2: 3}, 3, True),
    ("spheroid", ellipsoid(1, 1, 2.2), {0: 1, 2: 1}, 2, True),
    ("cone", lambda d: np.exp(d[:, 2]) + np.exp(-3 * (d[:, 2] - 0.3) ** 2), {0: 1}, 1, False),
    ("linear", lambda d: d[:, 0], {0: 1}, 1, False),
]
for count in (2, 3, 4, 5, 6, 8):
    CASES.append(
        (
            f"prism {count}",
            ring(count, (0.5, -0.5)),
            {count: 1, 2: count} if count > 2 else {2: 3},
            count + 1,
            count % 2 == 0,
        )
    )
    CASES.append((f"pyramid {count}", ring(count, (0.5,)), {count: 1}, count, False))


@pytest.mark.parametrize("name", ["pyramid 8", "prism 8", "pyramid 6", "cube"])
def test_planes_do_not_depend_on_the_pose(name: str) -> None:
    """Across an axis of high order every plane is nearly one of symmetry; only the best ones are."""
    function, axes, planes = next(case[1:4] for case in CASES if case[0] == name)
    for seed in range(30, 42):
        rotation = Rotation.random(random_state=seed).as_matrix()
        report = fsh.find_symmetries(posed(function, rotation))
        assert Counter(axis.order for axis in report.axes) == axes
        assert len(report.planes) == planes


@pytest.mark.parametrize(("name", "function", "axes", "planes", "centre"), CASES, ids=[case[0] for case in CASES])
def test_known_groups(
    name: str, function: Function, axes: dict[int, int], planes: int, centre: bool, random_rotation: np.ndarray
) -> None:
    report = fsh.find_symmetries(posed(function, random_rotation))
    assert Counter(axis.order for axis in report.axes) == axes
    assert len(report.planes) == planes
    assert report.is_symmetric
    assert report.of_revolution == (0 in axes)
    assert not report.spherical
    # Sampling is exact but for degrees of 32 and more.
    scores = [axis.score for axis in report.axes] + [plane.score for plane in report.planes]
    assert min(scores) > 1 - 1e-8
    assert report.rotation_score == pytest.approx(1, abs=1e-8)
    assert report.reflection_score == pytest.approx(1, abs=1e-8)
    assert (report.point_score > 1 - 1e-8) == centre


def test_axes_are_where_they_should_be(random_rotation: np.ndarray) -> None:
    report = fsh.find_symmetries(posed(CUBE, random_rotation))
    corners = {4: np.eye(3), 3: np.array(cyclic((1, 1, 1))) / math.sqrt(3)}
    for axis in report.axes:
        own = axis.direction @ random_rotation
        if axis.order in corners:
            # Maxima are found to 1e-7 and better.
            assert np.abs(corners[axis.order] @ own).max() > 1 - 1e-12
        else:
            assert np.sort(np.abs(own)) == pytest.approx([0, math.sqrt(0.5), math.sqrt(0.5)], abs=1e-6)
    orders = [axis.order for axis in report.axes]
    assert orders == sorted(orders, reverse=True)
    spheroid = fsh.find_symmetries(posed(ellipsoid(1, 1, 0.6), random_rotation))
    assert spheroid.axes[0].order == 0
    assert abs(spheroid.axes[0].direction @ random_rotation[:, 2]) > 1 - 1e-12


def test_a_function_without_symmetry(rng: np.random.Generator) -> None:
    report = fsh.find_symmetries(rng.standard_normal((3, 144)))
    assert report.axes == report.planes == ()
    assert not report.is_symmetric
    assert not report.of_revolution
    assert report.rotation_score < 0.7
    assert report.reflection_score < 0.8


def test_a_mirror_plane_alone_leaves_the_pose_unique(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    points = rng.standard_normal((5, 3))
    function = bumps(np.concatenate((points, points * [1, 1, -1])), 9.0)
    report = fsh.find_symmetries(posed(function, random_rotation))
    assert report.axes == ()
    assert not report.is_symmetric
    assert len(report.planes) == 1
    assert abs(report.planes[0].normal @ random_rotation[:, 2]) > 1 - 1e-10
    assert report.reflection_score == pytest.approx(1, abs=1e-9)


def test_rotations_without_mirrors(random_rotation: np.ndarray) -> None:
    """A twisted prism: the group of rotations of a prism, and chiral."""
    turn = 2 * np.pi * np.arange(3) / 3
    points = [(math.cos(a + s * 0.25), math.sin(a + s * 0.25), 0.6 * s) for a in turn for s in (1, -1)]
    report = fsh.find_symmetries(posed(bumps(points), random_rotation))
    assert Counter(axis.order for axis in report.axes) == {3: 1, 2: 3}
    assert report.planes == ()
    assert report.reflection_score < 0.98


def test_scores_tell_how_nearly(rng: np.random.Generator) -> None:
    """A relative difference δ between f and its rotated self is a correlation of 1 − δ²/2."""
    even = posed(ring(4, (0.5,)), np.eye(3))
    odd = rng.standard_normal(256)
    even[0] = odd[0] = 0
    for amount in (0.02, 0.05):
        noisy = even / np.linalg.norm(even) + amount * odd / np.linalg.norm(odd)
        report = fsh.find_symmetries(noisy)
        assert report.axes[0].order == 4
        quarter = fsh.rotate_coefficients(noisy, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]))
        half = fsh.rotate_coefficients(noisy, np.diag([-1.0, -1, 1]))
        worst = min(quarter @ noisy, half @ noisy) / (noisy @ noisy)
        # The axis found may be the better one by its freedom to tilt, or worse for what Newton maximises.
        assert report.axes[0].score == pytest.approx(worst, abs=amount**2)
        assert 1 - report.axes[0].score < 2 * amount**2
    assert fsh.find_symmetries(noisy, threshold=0.99999).axes == ()


def test_spheres_and_what_is_nearly_one(rng: np.random.Generator) -> None:
    for coefficients in (np.eye(64)[0], [3.0], np.eye(9)[:1] * np.array([[1.0], [2.0]])):
        report = fsh.find_symmetries(coefficients)
        assert report.spherical
        assert report.is_symmetric
        assert report.of_revolution
        assert report.axes == report.planes == ()
    assert fsh.find_symmetries(np.eye(64)[0] + 1e-4 * rng.standard_normal(64)).spherical
    assert not fsh.find_symmetries(np.eye(64)[0] + 1e-2 * rng.standard_normal(64)).spherical


def test_all_shells_have_to_agree(random_rotation: np.ndarray) -> None:
    """A cube and a tetrahedron in the same frame share what the tetrahedron has."""
    both = np.stack((posed(CUBE, random_rotation), posed(TETRAHEDRON, random_rotation)))
    assert Counter(axis.order for axis in fsh.find_symmetries(both).axes) == {3: 4, 2: 3}


def test_size_does_not_matter(random_rotation: np.ndarray) -> None:
    for factor in (1e-200, 1e200):
        report = fsh.find_symmetries(factor * posed(CUBE, random_rotation))
        assert Counter(axis.order for axis in report.axes) == {4: 3, 3: 4, 2: 6}


def test_low_bandwidths_take_prisms_for_bodies_of_revolution(random_rotation: np.ndarray) -> None:
    coefficients = posed(ring(6, (0.5, -0.5)), random_rotation)
    assert not fsh.find_symmetries(coefficients).of_revolution
    assert fsh.find_symmetries(coefficients, bandwidth=6).of_revolution


@pytest.mark.parametrize(
    ("coefficients", "options", "message"),
    [
        (np.zeros(16), {}, "coefficients are zero"),
        (np.ones(8), {}, "coefficients must have shape"),
        ([1, np.nan, 0, 0], {}, "coefficients must be finite"),
        (np.ones(9), {"threshold": 1.5}, "threshold must be"),
        (np.ones(9), {"threshold": -0.5}, "threshold must be"),
        (np.ones(9), {"bandwidth": 0}, "bandwidth must be"),
    ],
)
def test_bad_input(coefficients: object, options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fsh.find_symmetries(coefficients, **options)  # type: ignore[arg-type]
