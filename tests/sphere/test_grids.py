"""Grids against their published formulas, written out again in exact or long arithmetic."""

from __future__ import annotations

import dataclasses
import tracemalloc
from fractions import Fraction
from math import isqrt

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import fsh3d_o3d as fsh
from fsh3d_o3d import _validation
from fsh3d_o3d.errors import MemoryEstimateError
from fsh3d_o3d.sphere.grids import grid_size, locked_directions
from tests.sphere.oracles import scattered

ALL = {
    "fibonacci": fsh.fibonacci_grid(4096),
    "equiangular": fsh.equiangular_grid(32),
    "healpix": fsh.healpix_grid(20),
    "icosahedral": fsh.icosahedral_grid(3),
    "cube": fsh.cube_grid(28),
}
GOLDEN = Fraction(isqrt(5 * 10**120) - 10**60, 2 * 10**60)  # τ to 60 digits


def exact_fibonacci(n: int, i: int) -> tuple[Fraction, Fraction]:
    """z and the longitude in turns of point i, as fractions."""
    d = Fraction(1 - n, 2) + i
    turns = d * GOLDEN
    return -2 * d / n, turns - turns.__floor__()


@pytest.mark.parametrize("n", [4_000_000, 4_000_001])
def test_fibonacci_is_exact_at_four_million_points(n: int, rng: np.random.Generator) -> None:
    grid = fsh.fibonacci_grid(n)
    index = np.concatenate([[0, 1, n // 2 - 1, n // 2, n - 2, n - 1], rng.integers(0, n, 300)])
    exact = [exact_fibonacci(n, int(i)) for i in index]
    z = np.array([float(z) for z, _ in exact])
    longitude = 2 * np.pi * np.array([float(turns) for _, turns in exact])
    sine = np.sqrt([float(1 - z * z) for z, _ in exact])
    # A few roundings of numbers up to 2π and up to 1.
    assert np.abs(grid.longitude[index] - longitude).max() < 4e-15
    assert np.abs(grid.directions[index, 2] - z).max() < 3e-16
    expected = np.stack([sine * np.cos(longitude), sine * np.sin(longitude)], axis=1)
    assert np.abs(grid.directions[index, :2] - expected).max() < 2e-15


@pytest.mark.parametrize("n", [1, 2, 3, 16, 33])
def test_fibonacci_is_equation_4(n: int) -> None:
    """θ = asin(2d/n) + π/2 and φ = 2π·frac(dτ) in 40 digits."""
    grid = fsh.fibonacci_grid(n)
    with mpmath.workdps(40):
        tau = (mpmath.sqrt(5) - 1) / 2
        d = [mpmath.mpf(1 - n) / 2 + i for i in range(n)]
        theta = np.array([float(mpmath.asin(2 * x / n) + mpmath.pi / 2) for x in d])
        phi = np.array([float(2 * mpmath.pi * (x * tau - mpmath.floor(x * tau))) for x in d])
    assert np.abs(grid.colatitude - theta).max() < 1e-15  # an arctangent and a subtraction from π
    assert np.abs(grid.longitude - phi).max() < 3e-15


@pytest.mark.parametrize(("name", "count"), list(zip(ALL, [4096, 4096, 4800, 5762, 4704], strict=True)))
def test_sizes_and_names_of_figure_3(name: str, count: int) -> None:
    assert len(ALL[name]) == count
    assert ALL[name].name == name


@pytest.mark.parametrize("name", ALL)
def test_arrays_agree_and_are_frozen(name: str) -> None:
    grid = ALL[name]
    theta, phi = grid.colatitude, grid.longitude
    again = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    assert np.abs(again - grid.directions).max() < 2e-15  # sines and cosines of rounded angles
    assert np.abs(np.linalg.norm(grid.directions, axis=1) - 1).max() < 1e-15
    assert theta.min() >= 0 and theta.max() <= np.pi
    assert phi.min() >= 0 and phi.max() < 2 * np.pi
    kept = grid.directions
    for array in (theta, phi):
        with pytest.raises(ValueError, match=r"read-only"):
            array[0] = 0.0
    grid.directions[0] = 0.0  # a copy
    assert (grid.directions == kept).all() and kept.dtype == theta.dtype == phi.dtype == np.float64
    with pytest.raises(dataclasses.FrozenInstanceError):
        grid.name = "other"  # type: ignore[misc]


@pytest.mark.parametrize("name", ALL)
def test_points_are_distinct_and_balanced(name: str) -> None:
    grid = ALL[name]
    distance, _ = cKDTree(grid.directions).query(grid.directions, k=2)
    assert distance[:, 1].min() > 0
    # Each grid has a symmetry that puts its centre of mass at the origin; Fibonacci's has two of three coordinates.
    assert np.abs(grid.directions.mean(axis=0)).max() < (2e-4 if name == "fibonacci" else 1e-14)


@given(n=st.integers(1, 3000))
def test_fibonacci_reversed_is_the_half_turn(n: int) -> None:
    grid = fsh.fibonacci_grid(n)
    assert np.array_equal(grid.directions[::-1] * [1, -1, -1], grid.directions)  # to the last bit
    assert grid.half_turn_symmetric


def test_equiangular_has_the_half_turn_symmetry() -> None:
    asymmetric = [b for b in range(1, 65) if not fsh.equiangular_grid(b).half_turn_symmetric]
    assert asymmetric == []


def test_other_grids_do_not_claim_the_symmetry(rng: np.random.Generator) -> None:
    assert not fsh.grid_from_directions(scattered(rng, 50)).half_turn_symmetric


def test_fibonacci_is_uniform() -> None:
    """Nearest neighbours at 3.09/√n at least, caps of any place and size hold their share of the points."""
    n = 4096
    directions = fsh.fibonacci_grid(n).directions
    distance, _ = cKDTree(directions).query(directions, k=2)
    assert distance[:, 1].min() * np.sqrt(n) > 3.05
    assert distance[:, 1].max() / distance[:, 1].min() < 1.35
    centres = fsh.fibonacci_grid(157).directions
    heights = np.linspace(-0.95, 0.95, 20)
    share = (centres @ directions.T)[:, :, None] > heights
    # A cap's share is exact up to a fraction of the points along its rim; random points miss by 0.02.
    assert np.abs(share.mean(axis=1) - (1 - heights) / 2).max() < 0.005


@pytest.mark.parametrize("b", [1, 3, 32])
def test_equiangular_formula(b: int) -> None:
    grid = fsh.equiangular_grid(b)
    j, k = np.divmod(np.arange(4 * b * b), 2 * b)
    assert np.array_equal(grid.colatitude, np.pi * (2 * j + 1) / (4 * b))
    assert np.array_equal(grid.longitude, np.pi * (2 * k + 1) / (2 * b))


def healpix_centres(nside: int) -> np.ndarray:
    """Ring by ring, Górski et al. 2005, equations (4)–(9)."""
    z, phi = [], []
    for i in range(1, 4 * nside):
        cap = min(i, 4 * nside - i)
        if cap < nside:
            count, height, shift = 4 * cap, 1 - cap**2 / (3 * nside**2), 0.5
            z += [height if i < nside else -height] * count
        else:
            count, shift = 4 * nside, 1 - ((i - nside + 1) % 2) / 2  # 1 for 0: rings start at longitude 0
            z += [4 / 3 - 2 * i / (3 * nside)] * count
        phi += [2 * np.pi / count * (j - shift) for j in range(1, count + 1)]
    height, turn = np.array(z), np.array(phi)
    sine = np.sqrt(1 - height**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), height], axis=1)


@pytest.mark.parametrize("nside", [1, 3, 8, 20])
def test_healpix_formula(nside: int) -> None:
    # √(1 − z²) from z loses four digits next to the poles; ducc0 avoids that.
    assert np.abs(fsh.healpix_grid(nside).directions - healpix_centres(nside)).max() < 1e-13


@pytest.mark.parametrize("level", [0, 1, 2])
def test_icosahedral_symmetry(level: int) -> None:
    """90·4^k + 2 points; a fifth of a turn about the polar corner and the point reflection keep the set."""
    directions = fsh.icosahedral_grid(level).directions
    assert len(directions) == 90 * 4**level + 2
    turn = 2 * np.pi / 5
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    for image in (directions @ rotation.T, -directions):
        assert cKDTree(directions).query(image)[0].max() < 1e-14


@pytest.mark.parametrize("k", [1, 4, 7])
def test_cube_cells_are_equally_wide_in_angle(k: int) -> None:
    directions = fsh.cube_grid(k).directions
    front = directions[directions[:, 0] > np.abs(directions[:, 1:]).max(axis=1) * (1 - 1e-12)]
    assert len(front) == k * k
    steps = -np.pi / 4 + np.pi / (2 * k) * (np.arange(k) + 0.5)
    for axis in (1, 2):
        angle = np.sort(np.arctan2(front[:, axis], front[:, 0]))
        assert np.abs(angle - np.repeat(steps, k)).max() < 4e-15
    for image in (directions[:, [1, 2, 0]], directions[:, [1, 0, 2]], -directions):
        assert cKDTree(directions).query(image)[0].max() < 1e-14


def test_grid_from_directions_angles() -> None:
    tiny = 1e-9
    grid = fsh.grid_from_directions([[0, 0, 1], [0, 0, -1], [tiny, 0, 1], [0, -1, 0], [1, -1e-300, 0]])
    assert grid.colatitude.tolist() == [0, np.pi, tiny, np.pi / 2, np.pi / 2]
    # The last longitude is a tiny negative angle, whose remainder would round up to 2π.
    assert grid.longitude.tolist() == [0, 0, 0, 1.5 * np.pi, 0]
    assert grid.name == "scattered"


def test_grid_from_directions_leaves_the_callers_array_alone(rng: np.random.Generator) -> None:
    given_directions = scattered(rng, 20) * (1 + 4e-7)
    before = given_directions.copy()
    grid = fsh.grid_from_directions(given_directions, name="mine")
    given_directions[0] = 7.0  # still writeable, and not shared
    assert np.abs(grid.directions - before / np.linalg.norm(before, axis=1)[:, None]).max() < 3e-16
    assert grid.name == "mine"


def test_constructor_leaves_the_callers_arrays_writeable() -> None:
    theta = np.array([0.0])
    grid = fsh.SphericalGrid(np.array([[0.0, 0.0, 1.0]]), theta, np.array([0.0]), "one")
    theta[0] = 1.0  # raises if the grid froze the caller's own array
    assert grid.colatitude.tolist() == [0.0]


def test_nothing_is_copied_that_is_only_read() -> None:
    grid = fsh.fibonacci_grid(60_000)  # 1.4 MB of directions
    half = fsh.SphericalGrid(
        locked_directions(grid)[:30_000], grid.colatitude[:30_000], grid.longitude[:30_000], "half"
    )
    assert np.shares_memory(locked_directions(half), locked_directions(grid))
    assert not np.shares_memory(half.directions, locked_directions(grid))
    tracemalloc.start()
    try:
        assert len(grid) == 60_000
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_fingerprint_tells_grids_apart() -> None:
    grid = fsh.fibonacci_grid(100)
    copy = fsh.SphericalGrid(*(a.copy() for a in (grid.directions, grid.colatitude, grid.longitude)), "copy")
    assert grid.fingerprint == copy.fingerprint
    assert grid.fingerprint != fsh.fibonacci_grid(101).fingerprint
    assert grid.fingerprint != fsh.grid_from_directions(grid.directions[::-1]).fingerprint
    assert len(grid.fingerprint) == 64


def test_size_for_a_bandwidth() -> None:
    assert grid_size(32) == 6144
    assert grid_size(32, 1) == 4096
    assert grid_size(3, 1.1) == 40  # rounded up: never below 4b²
    with pytest.raises(ValueError, match=r"oversampling must be >= 1 and <= 1000, got 0.9"):
        grid_size(8, 0.9)
    with pytest.raises(TypeError, match=r"oversampling must be a number, got str 'x'"):
        grid_size(8, "x")  # type: ignore[arg-type]


MAKERS = [fsh.fibonacci_grid, fsh.equiangular_grid, fsh.healpix_grid, fsh.cube_grid]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("bad", [0, -3, 10**9])
def test_sizes_out_of_range(make: object, bad: int) -> None:
    with pytest.raises(ValueError, match=rf"must be between 1 and \d+, got {bad}"):
        make(bad)  # type: ignore[operator]


@pytest.mark.parametrize("make", [*MAKERS, fsh.icosahedral_grid])
@pytest.mark.parametrize("bad", [3.0, "3", None, True])
def test_sizes_of_wrong_type(make: object, bad: object) -> None:
    make(3)  # type: ignore[operator]
    make(np.int64(3))  # type: ignore[operator]  # an equal value in the function's cache must not let the float through
    with pytest.raises(TypeError, match=r"must be an integer, got"):
        make(bad)  # type: ignore[operator]


def test_icosahedral_level_out_of_range() -> None:
    with pytest.raises(ValueError, match=r"level must be between 0 and 8, got 9"):
        fsh.icosahedral_grid(9)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ([[1.0, 0.0]], r"shape \(n, 3\)"),
        (np.zeros((0, 3)), r"n >= 1, got \(0, 3\)"),
        ([[0.0, 0.0, 2.0]], r"unit vectors.*\[2, 2\].*divide by the norm"),
        ([[0.0, 0.0, np.nan]], "finite, got 1 NaN or infinite of 3"),
    ],
)
def test_bad_directions(bad: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fsh.grid_from_directions(bad)


@pytest.mark.parametrize(
    ("make", "size"),
    [
        (fsh.fibonacci_grid, 200_003),
        (fsh.equiangular_grid, 223),
        (fsh.healpix_grid, 129),
        (fsh.icosahedral_grid, 6),
        (fsh.cube_grid, 183),
        (fsh.icosphere, 141),
    ],
)
def test_grids_that_do_not_fit_are_refused(make: object, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """200,000 points need 5 MB of directions alone; with 2 MB left every maker has to refuse."""
    monkeypatch.setattr(_validation, "_available_memory", lambda: 2.0 * 2**20)
    monkeypatch.setattr(_validation, "_NEGLIGIBLE_MEMORY", 0)
    with pytest.raises(MemoryEstimateError, match=r"GiB"):
        make(size)  # type: ignore[operator]
