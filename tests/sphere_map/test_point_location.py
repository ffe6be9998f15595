"""Exact location on the sphere, held against integer arithmetic on triangles of very different sizes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.triangulation import fibonacci_triangulation, icosphere
from fsh3d_o3d.sphere.grids import fibonacci_grid
from fsh3d_o3d.sphere_map import point_location
from fsh3d_o3d.sphere_map.point_location import TriangleSearch, determinants, locate

OCTAHEDRON = np.vstack((np.eye(3), -np.eye(3)))
OCTANTS = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]


def normalised(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def whole(vectors):
    """Coordinates times 2³⁰⁰ as Python's integers: no rounding from here on."""
    return np.array([int(Fraction(x) * 2**300) for x in np.ravel(vectors).tolist()], dtype=object).reshape(
        np.shape(vectors)
    )


def exact_volume(a, b, c):
    """det[a, b, c] of integer vectors (…, 3)."""
    a, b, c = (np.moveaxis(vectors, -1, 0) for vectors in (a, b, c))
    return sum(a[i] * (b[i - 2] * c[i - 1] - b[i - 1] * c[i - 2]) for i in range(3))


def nested(rng, count, depth=9.0):
    """A valid triangulation of the sphere: triangles cut in three again and again, at corners or close to edges."""
    sphere, triangles = list(OCTAHEDRON), [list(t) for t in OCTANTS]
    while len(triangles) < count:
        # Often the newest, so that some become very small.
        which = int(len(triangles) - 1 if rng.random() < 0.5 else rng.integers(len(triangles)))
        weights = 10 ** -(depth * rng.random(3) * (rng.random(3) < 0.5))
        a, b, c = triangles[which]
        new = normalised(weights @ np.array([sphere[a], sphere[b], sphere[c]]) / weights.sum())
        corners = whole(np.array([sphere[a], sphere[b], sphere[c]]))
        if min(exact_volume(corners, np.roll(corners, -1, axis=0), whole(new))) > 0:
            n = len(sphere)
            sphere.append(new)
            triangles[which] = [a, b, n]
            triangles += [[b, c, n], [c, a, n]]
    return np.array(sphere), np.array(triangles)


def difficult_directions(sphere, triangles, rng):
    """Anywhere, in every triangle, at every vertex, and on edges or a rounding away from them."""
    corners = sphere[triangles]
    inside = np.einsum("tk,tkx->tx", rng.dirichlet(np.ones(3), len(triangles)), corners)
    middles = corners + np.roll(corners, 1, axis=1)
    return np.vstack(
        (
            normalised(rng.standard_normal((20, 3))),
            normalised(inside),
            sphere,
            normalised(middles.reshape(-1, 3)[rng.permutation(3 * len(triangles))[:40]]),
            normalised([[1, 1, 0], [0, 1, -1], [1e-9, 1, 0], [1, 0, 3e-17]]),  # on the edges of the octahedron
        )
    )


def check_against_integers(sphere, triangles, directions):
    found, weights = locate(sphere, triangles, directions)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-15)  # one division
    corners, way = whole(sphere)[triangles], whole(directions)[:, None]
    volumes = np.stack([exact_volume(corners[:, k - 2], corners[:, k - 1], way) for k in range(3)], axis=-1)
    inside = (volumes >= 0).all(axis=2) & (volumes > 0).any(axis=2)
    assert inside.any(axis=1).all()
    np.testing.assert_array_equal(found, inside.argmax(axis=1), "the first of those that hold the direction")
    own = np.take_along_axis(volumes, found[:, None, None], axis=1)[:, 0]
    np.testing.assert_array_equal(weights == 0, own == 0, "on an edge, or not")
    total = own.sum(axis=1)
    expected = (own / total[:, None]).astype(float)
    # Differences round by parts of the triangle's size, not of the sphere's; long thin triangles lose the ratio of the
    # sides beyond that. Three volumes of up to eight roundoffs each.
    size = np.linalg.norm(sphere[triangles] - sphere[np.roll(triangles, 1, axis=1)], axis=2).max(axis=1)[found]
    bound = 24 * 2.0**-53 * size**2 / (total / 2**900).astype(float) + 1e-15
    assert (np.abs(weights - expected).max(axis=1) <= bound).all()


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
@example(0)
def test_every_direction_is_where_integer_arithmetic_says(seed):
    rng = np.random.default_rng(seed)
    sphere, triangles = nested(rng, 80)
    check_against_integers(sphere, triangles, difficult_directions(sphere, triangles, rng))


def shrunk(frequency, scale):
    """An icosphere after the Möbius map that scales the plane seen from the pole: conformal, areas 1 : scale⁴."""
    directions, triangles = icosphere(frequency)
    x, y, z = directions.T
    low = scale * scale * (1 - z)
    return normalised(
        np.column_stack((2 * scale * x, 2 * scale * y, (1 + z) - low)) / ((1 + z) + low)[:, None]
    ), triangles


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_triangles_a_trillionth_of_the_sphere(scale):
    sphere, triangles = shrunk(20, scale)
    corners = sphere[triangles]
    volume = np.einsum(
        "ij,ij->i", corners[:, 0], np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    )
    assert volume.min() > 0
    assert scale == 1 or volume.min() < 4 * np.pi * 1e-9
    inside = normalised(np.einsum("k,tkx->tx", [0.2, 0.5, 0.3], corners))
    found, weights = locate(sphere, triangles, inside)
    np.testing.assert_array_equal(found, np.arange(len(triangles)))
    # A triangle of size 1e-6 knows a direction rounded to 1e-16 to 1e-10 of itself.
    np.testing.assert_allclose(weights, np.tile([0.2, 0.5, 0.3], (len(triangles), 1)), atol=1e-8)
    on_vertices, exact = locate(sphere, triangles, sphere)
    first = np.array([np.flatnonzero((triangles == vertex).any(axis=1))[0] for vertex in range(len(sphere))])
    np.testing.assert_array_equal(on_vertices, first)
    assert set(np.unique(exact)) == {0.0, 1.0}
    np.testing.assert_array_equal(triangles[on_vertices, exact.argmax(axis=1)], np.arange(len(sphere)))


def test_linear_functions_are_interpolated_through_the_plane_of_each_triangle():
    sphere, triangles = fibonacci_triangulation(fibonacci_grid(500).directions)
    directions = fibonacci_grid(3000).directions
    found, weights = locate(sphere, triangles, directions)
    points = np.einsum("mk,mkx->mx", weights, sphere[triangles[found]])
    np.testing.assert_allclose(normalised(points), directions, atol=1e-15)


def test_the_way_there_does_not_matter(rng):
    sphere, triangles = nested(rng, 300)
    directions = difficult_directions(sphere, triangles, rng)
    found, weights = locate(sphere, triangles, directions)
    # Where several edges are in the way one is drawn: others are when other directions are looked for beside.
    order = rng.permutation(len(directions))
    again = locate(sphere, triangles, directions[order])
    assert (found[order].tobytes(), weights[order].tobytes()) == tuple(array.tobytes() for array in again)
    alone = [locate(sphere, triangles, direction[None]) for direction in directions[:50]]
    assert [int(triangle[0]) for triangle, _ in alone] == found[:50].tolist()
    np.testing.assert_array_equal(np.concatenate([weight for _, weight in alone]), weights[:50])
    # No walk at all: every triangle is tried.
    np.testing.assert_array_equal(TriangleSearch(sphere, triangles).searched(directions), found)


def test_many_directions_are_looked_for_in_blocks(monkeypatch):
    sphere, triangles = icosphere(2)
    directions = fibonacci_grid(500).directions
    whole_array = locate(sphere, triangles, directions)
    monkeypatch.setattr(point_location, "_BLOCK", 7)
    monkeypatch.setattr(point_location, "_PAIRS", 1000)
    for once, blocks in zip(whole_array, locate(sphere, triangles, directions), strict=True):
        np.testing.assert_array_equal(once, blocks)
    np.testing.assert_array_equal(TriangleSearch(sphere, triangles).searched(directions), whole_array[0])


@pytest.mark.parametrize("surface", ["nested", "a thin pole", "a wide pole"])
def test_walks_end_soon(rng, surface):
    sphere, triangles = {
        "nested": lambda: nested(rng, 1000),
        "a thin pole": lambda: shrunk(30, 1e-2),
        "a wide pole": lambda: shrunk(30, 1e2),
    }[surface]()
    found, _ = TriangleSearch(sphere, triangles).walked(normalised(rng.standard_normal((2000, 3))))
    assert (found >= 0).all()


def test_a_sphere_with_a_hole_is_refused():
    with pytest.raises(GeometryError, match="do not cover the sphere"):
        locate(OCTAHEDRON, np.array(OCTANTS[:7]), normalised(np.array([[1.0, -1, -1]])))


def test_determinants_have_the_right_sign_where_rounding_decides(rng):
    start, end = normalised(rng.standard_normal((2, 300, 3)))
    end[:100] = normalised(start[:100] + 1e-9 * end[:100])
    direction = normalised(rng.random((300, 1)) * start + rng.random((300, 1)) * end)  # rounded off the arc
    direction[:20] = start[:20]
    direction[20:40] = -end[20:40]
    exact = exact_volume(whole(start), whole(end), whole(direction))
    value = determinants(start, end, direction)
    np.testing.assert_array_equal(np.sign(value), (exact > 0).astype(int) - (exact < 0).astype(int))
    assert np.count_nonzero(value == 0) >= 40
    assert np.count_nonzero(value != 0) >= 200
    np.testing.assert_array_equal(determinants(end, start, direction), -value)


def test_determinants_far_from_the_arc(rng):
    start, end, direction = normalised(rng.standard_normal((3, 200, 3)))
    exact = (exact_volume(whole(start), whole(end), whole(direction)) / 2**900).astype(float)
    np.testing.assert_allclose(
        determinants(start, end, direction), exact, atol=2e-15
    )  # eight roundoffs of lengths <= 2
