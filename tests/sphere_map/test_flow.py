import numpy as np
import pytest

from fsh3d_o3d.sphere_map.flow import harmonic_start, mean_curvature_flow, placed, pole_triangle
from fsh3d_o3d.sphere_map.laplacian import PinnedLaplacian, laplacian
from fsh3d_o3d.sphere_map.validity import conformality_deficit, is_valid
from tests.geometry import mesh_shapes as shapes


def started(mesh):
    vertices, triangles = mesh.vertices, np.array(mesh.triangles)
    pole = pole_triangle(vertices, triangles)
    matrix = PinnedLaplacian(laplacian(vertices, triangles), pin=int(pole[0]))
    return vertices, triangles, harmonic_start(vertices, triangles, pole, matrix), matrix


def test_the_pole_does_not_depend_on_pose_or_size(random_rotation):
    # An icosphere has many congruent triangles, which rounding would tell apart.
    for mesh in (shapes.sphere(9), shapes.bumpy(7)):
        pole = pole_triangle(mesh.vertices, mesh.triangles)
        turned = shapes.moved(mesh, rotation=random_rotation, scale=3.7)
        np.testing.assert_array_equal(pole_triangle(turned.vertices, turned.triangles), pole)


@pytest.mark.parametrize("mesh", [shapes.sphere(10), shapes.bumpy(10), shapes.ellipsoid((1, 1, 2), 10)])
def test_the_harmonic_start_is_valid_and_nearly_conformal(mesh):
    vertices, triangles, start, _ = started(mesh)
    assert is_valid(start, triangles)
    # Errors of second order in the edge length, about 0.1, but for the surroundings of the pole.
    assert conformality_deficit(vertices, triangles, start) < 0.02


def test_the_flow_makes_it_more_conformal_the_finer_the_more():
    deficits = []
    for frequency in (8, 16):
        vertices, triangles, start, matrix = started(shapes.bumpy(frequency))
        flow = mean_curvature_flow(vertices, triangles, start, matrix, steps=20, tolerance=0.02)
        assert 3 <= flow.iterations < 20
        assert is_valid(flow.sphere, triangles)
        found = conformality_deficit(vertices, triangles, flow.sphere)
        assert found < conformality_deficit(vertices, triangles, start)
        deficits.append(found)
    # A squared first-order error: a quarter at half the edge length.
    assert deficits[1] == pytest.approx(deficits[0] / 4, rel=0.1)


def test_no_steps_return_the_start():
    vertices, triangles, start, matrix = started(shapes.bumpy(5))
    flow = mean_curvature_flow(vertices, triangles, start, matrix, steps=0, tolerance=0.02)
    assert flow.iterations == 0
    np.testing.assert_array_equal(flow.sphere, start)


def test_the_sphere_flows_back_to_itself():
    vertices, triangles, start, matrix = started(shapes.sphere(16))
    flow = mean_curvature_flow(vertices, triangles, start, matrix, steps=20, tolerance=0.02)
    # Second order in the edge length: 0.07² / 50 or so.
    np.testing.assert_allclose(placed(flow.sphere, vertices, triangles), vertices, atol=2e-4)
