"""Similarities: where points, normals and the outside of a mesh go."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.similarity import transformed
from fsh3d_o3d.geometry.triangulation import sphere_mesh


@pytest.mark.parametrize("scale", [3.0, -3.0])  # the second mirrors
def test_normals_turn_and_keep_their_length(random_rotation, scale):
    points = np.random.default_rng(3).normal(size=(20, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    colors = np.abs(normals)
    onto = np.eye(4)
    onto[:3, :3], onto[:3, 3] = scale * random_rotation, (1, 2, 3)
    cloud = transformed(PointArrays(points, normals, colors), onto)
    # Rounding of products of order one.
    np.testing.assert_allclose(cloud.points, scale * points @ random_rotation.T + (1, 2, 3), atol=1e-14)
    np.testing.assert_allclose(cloud.normals, np.sign(scale) * normals @ random_rotation.T, atol=1e-14)
    np.testing.assert_array_equal(cloud.colors, colors)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mesh_faces_outward_even_when_mirrored(random_rotation, mirrored):
    mesh = MeshArrays(*sphere_mesh(42))
    onto = np.eye(4)
    onto[:3, :3] = 2 * random_rotation @ np.diag([1, 1, -1 if mirrored else 1])
    # Eight times the volume under the triangles as they are wound, to rounding.
    assert signed_volume(transformed(mesh, onto)) == pytest.approx(8 * signed_volume(mesh), rel=1e-12)


def signed_volume(mesh):
    """The volume of a closed mesh, > 0 if its triangles face outward."""
    return np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6
