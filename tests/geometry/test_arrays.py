"""Arrays that are handed out go into Open3D's own, and what is kept does not change with them."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry import MeshArrays, PointArrays, repair_mesh

KINDS = ("legacy", "tensor")


def ellipsoid(kind="legacy"):
    """A closed mesh of 42 vertices with half axes 1, 2 and 3."""
    directions, triangles = fsh.icosphere(2)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(directions * [1.0, 2.0, 3.0]), o3d.utility.Vector3iVector(triangles)
    )
    return mesh if kind == "legacy" else o3d.t.geometry.TriangleMesh.from_legacy(mesh)


def handed_out():
    """Name and (n, 3) array of everything public that holds points, directions, colours or triangles."""
    mesh, directions = ellipsoid(), fsh.icosphere(2)[0]
    closing, flat = fsh.prepare_closed(mesh), fsh.conformal_map(mesh)
    cloud = PointArrays(directions, directions, np.abs(directions))
    radial = fsh.RadialShape.from_geometry(mesh, 4)
    surface, normals = radial.mesh_arrays(100)
    mended = repair_mesh(mesh)
    grid = fsh.fibonacci_grid(50)
    for name, arrays in (("closing", closing.mesh), ("map", flat.mesh), ("decoded", surface), ("mended", mended.mesh)):
        yield f"{name} vertices", arrays.vertices
        yield f"{name} triangles", arrays.triangles
    yield from zip(("points", "normals", "colors"), (cloud.points, cloud.normals, cloud.colors), strict=True)
    yield from (("map positions", flat.positions), ("decoded normals", normals))
    yield from zip(("icosphere", "icosphere triangles"), fsh.icosphere(2), strict=True)
    makers = (fsh.equiangular_grid(4), fsh.healpix_grid(2), fsh.icosahedral_grid(2), fsh.cube_grid(3), grid)
    yield from ((one.name, one.directions) for one in makers)
    yield "scattered", fsh.grid_from_directions(directions).directions


def test_what_is_handed_out_goes_into_open3d():
    for name, array in handed_out():
        whole = array.dtype.kind == "i"
        vector = (o3d.utility.Vector3iVector if whole else o3d.utility.Vector3dVector)(array)
        np.testing.assert_array_equal(np.asarray(vector), array, err_msg=name)
        np.testing.assert_array_equal(o3d.core.Tensor(array).numpy(), array, err_msg=name)


def test_grids_do_not_change_with_what_they_hand_out():
    before = fsh.fibonacci_grid(50).directions
    for write in (lambda: fsh.fibonacci_grid(50).directions, lambda: fsh.icosphere(3)[0], lambda: fsh.icosphere(3)[1]):
        write()[:] = 0
    np.testing.assert_array_equal(fsh.fibonacci_grid(50).directions, before)
    assert all(array.any() for array in fsh.icosphere(3))
    with pytest.raises(AttributeError, match="cannot assign"):
        fsh.fibonacci_grid(50).directions = before


def test_values_do_not_change_with_what_they_were_given():
    vertices, triangles = fsh.icosphere(2)
    mesh, cloud = MeshArrays(vertices, triangles), PointArrays(vertices, vertices, np.abs(vertices))
    kept = [mesh.vertices, mesh.triangles, cloud.points, cloud.normals, cloud.colors]
    assert not any(np.shares_memory(one, other) for one in kept for other in (vertices, triangles))
    for open3d in (fsh.prepare_closed(mesh).to_triangle_mesh(), fsh.conformal_map(mesh).to_triangle_mesh()):
        np.asarray(open3d.vertices)[:] = 0
    np.testing.assert_array_equal(mesh.vertices, vertices)


@pytest.mark.parametrize("make", [fsh.prepare_closed, fsh.conformal_map, repair_mesh], ids=lambda make: make.__name__)
@pytest.mark.parametrize("kind", KINDS)
def test_surfaces_come_back_as_they_went_in(make, kind):
    result = make(ellipsoid(kind))
    own = {"legacy": o3d.geometry.TriangleMesh, "tensor": o3d.t.geometry.TriangleMesh}
    assert type(result.to_triangle_mesh()) is own[kind]
    for wanted in KINDS:
        mesh = result.to_triangle_mesh(kind=wanted)
        assert type(mesh) is own[wanted]
        legacy = mesh if wanted == "legacy" else mesh.to_legacy()
        assert legacy.is_watertight() and legacy.get_volume() == pytest.approx(fsh_volume(result.mesh), rel=1e-6)
    with pytest.raises(ValueError, match="kind"):
        result.to_triangle_mesh(kind="triangle soup")


def fsh_volume(mesh):
    """Sum of the signed tetrahedra over the origin."""
    return float(np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6)


def test_a_map_can_be_seen_on_the_sphere():
    result = fsh.conformal_map(ellipsoid())
    np.testing.assert_array_equal(np.asarray(result.to_triangle_mesh(on_sphere=True).vertices), result.positions)
    np.testing.assert_array_equal(np.asarray(result.to_triangle_mesh().vertices), result.mesh.vertices)


def test_a_cloud_cannot_be_repaired():
    with pytest.raises(TypeError, match="triangle meshes"):
        repair_mesh(PointArrays(fsh.icosphere(2)[0]))
