"""Area balancing: its energy against finite differences and closed forms, its steps against brute force, its maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere_map.balance import AREA_WEIGHT, balance, balance_level, first_flip
from fsh3d_o3d.sphere_map.balance_energy import balance_energy
from fsh3d_o3d.sphere_map.balance_system import BlockSystem
from fsh3d_o3d.sphere_map.validity import is_valid, orientations, solid_angles


def unit(points):
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def squeezed(points, scale):
    """The Möbius map that scales by ``scale`` in the stereographic plane: conformal, areas off by its square."""
    x, y, z = points.T
    # 2w / (1 + |w|²) with w = scale · (x, y) / (1 − z), cleared of the pole.
    below, above = 1 - z, scale**2 * (1 + z)
    return unit(np.stack((2 * scale * x, 2 * scale * y, above - below), axis=1) / (above + below)[:, None])


def shaken(points, triangles, size=0.2, seed=0):
    """A valid map close to ``points``."""
    noise = np.random.default_rng(seed).normal(size=points.shape)
    step = noise - (noise * points).sum(axis=1, keepdims=True) * points
    return unit(points + size * min(1.0, first_flip(points, step, triangles)) * step)


def tangents(points):
    first = unit(np.cross(points, np.where(np.abs(points[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])))
    return np.stack((first.T, np.cross(points, first).T))


def bumpy(frequency=5):
    """A closed surface with a long nose, and the sphere it is a radial function over."""
    directions, triangles = icosphere(frequency)
    radius = 1 + 4 * np.exp(-((1 - directions[:, 2]) / 0.1))
    return directions * radius[:, None], triangles, np.array(directions)


def test_a_sphere_onto_itself_has_the_least_energy():
    directions, triangles = icosphere(24)
    energy = balance_energy(directions, triangles, area_weight=1.0).value(directions.T)
    # The image's area is that of the flat triangle times its distance from the centre: 1 − edge²/6, edge ≈ 1/22.
    assert energy == pytest.approx(1.0, abs=1e-3)
    assert energy >= 1.0


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_a_moebius_map_is_conformal_and_its_areas_are_known(scale):
    directions, triangles = icosphere(40)
    image = squeezed(directions, scale)
    conformal = balance_energy(directions, triangles, area_weight=0.0).value(image.T)
    both = balance_energy(directions, triangles, area_weight=0.5).value(image.T)
    z = np.linspace(-1, 1, 20001)
    ratio = 4 * scale**2 / ((1 - z) + scale**2 * (1 + z)) ** 2  # image area over area, a function of the height
    expected = np.trapezoid(np.log(ratio) ** 2, z) / 2
    # Edges of 1/26, three times that where the map stretches most.
    assert conformal == pytest.approx(1.0, abs=5e-3)
    assert both - conformal == pytest.approx(0.5 * expected, rel=5e-3)


def test_the_energy_is_that_of_the_singular_values():
    vertices, triangles, directions = bumpy()
    image = shaken(directions, triangles)
    area, conformal, flat = [], [], []
    for corners in triangles:
        p, q = vertices[corners], image[corners]
        # Least squares finds the linear map of the plane; singular values do not need coordinates in it.
        linear = np.linalg.pinv(p[1:] - p[0]) @ (q[1:] - q[0])
        s1, s2 = np.linalg.svd(linear)[1][:2]
        area.append(np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])) / 2)
        normal = np.cross(q[1] - q[0], q[2] - q[0])
        distance = q[0] @ normal / np.linalg.norm(normal)
        conformal.append((s1 / s2 + s2 / s1) / 2 / distance)
        flat.append(np.linalg.norm(normal) / 2 * distance)
    share = np.array(area) / np.sum(area)
    expected = share @ (np.array(conformal) + 0.7 * np.log(np.array(flat) / (4 * np.pi * share)) ** 2)
    found = balance_energy(vertices, triangles, area_weight=0.7).value(image.T)
    assert found == pytest.approx(expected, rel=1e-10)  # rounding of pinv


def test_the_gradient_is_the_derivative():
    vertices, triangles, directions = bumpy(3)
    image = shaken(directions, triangles)
    density = np.random.default_rng(3).uniform(0.2, 5, len(triangles))
    energy = balance_energy(vertices, triangles, area_weight=1.3, density=density)
    gradient = energy.gradient(image.T)
    random = np.random.default_rng(1)
    for _ in range(5):
        step = random.normal(size=image.T.shape)
        h = 1e-6
        difference = (energy.value(image.T + h * step) - energy.value(image.T - h * step)) / (2 * h)
        assert (gradient * step).sum() == pytest.approx(difference, rel=1e-5)  # h² and rounding / h


def test_the_gradient_of_an_invalid_map_is_refused():
    directions, triangles = icosphere(2)
    with pytest.raises(ValueError, match="valid"):
        balance_energy(directions, triangles, area_weight=1.0).gradient(-directions.T)


def test_the_factors_are_those_of_the_second_derivative():
    # At the identity all four eigenvalues are ≥ 0, so nothing is cut off.
    directions, triangles = icosphere(24)
    energy = balance_energy(directions, triangles, area_weight=0.8)
    frames = tangents(directions)
    factors = energy.factors(directions.T, frames)
    # A smooth field with stretching, shear and rotation.
    field = np.stack((directions[:, 1] * directions[:, 2], directions[:, 0] ** 2, 0.5 * directions[:, 0]), axis=1)
    steps = np.einsum("dxn,nx->nd", frames, field)
    column = np.stack([steps[energy.triangles[k], d] for k in range(3) for d in range(2)])
    quadratic = np.square(np.einsum("rct,ct->rt", factors, column)).sum()
    tangent = np.einsum("dxn,nd->nx", frames, steps)
    h = 1e-3
    values = [energy.value(unit(directions + sign * h * tangent).T) for sign in (-1, 0, 1)]
    second = (values[0] - 2 * values[1] + values[2]) / h**2
    # What is left out, the bending of the sphere over a triangle, is of the order of its edge, 1/22, squared; twice.
    assert quadratic == pytest.approx(second, rel=0.02)


def test_the_system_is_that_of_the_blocks():
    vertices, triangles, directions = bumpy(2)
    image = shaken(directions, triangles)
    energy = balance_energy(vertices, triangles, area_weight=1.0)
    frames = tangents(image)
    factors = energy.factors(image.T, frames)
    right = np.random.default_rng(5).normal(size=(len(image), 2))
    solution = BlockSystem(energy.triangles, len(image)).directions(factors, right)
    dense = np.zeros((2 * len(image),) * 2)
    for k, corners in enumerate(energy.triangles.T):
        place = np.stack((2 * corners, 2 * corners + 1), axis=1).ravel()
        dense[np.ix_(place, place)] += factors[:, :, k].T @ factors[:, :, k]
    dense += 1e-8 * np.diag(dense.diagonal())
    assert np.linalg.norm(dense @ solution.ravel() + right.ravel()) < 1e-6 * np.linalg.norm(right)  # condition 1e8


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 30.0))
def test_the_first_flip_is_where_a_determinant_first_vanishes(seed, size):
    directions, triangles = icosphere(2)
    noise = np.random.default_rng(seed).normal(size=directions.shape)
    step = size * (noise - (noise * directions).sum(axis=1, keepdims=True) * directions)
    flip = first_flip(directions, step, triangles)
    grid = np.linspace(0, min(flip, 1.0), 200)
    lowest = np.array([orientations(directions + x * step, triangles).min() for x in grid])
    if flip > 1:
        assert (lowest > 0).all()
    else:
        assert (lowest[:-1] > 0).all()
        assert abs(lowest[-1]) < 1e-9 * max(1.0, size**3)  # a root to rounding of the cubic's coefficients


def test_the_first_flip_of_a_known_triangle():
    points = np.eye(3)
    step = np.array([[-1.0, 2.0, 2.0], [0, 0, 0], [0, 0, 0]])  # first coordinate 1 − λ: flat at λ = 1 of twice this
    assert first_flip(points, 2 * step, np.array([[0, 1, 2]])) == pytest.approx(0.5, abs=1e-12)
    assert first_flip(points, 0.5 * step, np.array([[0, 1, 2]])) == np.inf


@pytest.mark.parametrize("scale", [0.2, 50.0])
def test_a_squeezed_sphere_is_spread_out_again(scale):
    directions, triangles = icosphere(12)
    start = squeezed(directions, scale)
    result = balance(directions, triangles, start, tolerance=1e-9)
    assert result.converged
    assert is_valid(result.sphere, triangles)
    assert result.start_energy > result.energy
    assert result.energy == pytest.approx(1.0, abs=2e-3)  # see the sphere onto itself, coarser
    # The only maps that keep angles and areas are rotations.
    rotation, _ = Rotation.align_vectors(directions, result.sphere)
    assert np.abs(rotation.apply(result.sphere) - directions).max() < 0.02


def test_a_speck_of_the_sphere_grows_back_to_its_share():
    vertices, triangles, directions = bumpy()
    start = squeezed(directions, 3e-5)
    assert orientations(start, triangles).min() < 1e-10
    result = balance(vertices, triangles, start, max_iterations=200)
    assert result.converged
    assert is_valid(result.sphere, triangles)
    assert result.energy == pytest.approx(balance(vertices, triangles, directions).energy, rel=0.01)  # the tolerance


def test_few_steps_already_help_and_count():
    vertices, triangles, directions = bumpy()
    two = balance(vertices, triangles, directions, max_iterations=2)
    none = balance(vertices, triangles, directions, max_iterations=0)
    assert two.iterations == 2
    assert two.energy < 0.9 * two.start_energy
    assert (none.iterations, none.converged) == (0, False)
    np.testing.assert_array_equal(none.sphere, directions)
    measured = balance_energy(vertices, triangles, area_weight=AREA_WEIGHT).value(two.sphere.T)
    assert two.energy == pytest.approx(measured, rel=1e-14)


def test_more_area_weight_gives_more_even_areas_and_less_even_angles():
    vertices, triangles, directions = bumpy()
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    share = area / area.sum()
    spread, angles = [], []
    for weight in (0.0, 0.1, 1.0, 10.0):
        image = balance(vertices, triangles, directions, area_weight=weight, tolerance=1e-6).sphere
        spread.append(share @ np.log(solid_angles(image, triangles) / (4 * np.pi * share)) ** 2)
        angles.append(balance_energy(vertices, triangles, area_weight=0.0).value(image.T))
    assert np.all(np.diff(spread) < 0)
    assert np.all(np.diff(angles) > 0)


def test_density_gives_triangles_more_of_the_sphere():
    directions, triangles = icosphere(12)
    upper = directions[triangles].mean(axis=1)[:, 2] > 0
    density = np.where(upper, 3.0, 1.0)
    result = balance(directions, triangles, directions, area_weight=20.0, density=density)
    share = solid_angles(result.sphere, triangles)[upper].sum() / (4 * np.pi)
    assert share == pytest.approx(0.75, abs=0.01)  # the conformal part still has 1 of 21
    assert is_valid(result.sphere, triangles)


def test_degenerate_source_triangles_do_not_rule():
    vertices, triangles, directions = bumpy()
    plain = balance(vertices, triangles, directions)
    flat = vertices.copy()
    corners = triangles[7]
    flat[corners[0]] = flat[corners[1:]].mean(axis=0)  # on the opposite edge: no area
    same = vertices.copy()
    same[corners[0]] = same[corners[1]]  # and two triangles with a zero edge
    point = vertices.copy()
    point[corners] = point[corners[0]]  # and one that is a point
    for bad in (flat, same, point):
        result = balance(bad, triangles, directions)
        assert is_valid(result.sphere, triangles)
        assert np.isfinite(result.energy)
        assert result.converged
        assert result.energy < 1.5 * plain.energy  # a few of 500 triangles are other ones


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_the_energy_knows_neither_pose_nor_size(seed, scale):
    vertices, triangles, directions = bumpy(3)
    turn, other = Rotation.random(2, rng=np.random.default_rng(seed))
    moved = scale * (turn.apply(vertices) + np.array([3.0, 2.0, 1.0]))
    first = balance_energy(vertices, triangles, area_weight=1.0).value(directions.T)
    second = balance_energy(moved, triangles, area_weight=1.0).value(other.apply(directions.copy()).T)
    assert second == pytest.approx(first, rel=1e-9)  # rounding, of slivers too


def test_a_flipped_start_is_refused_and_arrays_are_left_alone():
    vertices, triangles, directions = bumpy(3)
    with pytest.raises(ValueError, match="valid map"):
        balance(vertices, triangles, -directions)
    start = directions.copy()
    balance(vertices, triangles, start, max_iterations=1)
    np.testing.assert_array_equal(start, directions)


def test_the_same_input_gives_the_same_bytes():
    vertices, triangles, directions = bumpy()
    first, second = (balance(vertices, triangles, directions).sphere.tobytes() for _ in range(2))
    assert first == second


def test_conjugate_steps_lead_to_the_same_minimum():
    vertices, triangles, directions = bumpy()
    exact = balance(vertices, triangles, directions, tolerance=1e-7)
    one = balance(vertices, triangles, directions, max_iterations=1, conjugate_steps=5)
    many = balance(vertices, triangles, directions, max_iterations=300, tolerance=1e-7, conjugate_steps=30)
    assert exact.energy < one.energy < one.start_energy
    assert many.energy == pytest.approx(exact.energy, rel=1e-4)
    assert is_valid(many.sphere, triangles)


def test_levels_come_out_balanced():
    vertices, triangles, directions = bumpy(20)  # 4002 vertices: of the levels that take conjugate gradients
    exact = balance(vertices, triangles, directions)
    shaking = shaken(exact.sphere, triangles, size=0.5)  # what is wrong is local, as after inserting vertices
    measure = balance_energy(vertices, triangles, area_weight=AREA_WEIGHT)
    level = balance_level(vertices, triangles, shaking)
    assert is_valid(level, triangles)
    excess = [measure.value(points.T) - exact.energy for points in (shaking, level)]
    assert excess[1] < 0.2 * excess[0]
