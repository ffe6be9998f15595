"""Relaxing lowers its energy, keeps maps valid, and leaves the ideal map alone."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.sphere_map import relaxation
from fsh3d_o3d.sphere_map.relaxation import relax
from fsh3d_o3d.sphere_map.validity import distortion, is_valid, orientations
from tests.sphere_map import closed_surfaces as surfaces


def jittered(rng, sphere, triangles, amount):
    """A valid map whose vertices are off by about ``amount``."""
    moved = sphere + amount * rng.standard_normal(sphere.shape)
    moved /= np.linalg.norm(moved, axis=1)[:, None]
    assert is_valid(moved, triangles)
    return moved


def energy(vertices, triangles, sphere, area_weight):
    """The energy by its definition, triangle by triangle, with the masses and thickening that the module documents."""
    corners, image = vertices[triangles], sphere[triangles]
    edges = corners[:, (2, 0, 1)] - corners[:, (1, 2, 0)]
    squares = (edges**2).sum(axis=2)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    squares = squares / squares.mean()
    squares = squares + relaxation._THICKENED * squares.mean(axis=1, keepdims=True) + 1e-9
    # A flat triangle with these edges, laid out in the plane; then the map's 2 × 2 metric by solving for it.
    c = np.sqrt(squares[:, 2])
    x = (squares[:, 1] + squares[:, 2] - squares[:, 0]) / (2 * c)
    y = np.sqrt(squares[:, 1] - x**2)
    source = np.stack((np.stack((c, x), 1), np.stack((np.zeros_like(c), y), 1)), 1)
    target = np.stack((image[:, 1] - image[:, 0], image[:, 2] - image[:, 0]), axis=2)
    jacobian = target @ np.linalg.inv(source)
    determinant = np.linalg.det(image)
    mass = area / area.mean() + relaxation._AREA_FLOOR
    mass /= mass.sum()
    ratio = (jacobian**2).sum(axis=(1, 2)) / 2 * (c * y / 2) / (determinant / 2)
    return float((mass * ratio - area_weight * mass * np.log(determinant / 2)).sum())


def test_the_ideal_map_stays(rng):
    sphere, triangles = surfaces.ball(8)
    # The icosphere mapped to itself is conformal and area-true but for the bend of its triangles, about (1/8)² / 4.
    assert np.abs(relax(sphere, triangles, sphere) - sphere).max() < 0.01


@pytest.mark.parametrize("area_weight", [0.3, 5.0])
def test_steps_lower_the_energy(rng, area_weight):
    sphere, triangles = surfaces.ball(8)
    vertices = sphere * (1.0, 1.3, 1.6)
    points = jittered(rng, sphere, triangles, 0.02)
    before = energy(vertices, triangles, points, area_weight)
    for _ in range(5):
        points = relax(vertices, triangles, points, area_weight=area_weight, steps=1)
        after = energy(vertices, triangles, points, area_weight)
        assert after < before
        before = after
    assert is_valid(points, triangles)


def test_one_vertex_moves_down_the_gradient(rng, monkeypatch):
    sphere, triangles = surfaces.ball(3)
    vertices = sphere * (1.0, 1.2, 0.9)
    points = jittered(rng, sphere, triangles, 0.03)
    surface = relaxation._TriangleMetrics.of(vertices, triangles)
    move = relaxation._newton_move(surface, points, orientations(points, triangles), 2.0)
    # Along each vertex' own Newton step its energy falls at first: the slope, by central differences.
    for vertex in range(0, len(points), 7):
        ahead, behind = points.copy(), points.copy()
        ahead[vertex] += 1e-6 * move[vertex]
        behind[vertex] -= 1e-6 * move[vertex]
        assert energy(vertices, triangles, ahead, 2.0) < energy(vertices, triangles, behind, 2.0)


def test_areas_or_angles():
    sphere, triangles = surfaces.ball(4)
    vertices = sphere * (1.0, 1.0, 2.0)
    angles, areas = (
        distortion(vertices, triangles, relax(vertices, triangles, sphere, area_weight=weight, steps=200))
        for weight in (0.05, 50.0)
    )
    assert angles.mean < areas.mean
    assert areas.area < angles.area


def test_a_nearly_flat_triangle_recovers():
    sphere, triangles = surfaces.ball(8)
    pinched = sphere.copy()
    a, b, _ = triangles[100]
    pinched[a] = pinched[b] + 1e-6 * (pinched[a] - pinched[b])
    pinched[a] /= np.linalg.norm(pinched[a])
    assert is_valid(pinched, triangles)
    # Newton's step for a single −log at most doubles its argument, damped 1.6 times a step: 30 make up for 10⁶.
    relaxed = relax(sphere, triangles, pinched, steps=60)
    assert is_valid(relaxed, triangles)
    assert orientations(relaxed, triangles).min() > orientations(sphere, triangles).min() / 10


def test_the_given_map_is_left_as_it_is(rng):
    sphere, triangles = surfaces.ball(4)
    points = jittered(rng, sphere, triangles, 0.02)
    copy = points.copy()
    assert not np.array_equal(relax(sphere, triangles, points), copy)
    assert np.array_equal(points, copy)


def test_no_step_is_too_long(rng):
    sphere, triangles = surfaces.ball(4)
    # Moves that would turn everything over are cut down until every triangle keeps its share.
    before = orientations(sphere, triangles)
    moved, after = relaxation._guarded(sphere, 3 * rng.standard_normal(sphere.shape), triangles, before)
    assert (after >= relaxation._KEPT_AREA * before).all()
    assert is_valid(moved, triangles)
