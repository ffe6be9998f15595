"""Closed-form and geometric weights: sums, exactness, areas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import fsh3d_o3d as fsh
from tests.sphere.oracles import misses, scattered


@pytest.mark.parametrize("b", [1, 2, 3, 8, 17])
def test_driscoll_healy_is_exact_below_2b(b: int) -> None:
    weights = fsh.driscoll_healy_weights(b)
    grid = fsh.equiangular_grid(b)
    assert weights.shape == (4 * b * b,)
    assert misses(grid.directions, weights, b) < 4e-15  # rounding of 4b² terms and of the oracle
    assert weights.sum() == pytest.approx(4 * np.pi, rel=1e-14)
    assert weights.min() > 0


def test_driscoll_healy_is_the_published_sum() -> None:
    """Driscoll and Healy's (2/b) sin θ Σ sin((2k+1)θ)/(2k+1), here times the row's 2π/2b, in long double."""
    b = 16
    theta = np.longdouble(np.pi) * (2 * np.arange(2 * b) + 1) / (4 * b)
    terms = [np.sin((2 * k + 1) * theta) / (2 * k + 1) for k in range(b)]
    rows = np.float64(2) / b * np.sin(theta) * sum(terms) * np.longdouble(np.pi) / b
    assert np.abs(fsh.driscoll_healy_weights(b).reshape(2 * b, 2 * b) - rows[:, None]).max() < 1e-16


def test_equal_weights() -> None:
    weights = fsh.equal_weights(fsh.cube_grid(3))
    assert weights.tolist() == [4 * np.pi / 54] * 54


@pytest.mark.parametrize("corners", ["octahedron", "cube", "icosahedron"])
def test_areas_of_platonic_solids_are_equal(corners: str) -> None:
    solids = {
        "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
        "cube": np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T / np.sqrt(3),
        "icosahedron": fsh.icosphere(1)[0],
    }
    areas = fsh.area_weights(fsh.grid_from_directions(solids[corners]))
    assert np.abs(areas - 4 * np.pi / len(areas)).max() < 1e-14


def test_areas_against_counting(rng: np.random.Generator) -> None:
    points, samples = scattered(rng, 40), scattered(rng, 400_000)
    nearest = cKDTree(points).query(samples)[1]
    share = np.bincount(nearest, minlength=40) / len(samples)
    areas = fsh.area_weights(fsh.grid_from_directions(points)) / (4 * np.pi)
    assert np.abs(share - areas).max() < 6 * np.sqrt(areas.max() / len(samples))  # six standard deviations
    assert areas.sum() == pytest.approx(1, rel=1e-14)


def test_areas_of_fibonacci_cells_are_nearly_equal() -> None:
    """The paper (section 3.4) gives about 2 % for all but the points next to the poles."""
    ratio = fsh.area_weights(fsh.fibonacci_grid(2000)) * 2000 / (4 * np.pi)
    assert np.abs(ratio[20:-20] - 1).max() < 0.025
    assert np.abs(ratio - 1).max() < 0.12


@pytest.mark.parametrize(
    "directions",
    [
        np.eye(3),
        np.repeat(np.concatenate([np.eye(3), -np.eye(3)]), 2, axis=0),
        [[np.cos(t), np.sin(t), 0.0] for t in range(8)],
        [[0.6 * np.cos(t), 0.6 * np.sin(t), 0.8] for t in range(8)],
    ],
    ids=["three points", "duplicates", "great circle", "small circle"],
)
def test_points_without_voronoi_cells(directions: object) -> None:
    with pytest.raises(ValueError, match=r"have no Voronoi cells"):
        fsh.area_weights(fsh.grid_from_directions(directions))


def test_bandwidth_is_checked() -> None:
    with pytest.raises(ValueError, match=r"bandwidth must be between 1 and 4096, got 0"):
        fsh.driscoll_healy_weights(0)


@pytest.mark.parametrize("rule", [fsh.equal_weights, fsh.area_weights])
def test_grids_are_asked_for_by_name(rule: object) -> None:
    with pytest.raises(TypeError, match=r"grid must be a SphericalGrid, got ndarray"):
        rule(np.eye(3))  # type: ignore[operator]
