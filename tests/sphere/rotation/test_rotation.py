"""Rotation of coefficients: against re-sampling and single harmonics, group laws, near and at the singular angles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere.rotation.rotation import parity
from tests.sphere.oracles import real_harmonics, relative_l2, scattered

UNIT = Rotation.from_rotvec
# β = 0 and π exactly, and nearly.
SPECIAL = {
    "identity": np.eye(3),
    "half turn x": np.diag([1.0, -1.0, -1.0]),
    "half turn y": np.diag([-1.0, 1.0, -1.0]),
    "half turn z": np.diag([-1.0, -1.0, 1.0]),
    "quarter turn": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "about z": UNIT([0, 0, 0.7]).as_matrix(),
    "beta nearly 0": (UNIT([0, 0, 0.4]) * UNIT([0, 1e-9, 0]) * UNIT([0, 0, 1.1])).as_matrix(),
    "beta nearly pi": (UNIT([0, 0, 0.4]) * UNIT([0, np.pi - 1e-9, 0]) * UNIT([0, 0, 1.1])).as_matrix(),
    "beta pi, turned": (UNIT([0, np.pi, 0]) * UNIT([0, 0, 0.9])).as_matrix(),
}


def rotation_of(seed: int) -> np.ndarray:
    return np.asarray(Rotation.random(rng=np.random.default_rng(seed)).as_matrix())


@pytest.mark.parametrize("bandwidth", [1, 2, 3, 8, 21, 64])
def test_is_resampling(bandwidth: int, rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    coefficients = rng.standard_normal((2, bandwidth**2))
    directions = scattered(rng, 50)
    turned = fsh.evaluate(fsh.rotate_coefficients(coefficients, random_rotation), directions)
    # f'(ω) = f(Rᵀω); rows are directions, so Rᵀω is ω @ R. Evaluation by NUFFT is good to 4e-13.
    assert relative_l2(turned, fsh.evaluate(coefficients, directions @ random_rotation)) < 1e-12


@pytest.mark.parametrize("name", SPECIAL)
def test_is_resampling_at_special_rotations(name: str, rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal(144)
    directions = scattered(rng, 60)
    turned = real_harmonics(directions, 12) @ fsh.rotate_coefficients(coefficients, SPECIAL[name])
    expected = real_harmonics(directions @ SPECIAL[name], 12) @ coefficients
    # scipy's harmonics near 1e-14; 144 terms.
    assert relative_l2(turned, expected) < 1e-13


def test_bandwidth_256(random_rotation: np.ndarray, rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal(256**2)
    turned = fsh.rotate_coefficients(coefficients, random_rotation)
    directions = scattered(rng, 40)
    # NUFFT at b = 256 is good to 2.5e-13, and rounding of directions moves degree 255 by 1e-13.
    assert (
        relative_l2(fsh.evaluate(turned, directions), fsh.evaluate(coefficients, directions @ random_rotation)) < 2e-12
    )
    energies = fsh.degree_energies(coefficients)
    assert np.abs(fsh.degree_energies(turned) / energies - 1).max() < 1e-13
    back = fsh.rotate_coefficients(turned, random_rotation.T)
    assert relative_l2(back, coefficients) < 1e-12  # angles of order one, times degree, times rounding


def test_linear_functions_turn_as_vectors(random_rotation: np.ndarray) -> None:
    """x, y, z have the indices 3, 1, 2: the coefficients of degree 1 are a vector."""
    vector = np.array([0.3, -1.2, 2.0])
    coefficients = np.array([5.0, vector[1], vector[2], vector[0]])
    turned = fsh.rotate_coefficients(coefficients, random_rotation)
    assert turned[[3, 1, 2]] == pytest.approx(random_rotation @ vector, abs=1e-14)
    assert turned[0] == pytest.approx(5.0, abs=1e-14)


@pytest.mark.parametrize(("degree", "order"), [(1, 0), (2, -2), (5, 3), (9, -9), (9, 0)])
def test_single_harmonics(degree: int, order: int, random_rotation: np.ndarray, rng: np.random.Generator) -> None:
    coefficients = np.zeros(100)
    coefficients[degree**2 + degree + order] = 1.0
    turned = fsh.rotate_coefficients(coefficients, random_rotation)
    # Nothing leaks into other degrees, and the function is the harmonic in turned directions.
    outside = np.ones(100, dtype=bool)
    outside[degree**2 : (degree + 1) ** 2] = False
    assert not turned[outside].any()
    directions = scattered(rng, 30)
    expected = real_harmonics(directions @ random_rotation, degree + 1)[:, degree**2 + degree + order]
    assert real_harmonics(directions, 10) @ turned == pytest.approx(expected, abs=1e-13)


@given(angle=st.floats(-7, 7), b=st.integers(1, 12), seed=st.integers(0, 2**31))
def test_about_z_orders_turn_among_themselves(angle: float, b: int, seed: int) -> None:
    coefficients = np.random.default_rng(seed).standard_normal(b * b)
    turned = fsh.rotate_coefficients(coefficients, UNIT([0, 0, angle]).as_matrix())
    degree, order = fsh.degrees_and_orders(b)
    mirrored = coefficients[degree**2 + degree - order]
    # cos m(φ − α) = cos mα cos mφ + sin mα sin mφ, and the same for the sine with the other sign.
    expected = np.cos(order * angle) * coefficients - np.sin(order * angle) * mirrored
    # The matrix rounds the angle to 1e-15, times the order.
    assert np.abs(turned - expected).max() < 1e-13


@given(first=st.integers(0, 2**31), second=st.integers(0, 2**31), b=st.integers(1, 24))
def test_composition_and_inverse(first: int, second: int, b: int) -> None:
    coefficients = np.random.default_rng(first).standard_normal((2, b * b))
    one, two = rotation_of(first), rotation_of(second)
    turned = fsh.rotate_coefficients(fsh.rotate_coefficients(coefficients, one), two)
    # Rounding of matrices and angles, times degree 23.
    assert np.abs(turned - fsh.rotate_coefficients(coefficients, two @ one)).max() < 2e-13
    back = fsh.rotate_coefficients(fsh.rotate_coefficients(coefficients, one), one.T)
    assert np.abs(back - coefficients).max() < 2e-13


@given(seed=st.integers(0, 2**31), b=st.integers(1, 40))
def test_energies_are_kept(seed: int, b: int) -> None:
    coefficients = np.random.default_rng(seed).standard_normal((3, b * b))
    turned = fsh.rotate_coefficients(coefficients, rotation_of(seed))
    assert np.abs(fsh.degree_energies(turned) / fsh.degree_energies(coefficients) - 1).max() < 1e-13


def test_identity(rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal((2, 400))
    # Two rotations by opposite angles at worst.
    assert np.abs(fsh.rotate_coefficients(coefficients, np.eye(3)) - coefficients).max() < 1e-13


@pytest.mark.parametrize("angle", [1e-12, 1e-10, 1e-8, 1e-6])
def test_near_the_identity_coefficients_move_by_the_angle(angle: float, rng: np.random.Generator) -> None:
    bandwidth, axis = 16, rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    coefficients = rng.standard_normal(bandwidth**2)
    turned = fsh.rotate_coefficients(coefficients, UNIT(angle * axis).as_matrix())
    transform = fsh.SphericalHarmonicTransform(bandwidth)
    directions = transform.grid.directions
    # df'/dangle = −∇f · (axis × ω)
    slope = -np.einsum("ij,ij->i", fsh.evaluate_gradient(coefficients, directions), np.cross(axis, directions))
    change = turned - coefficients
    # Second order (15 angle)², and rounding of the coefficients and of Euler angles.
    assert np.linalg.norm(change - angle * transform.forward(slope)) < 1e3 * angle**2 + 1e-12


def test_single_precision(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    coefficients = rng.standard_normal((3, 256))
    turned = fsh.rotate_coefficients(coefficients.astype(np.float32), random_rotation)
    assert turned.dtype == np.float32
    # 24 bits.
    assert relative_l2(turned, fsh.rotate_coefficients(coefficients, random_rotation)) < 1e-6
    assert fsh.rotate_coefficients(np.arange(4), random_rotation.astype(np.float32)).dtype == np.float64


def test_batches_are_their_functions(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    coefficients = rng.standard_normal((3, 7, 36))
    kept = coefficients.copy()
    turned = fsh.rotate_coefficients(coefficients, random_rotation)
    assert turned.shape == coefficients.shape
    assert np.array_equal(coefficients, kept)
    for index in ((0, 0), (2, 6), (1, 3)):
        assert turned[index] == pytest.approx(fsh.rotate_coefficients(coefficients[index], random_rotation), abs=1e-14)
    assert fsh.rotate_coefficients(np.empty((0, 9)), random_rotation).shape == (0, 9)


def test_threads_do_not_change_a_byte(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    coefficients = rng.standard_normal((70, 400))
    one = fsh.rotate_coefficients(coefficients, random_rotation, threads=1)
    for threads in (2, 3, None):
        assert fsh.rotate_coefficients(coefficients, random_rotation, threads=threads).tobytes() == one.tobytes()


def test_reflection(rng: np.random.Generator) -> None:
    coefficients = rng.standard_normal((2, 64))
    directions = scattered(rng, 40)
    reflected = fsh.reflect_coefficients(coefficients)
    expected = fsh.evaluate(coefficients, -directions)
    assert np.abs(fsh.evaluate(reflected, directions) - expected).max() < 1e-12
    assert np.array_equal(fsh.reflect_coefficients(reflected), coefficients)
    assert parity(3).tolist() == [1, -1, -1, -1, 1, 1, 1, 1, 1]
    assert fsh.reflect_coefficients(coefficients.astype(np.float32)).dtype == np.float32


def test_a_mirror_is_a_half_turn_and_the_reflection(rng: np.random.Generator) -> None:
    coefficients, directions = rng.standard_normal(49), scattered(rng, 40)
    mirrored = fsh.reflect_coefficients(fsh.rotate_coefficients(coefficients, np.diag([-1.0, -1.0, 1.0])))
    expected = fsh.evaluate(coefficients, directions * [1, 1, -1])
    assert np.abs(fsh.evaluate(mirrored, directions) - expected).max() < 1e-12


@pytest.mark.parametrize(
    ("rotation", "message"),
    [
        (np.eye(2), r"rotation must have shape \(3, 3\), got \(2, 2\)"),
        (np.eye(4), r"rotation must have shape \(3, 3\)"),
        (np.stack([np.eye(3)] * 2), r"rotation must have shape \(3, 3\)"),
        (2 * np.eye(3), "must be a rotation matrix, but R Rᵀ differs from the identity by 3"),
        (np.eye(3) + 1e-5, "must be a rotation matrix"),
        (np.zeros((3, 3)), "must be a rotation matrix"),
        (np.diag([1.0, 1.0, -1.0]), "a reflection"),
        (-np.eye(3), "a reflection"),
        (np.full((3, 3), np.nan), "rotation must be finite"),
        (np.full((3, 3), 1e300), "must be a rotation matrix"),
    ],
)
def test_what_is_no_rotation_is_refused(rotation: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fsh.rotate_coefficients(np.ones(9), rotation)


@pytest.mark.parametrize("coefficients", [np.ones(8), np.ones((2, 0)), 1.0, [1, np.nan, 0, 0], [np.inf]])
def test_malformed_coefficients_are_refused(coefficients: object) -> None:
    with pytest.raises(ValueError, match="coefficients must"):
        fsh.rotate_coefficients(coefficients, np.eye(3))
    with pytest.raises(ValueError, match="coefficients must"):
        fsh.reflect_coefficients(coefficients)


def test_words_are_refused() -> None:
    with pytest.raises(TypeError, match="rotation must be an array of real numbers"):
        fsh.rotate_coefficients(np.ones(4), "upside down")
    with pytest.raises(ValueError, match="threads must be between"):
        fsh.rotate_coefficients(np.ones(4), np.eye(3), threads=0)


def test_slightly_skew_matrices_are_straightened(rng: np.random.Generator, random_rotation: np.ndarray) -> None:
    """Matrices read from files with seven digits are rotations; energies are kept nevertheless."""
    coefficients = rng.standard_normal(256)
    turned = fsh.rotate_coefficients(coefficients, np.round(random_rotation, 7))
    assert np.abs(fsh.degree_energies(turned) / fsh.degree_energies(coefficients) - 1).max() < 1e-13
    # Off by up to 1e-7 rad, times degree 15.
    assert relative_l2(turned, fsh.rotate_coefficients(coefficients, random_rotation)) < 3e-6
