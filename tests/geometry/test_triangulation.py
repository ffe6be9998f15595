import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.geometry.triangulation import fibonacci_triangulation, icosphere, sphere_mesh
from fsh3d_o3d.sphere.grids import fibonacci_grid


def quality(directions, triangles):
    """Smallest angle in degrees, ratio of largest to smallest area."""
    edges = [directions[triangles[:, (k + 1) % 3]] - directions[triangles[:, k]] for k in range(3)]
    unit = [edge / np.linalg.norm(edge, axis=1)[:, None] for edge in edges]
    angles = [np.degrees(np.arccos(-np.einsum("ij,ij->i", unit[k - 1], unit[k]))) for k in range(3)]
    areas = np.linalg.norm(np.cross(edges[0], edges[1]), axis=1) / 2
    return np.min(angles), areas.max() / areas.min()


def assert_is_sphere(directions, triangles):
    m = measure_mesh(MeshArrays(directions, triangles))
    assert (m.genus, m.components, m.outward, m.degenerate_triangles) == (0, 1, True, 0)
    assert len(triangles) == 2 * len(directions) - 4
    assert len(np.unique(triangles)) == len(directions)
    assert triangles.dtype == np.int64
    # Unit vectors up to the rounding of a division.
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=4e-16)


@pytest.mark.parametrize("n", [4, 5, 6, 12, 99, 600, 6144])
def test_fibonacci_nodes(n):
    nodes = fibonacci_grid(n).directions
    directions, triangles = fibonacci_triangulation(nodes)
    # Divided by their norm again, an ulp at most.
    np.testing.assert_allclose(directions, nodes, atol=3e-16)
    assert_is_sphere(directions, triangles)
    angle, ratio = quality(directions, triangles)
    assert angle > 38
    assert ratio < 1.6, "no degenerate faces, at the poles or elsewhere"


@pytest.mark.parametrize("frequency", [1, 2, 3, 7, 32])
def test_icospheres(frequency):
    directions, triangles = icosphere(frequency)
    assert len(directions) == 10 * frequency**2 + 2
    assert_is_sphere(directions, triangles)
    angle, ratio = quality(directions, triangles)
    assert angle > 53
    assert ratio < 2


def test_the_hull_of_an_icosphere_is_the_icosphere():
    directions, triangles = icosphere(5)
    _, hull = fibonacci_triangulation(directions)
    # Each triangle rotated to begin with its lowest vertex: the same set, and the same winding.
    canonical = [
        {tuple(np.roll(t, -t.argmin())) for t in triangles_} for triangles_ in (np.asarray(triangles), np.asarray(hull))
    ]
    assert canonical[0] == canonical[1]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(30, 300))
def test_scattered_directions_make_a_sphere_too(seed, n):
    directions = np.random.default_rng(seed).normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points, triangles = fibonacci_triangulation(directions)
    m = measure_mesh(MeshArrays(points, triangles))
    assert (m.genus, m.outward, len(triangles)) == (0, True, 2 * n - 4)
    # Delaunay: no node above any face's plane.
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    height = normals @ points.T - np.einsum("ij,ij->i", normals, a)[:, None]
    assert height.max() < 1e-9  # normals of the thinnest random triangles keep about 9 digits


def test_a_turned_grid_has_the_same_triangles():
    nodes = fibonacci_grid(200).directions
    rotation = Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix()
    area = measure_mesh(MeshArrays(*fibonacci_triangulation(nodes))).area
    turned = measure_mesh(MeshArrays(*fibonacci_triangulation(nodes @ rotation.T))).area
    assert turned == pytest.approx(area, rel=1e-13)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        (np.eye(3), "at least 4"),
        (np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]), "surround the origin"),
        (np.array([[0.0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]]), "surround the origin"),
        (np.repeat(fibonacci_grid(10).directions, 2, axis=0), "different"),
        (2 * fibonacci_grid(10).directions, "unit vectors"),
        (np.full((5, 3), np.nan), "finite"),
    ],
)
def test_what_cannot_be_triangulated_is_refused(directions, message):
    with pytest.raises(ValueError, match=message):
        fibonacci_triangulation(directions)


def test_a_resolution_or_directions_choose_the_sphere():
    for points, vertices in ((4, 12), (12, 12), (13, 42), (42, 42), (43, 92), (92, 92), (93, 162), (100_003, 102_012)):
        directions, triangles = sphere_mesh(points)
        assert (len(directions), len(triangles)) == (vertices, 2 * vertices - 4)
    nodes = fibonacci_grid(50).directions
    np.testing.assert_array_equal(sphere_mesh(nodes)[1], fibonacci_triangulation(nodes)[1])


@pytest.mark.parametrize(
    ("resolution", "error"), [(3, ValueError), (10**9, ValueError), (2.5, TypeError), (True, TypeError)]
)
def test_other_resolutions_are_refused(resolution, error):
    with pytest.raises(error, match="resolution"):
        sphere_mesh(resolution)
