"""Values at vertices: they follow what happens to a mesh, and go from one surface to another."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import MeshArrays, PointArrays
from fsh3d_o3d.geometry import oriented, rearranged, transformed, values_near, weld, with_values_of, without_collapsed
from fsh3d_o3d.geometry.arrays import turned_over

VERTICES, TRIANGLES = fsh.icosphere(3)
COLORS = (VERTICES + 1) / 2
MESH = MeshArrays(VERTICES, TRIANGLES, VERTICES, COLORS, VERTICES[TRIANGLES][:, :, :2], {"twice": 2 * VERTICES})


def agrees(mesh):
    """Whether all values of a mesh still say where its vertices are."""
    np.testing.assert_array_equal(mesh.normals, mesh.vertices)
    np.testing.assert_array_equal(mesh.colors, (mesh.vertices + 1) / 2)
    np.testing.assert_array_equal(mesh.attributes["twice"], 2 * mesh.vertices)
    np.testing.assert_array_equal(mesh.texture_uvs, mesh.vertices[mesh.triangles][:, :, :2])


def soup(mesh):
    """Every triangle with corners of its own, two copies of each vertex unused, and one triangle collapsed."""
    rows = mesh.triangles.ravel()
    triangles = np.arange(len(rows)).reshape(-1, 3)
    triangles = np.concatenate((triangles, [[0, 0, 1]]))
    loose = rearranged(mesh, rows, triangles[:-1])
    uvs = np.concatenate((loose.texture_uvs, loose.texture_uvs[:1, [0, 0, 1]]))
    return MeshArrays(loose.vertices, triangles, loose.normals, loose.colors, uvs, loose.attributes)


def test_values_follow_their_vertices():
    turned = turned_over(MESH, np.arange(len(TRIANGLES)) % 3 == 0)
    agrees(turned)
    loose = soup(turned)
    agrees(loose)
    agrees(without_collapsed(loose))
    welded = weld(loose)
    assert welded.vertices.shape == VERTICES.shape
    agrees(welded)
    agrees(oriented(welded))
    agrees(MeshArrays(VERTICES, TRIANGLES[:9], VERTICES, COLORS, MESH.texture_uvs[:9], MESH.attributes).compact()[0])


def test_colours_stay_while_normals_turn():
    mirror = np.diag([1.0, 1, -1, 1])
    moved = transformed(MESH, mirror)
    np.testing.assert_array_equal(moved.normals, moved.vertices)
    np.testing.assert_array_equal(moved.colors, COLORS)
    # In the plane the texture does not change, whichever way its triangles are wound.
    np.testing.assert_array_equal(moved.texture_uvs, moved.vertices[moved.triangles][:, :, :2])


def test_values_come_from_the_closest_point(random_rotation):
    def moved(points):
        return points @ (3 * random_rotation).T + (10, 20, 30)

    there = MeshArrays(moved(VERTICES), TRIANGLES, None, COLORS, MESH.texture_uvs, MESH.attributes)
    points = VERTICES[TRIANGLES[::7]].mean(axis=1)
    found = values_near(there, moved(points * 1.01))
    # A point above the middle of a triangle: linear functions are interpolated exactly, but for the hundredth of a
    # radius that the foot is beside the middle where triangles are not quite regular.
    np.testing.assert_allclose(found["colors"], (points + 1) / 2, atol=1e-3)
    np.testing.assert_allclose(found["twice"], 2 * points, atol=2e-3)
    np.testing.assert_allclose(found["texture_uvs"], points[:, :2], atol=1e-3)
    assert values_near(MeshArrays(VERTICES, TRIANGLES), points) == {}


def test_values_at_vertices_are_those_of_the_vertices():
    again = with_values_of(MESH, MeshArrays(VERTICES, TRIANGLES))
    np.testing.assert_allclose(again.colors, COLORS, atol=1e-12)
    np.testing.assert_allclose(again.attributes["twice"], 2 * VERTICES, atol=1e-12)


def test_triangles_without_area_give_what_their_corners_have():
    line = MeshArrays(
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 5, 0]]), np.array([[0, 1, 2], [0, 0, 3]]), None, np.eye(4, 3)
    )
    found = values_near(line, np.array([[1.9, 1.0, 0.0]]))
    np.testing.assert_array_equal(found["colors"], [[0, 0, 1]])


def test_clouds_give_what_their_nearest_point_has():
    cloud = PointArrays(VERTICES, None, COLORS, {"height": VERTICES[:, 2]})
    found = values_near(cloud, 1.1 * VERTICES[::3])
    np.testing.assert_array_equal(found["colors"], COLORS[::3])
    np.testing.assert_array_equal(found["height"], VERTICES[::3, 2])


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
@pytest.mark.parametrize("shape", [fsh.RadialShape, fsh.ShellShape, fsh.ConformalShape])
def test_all_shapes_carry_all_values(shape, kind, tmp_path, random_rotation):
    """Values that are linear in position come back as what they are, as far as nine degrees tell."""
    if kind == "cloud" and shape is fsh.ConformalShape:
        pytest.skip("takes meshes alone")
    vertices, triangles = fsh.icosphere(4)
    vertices = vertices * (1.0, 1.1, 1.2)
    values = {"colors": (vertices + 1.2) / 2.4, "attributes": {"height": vertices[:, 2], "twice": 2 * vertices}}
    if kind == "mesh":
        given = MeshArrays(
            vertices, triangles, None, values["colors"], vertices[triangles][:, :, :2], values["attributes"]
        )
    else:
        given = PointArrays(vertices, vertices, values["colors"], values["attributes"])
    encoded = shape.from_geometry(fsh.to_open3d(given, kind="tensor"), 9, attributes={"extra": vertices[:, 0]})
    encoded.save(tmp_path / "shape.npz")
    assert fsh.load_shape(tmp_path / "shape.npz") == encoded
    turned = encoded.rotated(random_rotation)
    # Where the values were taken is at most a few hundredths from where they are: a Gaussian's surface is its width
    # off, and a cloud's nearest point up to half a spacing.
    tolerance = {"mesh": 0.05, "cloud": 0.15}[kind] + 0.1 * (shape is fsh.ShellShape)
    for one, back in ((encoded, np.eye(3)), (turned, random_rotation)):
        for decoded in (fsh.from_any(one.to_triangle_mesh()), fsh.from_any(one.to_point_cloud(300))):
            points = decoded.vertices if isinstance(decoded, MeshArrays) else decoded.points
            points = (points - one.center) @ back + one.center
            np.testing.assert_allclose(decoded.colors, np.clip((points + 1.2) / 2.4, 0, 1), atol=tolerance)
            np.testing.assert_allclose(decoded.attributes["twice"], 2 * points, atol=2.4 * tolerance)
            np.testing.assert_allclose(decoded.attributes["extra"], points[:, 0], atol=2 * tolerance)
            if kind == "mesh" and isinstance(decoded, MeshArrays):
                found = decoded.texture_uvs - points[decoded.triangles][:, :, :2]
                assert np.abs(found).max() < 2 * tolerance
    assert shape.from_geometry(given, 4, carry=False).attributes == {}
    assert encoded.truncated(3).attributes["colors"].shape[-1] == 9
