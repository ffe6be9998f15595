import numpy as np
import pytest

from fsh3d_o3d.sphere_map.laplacian import (
    PinnedLaplacian,
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
    # |∇x|² is 1 on four faces of area 1 and 0 on two.
    assert x @ laplacian(cube.vertices, cube.triangles) @ x == pytest.approx(4, rel=1e-14)


def test_rows_sum_to_zero_and_the_matrix_is_symmetric():
    matrix = laplacian(*skewed()).toarray()
    np.testing.assert_array_equal(matrix, matrix.T)
    np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-11)


def test_triangles_without_area_leave_the_matrix_finite_and_semidefinite():
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
    matrix = laplacian(vertices, triangles).toarray()
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
