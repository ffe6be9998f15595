import numpy as np
import pytest

from fsh3d_o3d.sphere_map.intrinsic_delaunay import intrinsic_delaunay
from fsh3d_o3d.sphere_map.laplacian import (
    LAPLACIANS,
    PinnedLaplacian,
    cotangents,
    double_areas,
    edge_lengths,
    laplacian,
    lumped_mass,
)
from tests.geometry import mesh_shapes as shapes


def skewed(seed=3):
    """A sphere whose vertices were pushed about within the surface: many obtuse triangles, few Delaunay edges."""
    sphere = shapes.sphere(6)
    noise = np.random.default_rng(seed).normal(size=sphere.vertices.shape) * 0.06
    vertices = (sphere.vertices + noise) * (1, 1.5, 3)
    return vertices, np.array(sphere.triangles)


def dense(vertices, triangles):
    """∫ ∇φ_i · ∇φ_j from gradients of hat functions, triangle by triangle."""
    matrix = np.zeros((len(vertices), len(vertices)))
    for corners in triangles:
        p = vertices[corners]
        normal = np.cross(p[1] - p[0], p[2] - p[0])
        area = np.linalg.norm(normal) / 2
        unit = normal / (2 * area)
        gradient = [np.cross(unit, p[(k + 2) % 3] - p[(k + 1) % 3]) / (2 * area) for k in range(3)]
        matrix[np.ix_(corners, corners)] += area * np.dot(gradient, np.transpose(gradient))
    return matrix


def test_the_matrix_is_that_of_the_hat_functions():
    vertices, triangles = skewed()
    # Sums of a few cotangents of up to a hundred.
    np.testing.assert_allclose(laplacian(vertices, triangles).toarray(), dense(vertices, triangles), atol=1e-11)


def test_energy_of_a_coordinate_on_the_cube():
    cube = shapes.box()
    x = cube.vertices[:, 0]
    for kind in LAPLACIANS:
        # |∇x|² is 1 on four faces of area 1 and 0 on two.
        assert x @ laplacian(cube.vertices, cube.triangles, kind) @ x == pytest.approx(4, rel=1e-14)


@pytest.mark.parametrize("kind", LAPLACIANS)
def test_rows_sum_to_zero_and_the_matrix_is_symmetric(kind):
    matrix = laplacian(*skewed(), kind).toarray()
    np.testing.assert_array_equal(matrix, matrix.T)
    np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-11)


@pytest.mark.parametrize("kind", LAPLACIANS)
def test_triangles_without_area_leave_the_matrix_finite_and_semidefinite(kind):
    vertices, triangles = skewed()
    a, b, c = triangles[7]
    # A vertex on an edge, one in a corner, all three of a triangle in one point: caps, needles, and a point.
    middle = np.array([(vertices[a] + vertices[b]) / 2])
    n = len(vertices)
    split = np.array([[a, b, n], [b, c, n], [c, a, n]])
    triangles = np.concatenate((np.delete(triangles, 7, axis=0), split))
    vertices = np.concatenate((vertices, middle))
    vertices[triangles[50, 0]] = vertices[triangles[50, 1]]
    vertices[triangles[90]] = vertices[triangles[90, 0]]
    matrix = laplacian(vertices, triangles, kind).toarray()
    assert np.isfinite(matrix).all()
    eigenvalues = np.linalg.eigvalsh(matrix)
    # Rounding of a matrix with entries up to a million.
    assert eigenvalues[0] >= -1e-13 * eigenvalues[-1]


def test_areas_from_lengths():
    vertices, triangles = skewed()
    p = vertices[triangles]
    truth = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    np.testing.assert_allclose(double_areas(edge_lengths(vertices, triangles)), truth, rtol=1e-11)
    # A needle of height 1e-12: Heron's formula as it is in books returns no digit of it.
    np.testing.assert_allclose(double_areas(np.array([[1.0, 1.0, 1e-12]])), [1e-12], rtol=1e-14)
    assert lumped_mass(vertices, triangles).sum() == pytest.approx(truth.sum() / 2, rel=1e-13)


def angles(lengths):
    return np.arctan2(1.0, cotangents(lengths))


def test_flips_make_every_edge_delaunay_and_leave_the_surface_alone():
    vertices, triangles = skewed()
    lengths = edge_lengths(vertices, triangles)
    flipped, new_lengths = intrinsic_delaunay(triangles, lengths)
    assert (np.sort(flipped, axis=1) != np.sort(triangles, axis=1)).any()
    matrix = laplacian(vertices, triangles, "intrinsic_delaunay").toarray()
    # −L_ij is a sum of cotangents, of edges that all are Delaunay: at least 0.
    assert (matrix - np.diag(np.diag(matrix))).max() <= 1e-12
    assert (dense(vertices, triangles) - np.diag(np.diag(dense(vertices, triangles)))).max() > 0.1
    # Gauss: area and the angle around each vertex belong to the surface, not to its triangulation.
    assert double_areas(new_lengths).sum() == pytest.approx(double_areas(lengths).sum(), rel=1e-11)
    before = np.bincount(triangles.ravel(), weights=angles(lengths).ravel())
    after = np.bincount(flipped.ravel(), weights=angles(new_lengths).ravel())
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_delaunay_triangulations_have_the_least_energy(rng):
    # Rippa's theorem, which holds on surfaces too.
    vertices, triangles = skewed()
    values = rng.normal(size=len(vertices))
    given = values @ laplacian(vertices, triangles) @ values
    assert values @ laplacian(vertices, triangles, "intrinsic_delaunay") @ values < given


def test_delaunay_triangles_stay():
    sphere = shapes.sphere(5)
    lengths = edge_lengths(sphere.vertices, sphere.triangles)
    triangles, same = intrinsic_delaunay(np.array(sphere.triangles), lengths)
    np.testing.assert_array_equal(triangles, sphere.triangles)
    np.testing.assert_array_equal(same, lengths)


def test_solvers_agree_with_a_dense_one(rng):
    vertices, triangles = skewed()
    matrix = laplacian(vertices, triangles)
    solver = PinnedLaplacian(matrix, pin=5)
    right = rng.normal(size=(len(vertices), 2))
    right -= right.mean(axis=0)
    found = solver.solve(right)
    np.testing.assert_allclose(matrix @ found, right, atol=1e-10)
    np.testing.assert_allclose(found[5], 0, atol=1e-10)
    mass = 4 * np.pi * lumped_mass(vertices, triangles) / lumped_mass(vertices, triangles).sum()
    truth = np.linalg.solve(matrix.toarray() + np.diag(mass), mass[:, None] * vertices)
    # Conjugate gradients stop at seven digits of the first residual, in the norm of the energy.
    found = solver.solve_with_mass(mass, mass[:, None] * vertices, vertices)
    np.testing.assert_allclose(found, truth, atol=1e-6)
