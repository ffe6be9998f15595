"""The correlation over SO(3): on its grid and locally, against rotation of coefficients and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere.rotation.correlation import Correlator, correlator, exponential


def functions(rng: np.random.Generator, bandwidth: int, count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    return rng.standard_normal((count, bandwidth**2)), rng.standard_normal((count, bandwidth**2))


def direct(source: np.ndarray, target: np.ndarray, rotation: np.ndarray) -> float:
    return float(np.sum(target * fsh.rotate_coefficients(source, rotation)))


def test_exponential_is_rotation_about_the_vector(rng: np.random.Generator) -> None:
    vectors = rng.standard_normal((6, 3)) * np.array([0, 1e-12, 1e-6, 0.1, 1, 3])[:, None]
    # Sums of three products of order one.
    assert np.abs(exponential(vectors) - Rotation.from_rotvec(vectors).as_matrix()).max() < 2e-15


@pytest.mark.parametrize("bandwidth", [1, 2, 5, 9])
def test_grid_holds_the_correlation(bandwidth: int, rng: np.random.Generator) -> None:
    source, target = functions(rng, bandwidth)
    search = correlator(bandwidth)
    values = search.on_grid(search.products(source[None], target)).ravel()
    assert len(values) == len(search.rotations)
    scale = np.linalg.norm(source) * np.linalg.norm(target)
    for index in rng.integers(0, len(values), 12):
        # The grid is in float32.
        assert values[index] == pytest.approx(direct(source, target, search.rotations[index]), abs=2e-6 * scale)


def test_grid_holds_the_inverses_of_its_rotations() -> None:
    rotations = Correlator(3).rotations
    inverse = rotations.transpose(0, 2, 1).reshape(-1, 9)
    nearest = (inverse @ rotations.reshape(-1, 9).T).max(axis=1)
    # ⟨A, B⟩ = 3 where A = B.
    assert nearest.min() > 3 - 1e-12


def test_several_sources_at_once(rng: np.random.Generator) -> None:
    source, target = functions(rng, 4)
    sources = np.stack((source, rng.standard_normal(source.shape), target))
    search = correlator(4)
    together = search.on_grid(search.products(sources, target))
    for one, values in zip(sources, together, strict=True):
        alone = search.on_grid(search.products(one[None], target))[0]
        # float32 sums in another order.
        assert np.abs(values - alone).max() < 1e-5 * np.abs(alone).max()


@pytest.mark.parametrize("bandwidth", [2, 6, 12])
def test_derivatives_are_those_of_the_correlation(bandwidth: int, rng: np.random.Generator) -> None:
    source, target = functions(rng, bandwidth)
    search = correlator(bandwidth, 1)
    products = search.products(source[None], target)
    rotation = Rotation.random(rng=rng).as_matrix()
    _, value, hessian = search.ascend(products, rotation[None], 0)
    assert value[0] == pytest.approx(direct(source, target, rotation), rel=1e-12, abs=1e-12)
    # Central differences with step h: error h² l⁴, and rounding 1e-15 / h².
    step, scale = 1e-3 / bandwidth, np.linalg.norm(source) * np.linalg.norm(target)
    ways = np.eye(3)

    def along(vector: np.ndarray) -> float:
        return direct(source, target, exponential(step * vector[None])[0] @ rotation)

    for i in range(3):
        for j in range(3):
            plus, minus = ways[i] + ways[j], ways[i] - ways[j]
            difference = (along(plus) + along(-plus) - along(minus) - along(-minus)) / (4 * step**2)
            assert hessian[0, i, j] == pytest.approx(difference, abs=1e-5 * scale * bandwidth**2)


def test_climbs_to_a_local_maximum(rng: np.random.Generator) -> None:
    source, target = functions(rng, 8)
    search = correlator(8)
    products = search.products(source[None], target)
    starts = Rotation.random(20, rng=rng).as_matrix()
    before = search.values(products, starts)
    rotations, values, hessians = search.ascend(products, starts, 40)
    assert (values > before).all()
    assert np.linalg.eigvalsh(hessians).max() <= 0
    for rotation, value in zip(rotations[:5], values[:5], strict=True):
        assert value == pytest.approx(direct(source, target, rotation), rel=1e-12)
        nearby = [direct(source, target, turn @ rotation) for turn in exponential(1e-4 * rng.standard_normal((8, 3)))]
        assert max(nearby) <= value + 1e-12 * abs(value)


def test_each_start_may_have_products_of_its_own(rng: np.random.Generator) -> None:
    sources, target = rng.standard_normal((4, 3, 36)), rng.standard_normal((3, 36))
    search = correlator(6)
    products = search.products(sources, target)
    starts = Rotation.random(4, rng=rng).as_matrix()
    together = search.ascend(products, starts, 5)
    for index in range(4):
        alone = search.ascend(products[index : index + 1], starts[index : index + 1], 5)
        for several, one in zip(together, alone, strict=True):
            # The same steps, with sums in another order; curvatures are of order l² = 30.
            assert several[index] == pytest.approx(one[0], rel=1e-9, abs=1e-9)


def test_peaks_are_neither_lost_at_the_poles_nor_at_the_seams() -> None:
    search = correlator(3)
    values = np.zeros((1, *search.shape), dtype=np.float32)
    values[0, 0, 0, 0] = 3  # next to a pole and to both seams
    values[0, -1, 5, -1] = 2
    values[0, 2, 3, 4] = 1
    values[0, 2, 3, 5] = 0.5  # beside a higher one
    found = search.peaks(values, 3)[0]
    assert [tuple(map(int, np.unravel_index(index, search.shape))) for index in found] == [
        (0, 0, 0),
        (search.shape[0] - 1, 5, search.shape[2] - 1),
        (2, 3, 4),
    ]
    # Beyond the pole β = 0 the neighbour of (α, γ) is (α + π, γ + π): a higher one there is a neighbour.
    half = search.shape[1] // 2
    values[0, 0, half, half] = 4
    assert int(search.peaks(values, 1)[0, 0]) == np.ravel_multi_index((0, half, half), search.shape)
    flat = search.peaks(values, 2)[0]
    assert np.ravel_multi_index((0, 0, 0), search.shape) not in flat
