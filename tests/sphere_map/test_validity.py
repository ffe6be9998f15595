import numpy as np
import pytest

from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere_map.validity import conformality_deficit, degree, distortion, is_valid, orientations, solid_angles
from tests.geometry import mesh_shapes as shapes


def test_an_octant_is_an_eighth_of_the_sphere():
    octant = np.array([[0, 1, 2]])
    # 4π / 8 within some ulps.
    np.testing.assert_allclose(solid_angles(np.eye(3), octant), np.pi / 2, rtol=1e-15)
    np.testing.assert_allclose(solid_angles(np.eye(3), octant[:, ::-1]), -np.pi / 2, rtol=1e-15)
    assert orientations(np.eye(3), octant) == [1]


def test_the_sphere_itself_is_valid_and_covered_once():
    sphere, triangles = icosphere(12)
    # A sum of some thousand angles of one size.
    assert solid_angles(sphere, triangles).sum() == pytest.approx(4 * np.pi, rel=1e-13)
    assert is_valid(sphere, triangles)
    assert degree(-sphere, triangles) == -1
    assert not is_valid(-sphere, triangles)


def test_one_vertex_beyond_its_neighbours_flips_triangles_but_not_the_degree():
    sphere, triangles = icosphere(12)
    moved = sphere.copy()
    moved[100] = moved[100] + (0.3, -0.2, 0.4)  # lengths do not matter to the sign
    moved[100] /= np.linalg.norm(moved[100])
    assert (orientations(moved, triangles) <= 0).any()
    assert not is_valid(moved, triangles)
    assert degree(moved, triangles) == 1


def test_nan_is_not_valid():
    sphere, triangles = icosphere(4)
    assert not is_valid(np.where(np.arange(len(sphere))[:, None] == 3, np.nan, sphere), triangles)


def test_a_map_that_covers_the_sphere_twice_has_degree_two():
    # z → z² in stereographic coordinates: longitudes double, and almost every triangle stays positive.
    sphere, triangles = icosphere(40)
    x, y, z = sphere.T
    tangent = np.clip((1 - z) / np.maximum(np.hypot(x, y), 1e-12), 1e-9, 1e9) ** 2
    azimuth = 2 * np.arctan2(y, x)
    colatitude = 2 * np.arctan(tangent)
    twice = np.column_stack(
        (np.sin(colatitude) * np.cos(azimuth), np.sin(colatitude) * np.sin(azimuth), np.cos(colatitude))
    )
    assert degree(twice, triangles) == 2
    assert not is_valid(twice, triangles)


def test_the_sign_holds_where_triangles_are_far_below_rounding_of_the_sphere():
    # Edges of 1e-12: the determinant is 1e-24, its terms of order one cancel all digits unless differences come first.
    direction = np.array([0.6, 0.0, 0.8])
    across, up = np.array([0.8, 0.0, -0.6]), np.array([0.0, 1.0, 0.0])
    corners = np.stack((direction, direction + 1e-12 * across, direction + 1e-12 * up))
    assert orientations(corners, np.array([[0, 2, 1]]))[0] < 0 < orientations(corners, np.array([[0, 1, 2]]))[0]


def test_distortion_is_that_of_the_jacobians(rng):
    mesh = shapes.bumpy(3)
    sphere, triangles = icosphere(3)
    image = sphere * (1, 1.3, 0.8)
    weight, ratio, area = [], [], []
    for corners, to in zip(mesh.vertices[triangles], image[triangles], strict=True):
        _, r = np.linalg.qr((corners[1:] - corners[0]).T)
        singular = np.linalg.svd((to[1:] - to[0]).T @ np.linalg.inv(r), compute_uv=False)
        weight.append(abs(np.linalg.det(r)))
        ratio.append(singular[0] / singular[1])
        area.append(singular[0] * singular[1])
    weight = np.array(weight) / np.sum(weight)
    stretch = np.log(np.array(area) / (weight * area).sum())
    found = distortion(mesh.vertices, triangles, image)
    # A quotient of squares: half the digits where the ratio is one, which here it is nowhere.
    assert found.mean == pytest.approx(weight @ ratio, rel=1e-10)
    assert found.area == pytest.approx(np.sqrt(weight @ stretch**2), rel=1e-12)
    over = weight[np.array(ratio) > found.percentile_99 * (1 + 1e-9)].sum()
    assert over <= 0.01 < over + weight.max() * 2
    ratios = np.array(ratio)
    assert conformality_deficit(mesh.vertices, triangles, image) == pytest.approx(
        weight @ (1 - 2 * ratios / (1 + ratios**2)), rel=1e-10
    )


def test_a_similarity_has_no_distortion():
    mesh = shapes.bumpy(4)
    found = distortion(mesh.vertices, mesh.triangles, 3 * mesh.vertices)
    # The ratio is 1 + √(rounding).
    assert found.mean == pytest.approx(1, abs=1e-6)
    assert found.area == pytest.approx(0, abs=1e-12)
    assert conformality_deficit(mesh.vertices, mesh.triangles, 3 * mesh.vertices) == pytest.approx(0, abs=1e-12)


def test_inside_out_is_the_largest_deficit():
    sphere, triangles = icosphere(6)
    assert conformality_deficit(sphere, triangles, -sphere) == pytest.approx(2, abs=1e-12)


def test_triangles_without_area_weigh_nothing():
    mesh = shapes.bumpy(4)
    image = mesh.vertices * (1, 2, 3)
    flat = np.concatenate((mesh.triangles, [[0, 0, 1]]))
    assert distortion(mesh.vertices, flat, image) == distortion(mesh.vertices, mesh.triangles, image)
