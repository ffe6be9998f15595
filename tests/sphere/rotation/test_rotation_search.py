"""Estimation of rotations: exact copies, symmetries, noise, exchange; bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh

CUBE_GROUP = Rotation.create_group("O").as_matrix()


def angle(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two rotations in radians, accurate near 0."""
    return float(2 * np.arcsin(min(1.0, np.linalg.norm(first - second) / np.sqrt(8))))


def smooth(rng: np.random.Generator, bandwidth: int, decay: float = 1.5, functions: int = 4) -> np.ndarray:
    degree, _ = fsh.degrees_and_orders(bandwidth)
    return rng.standard_normal((functions, bandwidth**2)) * (degree + 1.0) ** -decay


def cubic() -> np.ndarray:
    """x⁴ + y⁴ + z⁴ and x⁶ + y⁶ + z⁶: the 24 rotations of the cube leave them alone."""
    transform = fsh.SphericalHarmonicTransform(7)
    powers = [(transform.grid.directions**power).sum(axis=1) for power in (4, 6)]
    return np.asarray(transform.forward(np.stack(powers)))


@pytest.mark.parametrize("bandwidth", [3, 4, 5, 8, 9, 12, 16, 24, 32, 33, 64])
@pytest.mark.parametrize("decay", [0.0, 1.5, 3.0])
def test_exact_copies(bandwidth: int, decay: float, rng: np.random.Generator) -> None:
    source = smooth(rng, bandwidth, decay)
    rotation = Rotation.random(rng=rng).as_matrix()
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, rotation))
    # The last step's square, 1e-12, and rounding.
    assert angle(found.rotation, rotation) < 1e-9
    assert found.correlation == pytest.approx(1, abs=1e-12)
    assert not found.reflected
    assert (found.curvature > 0).all()
    assert (np.diff(found.correlations) <= 0).all()
    assert np.linalg.norm(found.rotation.T @ found.rotation - np.eye(3)) < 1e-13


@given(seed=st.integers(0, 2**31), b=st.integers(3, 10), functions=st.integers(2, 5))
def test_any_exact_copy(seed: int, b: int, functions: int) -> None:
    rng = np.random.default_rng(seed)
    source = smooth(rng, b, rng.uniform(0, 3), functions)
    rotation = Rotation.random(rng=rng).as_matrix()
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, rotation))
    assert angle(found.rotation, rotation) < 1e-8


def test_a_single_function_without_batch_axes(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    source = smooth(rng, 8, 1.0, 1)[0]
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, random_rotation))
    assert angle(found.rotation, random_rotation) < 1e-9


@pytest.mark.parametrize("degree", [3, 5, 8, 11, 20])
def test_functions_of_one_degree(degree: int, rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    source = np.zeros((2, (degree + 2) ** 2))
    source[:, degree**2 : (degree + 1) ** 2] = rng.standard_normal((2, 2 * degree + 1))
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, random_rotation))
    assert found.correlation == pytest.approx(1, abs=1e-12)
    assert angle(found.rotation, random_rotation) < 1e-9


@pytest.mark.parametrize("special", [*CUBE_GROUP[:8], Rotation.from_rotvec([0, 1e-9, 0]).as_matrix()])
def test_rotations_where_euler_angles_are_singular(special: np.ndarray, rng: np.random.Generator) -> None:
    source = smooth(rng, 12)
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, special))
    assert angle(found.rotation, special) < 1e-9


def test_exchange_gives_the_inverse(rng: np.random.Generator) -> None:
    """Of unrelated functions too, where several maxima are nearly as high."""
    for bandwidth in (4, 8, 16, 20):
        source, target = smooth(rng, bandwidth), smooth(rng, bandwidth)
        there, back = fsh.estimate_rotation(source, target), fsh.estimate_rotation(target, source)
        # Local maxima are found to the square of 1e-6, times the ratio of curvatures.
        assert angle(there.rotation, back.rotation.T) < 1e-7
        assert there.correlation == pytest.approx(back.correlation, abs=1e-10)


def test_equivariance(rng: np.random.Generator) -> None:
    source, target = smooth(rng, 16), smooth(rng, 16)
    one, two = Rotation.random(2, rng=rng).as_matrix()
    plain = fsh.estimate_rotation(source, target)
    turned = fsh.estimate_rotation(fsh.rotate_coefficients(source, one), fsh.rotate_coefficients(target, two))
    assert turned.correlation == pytest.approx(plain.correlation, abs=1e-10)
    assert angle(turned.rotation, two @ plain.rotation @ one.T) < 1e-7


def test_correlation_is_what_it_says(rng: np.random.Generator) -> None:
    source, target = smooth(rng, 10), smooth(rng, 10)
    found = fsh.estimate_rotation(source, target, maxima=3)
    varying = source[:, 1:], target[:, 1:]
    norm = np.linalg.norm(varying[0]) * np.linalg.norm(varying[1])
    for rotation, correlation in zip(found.rotations, found.correlations, strict=True):
        turned = fsh.rotate_coefficients(source, rotation)[:, 1:]
        assert correlation == pytest.approx(np.sum(turned * varying[1]) / norm, abs=1e-12)
    assert found.margin == pytest.approx(found.correlations[0] - found.correlations[1])
    # No random rotation does better.
    values = [
        np.sum(fsh.rotate_coefficients(source, r)[:, 1:] * varying[1])
        for r in Rotation.random(300, rng=rng).as_matrix()
    ]
    assert max(values) / norm < found.correlation


def test_size_and_mean_do_not_matter(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    source = smooth(rng, 8)
    target = fsh.rotate_coefficients(source, random_rotation)
    for factor, offset in ((1e-200, 0.0), (1e200, 0.0), (1.0, 1e6)):
        found = fsh.estimate_rotation(factor * source, 3 * target + offset * (np.arange(64) == 0))
        assert angle(found.rotation, random_rotation) < 1e-9


def test_reflections(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    source = smooth(rng, 9)
    target = fsh.rotate_coefficients(fsh.reflect_coefficients(source), random_rotation)
    without = fsh.estimate_rotation(source, target)
    assert not without.reflected
    assert without.correlation < 0.95
    found = fsh.estimate_rotation(source, target, reflections=True)
    assert found.reflected
    assert found.correlation == pytest.approx(1, abs=1e-12)
    # The reflection through the origin and the rotation: determinant −1.
    assert np.abs(found.rotation + random_rotation).max() < 1e-9
    plain = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, random_rotation), reflections=True)
    assert not plain.reflected
    assert angle(plain.rotation, random_rotation) < 1e-9


def test_a_cube_has_24_maxima(random_rotation: np.ndarray) -> None:
    source = cubic()
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, random_rotation), maxima=30)
    best = found.correlations > 1 - 1e-9
    assert np.count_nonzero(best) == 24
    assert found.margin == pytest.approx(0, abs=1e-12)
    for symmetry in CUBE_GROUP:
        nearest = min(angle(rotation, random_rotation @ symmetry) for rotation in found.rotations[best])
        assert nearest < 1e-7


def test_an_ellipsoid_has_four_maxima(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    transform = fsh.SphericalHarmonicTransform(16)
    radii = 1 / np.linalg.norm(transform.grid.directions / [1.0, 1.4, 2.0], axis=1)
    source = transform.forward(radii)
    found = fsh.estimate_rotation(source, fsh.rotate_coefficients(source, random_rotation), maxima=6)
    assert np.count_nonzero(found.correlations > 1 - 1e-9) == 4


def test_bodies_of_revolution_are_flat_about_their_axis(random_rotation: np.ndarray) -> None:
    transform = fsh.SphericalHarmonicTransform(12)
    height = transform.grid.directions[:, 2]
    source = transform.forward(np.exp(height) + height**3)
    target = fsh.rotate_coefficients(source, random_rotation)
    found = fsh.estimate_rotation(source, target)
    assert found.correlation == pytest.approx(1, abs=1e-12)
    assert np.abs(found.rotation[:, 2] - random_rotation[:, 2]).max() < 1e-7
    assert abs(found.curvature[0]) < 1e-12
    assert found.curvature[1] > 1


def test_different_bandwidths_count_up_to_the_smaller(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    source = smooth(rng, 16)
    target = fsh.rotate_coefficients(source, random_rotation)
    short = fsh.estimate_rotation(fsh.truncate(source, 9), target)
    both = fsh.estimate_rotation(fsh.truncate(source, 9), fsh.truncate(target, 9))
    asked = fsh.estimate_rotation(source, target, bandwidth=9)
    assert np.array_equal(short.rotation, both.rotation)
    assert np.array_equal(asked.rotation, both.rotation)
    assert angle(short.rotation, random_rotation) < 1e-9


@pytest.mark.parametrize(("noise", "limit"), [(0.05, 0.5), (0.3, 3.0), (1.0, 12.0)])
def test_noise(noise: float, limit: float, rng: np.random.Generator) -> None:
    """Errors in degrees grow with the noise, and stay small where it is as large as the signal."""
    for _ in range(8):
        source = smooth(rng, 16, 1.5, 8)
        rotation = Rotation.random(rng=rng).as_matrix()
        target = fsh.rotate_coefficients(source, rotation) + noise * smooth(rng, 16, 1.5, 8)
        found = fsh.estimate_rotation(source, target)
        # Noise moves the maximum by about noise / √(8 · 256 · mean l²/3); limits are several times that.
        assert np.degrees(angle(found.rotation, rotation)) < limit
        # Two parts of independent noise of this size leave 1/√(1 + noise²) of the correlation.
        assert found.correlation == pytest.approx((1 + noise**2) ** -0.5, abs=0.1)


def test_results_are_read_only(rng: np.random.Generator) -> None:
    found = fsh.estimate_rotation(smooth(rng, 4), smooth(rng, 4))
    for array in (found.rotation, found.rotations, found.correlations, found.curvature):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_same_input_same_bytes(rng: np.random.Generator) -> None:
    source, target = smooth(rng, 16), smooth(rng, 16)
    first, again = (fsh.estimate_rotation(source, target) for _ in range(2))
    assert first.rotations.tobytes() == again.rotations.tobytes()
    assert first.curvature.tobytes() == again.curvature.tobytes()


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        (
            np.ones((2, 9)),
            np.ones((3, 9)),
            r"the same functions, got shapes \(2, 9\) and \(3, 9\); take the same number",
        ),
        (np.ones(9), np.ones((1, 9)), "the same functions"),
        (np.zeros(16), np.ones(16), "source is constant on the sphere"),
        (np.ones(16), np.zeros(16), "target is constant on the sphere"),
        (np.eye(16)[0], np.ones(16), "source is constant on the sphere"),
        (1e9 * np.eye(16)[0] + 1e-3, np.ones(16), "source is constant on the sphere"),
        (np.ones(1), np.ones(1), "source is constant on the sphere"),
        (np.ones(16), np.ones(1), "is constant on the sphere"),
        (np.ones((0, 9)), np.ones((0, 9)), "source is constant on the sphere"),
        (np.ones(8), np.ones(8), "source must have shape"),
        (np.ones(9), np.full(9, np.nan), "target must be finite"),
    ],
)
def test_bad_functions(source: np.ndarray, target: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fsh.estimate_rotation(source, target)


def test_bad_options() -> None:
    for options in ({"maxima": 0}, {"maxima": 61}, {"bandwidth": 0}):
        with pytest.raises(ValueError, match="must be between"):
            fsh.estimate_rotation(np.ones(9), np.ones(9), **options)  # type: ignore[arg-type]


# Many sources against one target.


def test_batch_finds_exact_copies(rng: np.random.Generator) -> None:
    target = smooth(rng, 8, 1.5, 6)
    rotations = Rotation.random(60, rng=rng).as_matrix()
    sources = np.stack([fsh.rotate_coefficients(target, rotation.T) for rotation in rotations])
    found, values = fsh.estimate_rotations(sources, target, steps=8)
    assert max(angle(one, other) for one, other in zip(found, rotations, strict=True)) < 1e-6
    assert values == pytest.approx(np.sum(target**2), rel=1e-12)
    # Three steps are enough for ranking.
    _, quick = fsh.estimate_rotations(sources, target)
    assert quick == pytest.approx(np.sum(target**2), rel=1e-4)


def test_batch_is_its_singles(rng: np.random.Generator) -> None:
    sources, target = rng.standard_normal((60, 5, 49)), rng.standard_normal((5, 49))
    rotations, values = fsh.estimate_rotations(sources, target)
    for index in (0, 17, 24, 59):
        alone = fsh.estimate_rotations(sources[index : index + 1], target)
        # Sums in another order, and four steps that amplify them.
        assert np.abs(alone[0][0] - rotations[index]).max() < 1e-8
        assert alone[1][0] == pytest.approx(values[index], rel=1e-12)
        turned = fsh.rotate_coefficients(sources[index], rotations[index])
        assert np.sum(turned * target) == pytest.approx(values[index], rel=1e-12)


def test_batch_agrees_with_the_thorough_search(rng: np.random.Generator) -> None:
    sources, target = np.stack([smooth(rng, 8) for _ in range(20)]), smooth(rng, 8)
    sources[:, :, 0] = target[:, 0] = 0
    _, values = fsh.estimate_rotations(sources, target, steps=20)
    best = [
        fsh.estimate_rotation(one, target).correlation * np.linalg.norm(one) * np.linalg.norm(target) for one in sources
    ]
    # From one start only: the neighbouring maximum may be taken, a little lower.
    assert (values <= np.array(best) + 1e-9).all()
    assert (values > 0.97 * np.array(best)).all()
    assert np.mean(values > np.array(best) * (1 - 1e-9)) >= 0.8


def test_batch_threads_do_not_change_a_byte(rng: np.random.Generator) -> None:
    sources, target = rng.standard_normal((100, 3, 64)), rng.standard_normal((3, 64))
    rotations, values = fsh.estimate_rotations(sources, target, threads=1)
    for threads in (2, 5, None):
        again = fsh.estimate_rotations(sources, target, threads=threads)
        assert again[0].tobytes() == rotations.tobytes()
        assert again[1].tobytes() == values.tobytes()


def test_batch_of_what_has_no_orientation(rng: np.random.Generator) -> None:
    """Constants and zeros are not refused: in a ranking they are candidates like others."""
    target = rng.standard_normal((2, 25))
    sources = np.zeros((3, 2, 25))
    sources[1, :, 0] = 2.0
    rotations, values = fsh.estimate_rotations(sources, target)
    assert values == pytest.approx([0, 2 * target[:, 0].sum(), 0], abs=1e-12)
    for rotation in rotations:
        assert np.linalg.norm(rotation @ rotation.T - np.eye(3)) < 1e-12
    nothing = fsh.estimate_rotations(np.empty((0, 2, 25)), target)
    assert nothing[0].shape == (0, 3, 3)
    assert nothing[1].shape == (0,)


def test_batch_in_single_precision(rng: np.random.Generator) -> None:
    sources, target = rng.standard_normal((4, 3, 36)), rng.standard_normal((3, 36))
    rotations, values = fsh.estimate_rotations(sources.astype(np.float32), target.astype(np.float32))
    assert rotations.dtype == values.dtype == np.float64
    assert values == pytest.approx(fsh.estimate_rotations(sources, target)[1], rel=1e-5)


@pytest.mark.parametrize(
    ("sources", "target", "message"),
    [
        (np.ones((2, 9)), np.ones((2, 9)), r"sources must have shape \(n, S, b²\) and target \(S, b²\)"),
        (np.ones((4, 2, 9)), np.ones((3, 9)), "sources must have shape"),
        (np.ones((4, 2, 9)), np.ones((2, 16)), "sources must have shape"),
        (np.ones((4, 2, 9)), np.ones((2, 8)), "target must have shape"),
        (np.full((4, 2, 9), np.inf), np.ones((2, 9)), "sources must be finite"),
    ],
)
def test_bad_batches(sources: np.ndarray, target: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fsh.estimate_rotations(sources, target)
