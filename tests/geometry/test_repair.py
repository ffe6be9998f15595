"""Repair by MeshLab: what was broken on purpose is mended, what was whole stays."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.geometry.repair import repair_mesh
from fsh3d_o3d.sphere.icosahedron import icosphere


def ball(frequency=8):
    return MeshArrays(*icosphere(frequency))


def test_a_whole_mesh_stays():
    repair = repair_mesh(ball())
    assert repair.before.closed
    assert repair.after.closed
    assert len(repair.mesh.triangles) == len(ball().triangles)
    assert repair.after.volume == pytest.approx(repair.before.volume, rel=1e-6)  # MeshLab's float32


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_holes_flips_and_soup_are_mended(offset):
    whole = ball()
    triangles = np.delete(whole.triangles, [0, 5, 100, 101], axis=0)
    triangles[::3] = triangles[::3, ::-1]  # wound the other way
    soup = MeshArrays(whole.vertices[triangles].reshape(-1, 3) + offset, np.arange(3 * len(triangles)).reshape(-1, 3))
    repair = repair_mesh(soup)
    assert not repair.before.closed
    assert repair.after.closed
    assert repair.after.outward
    assert repair.after.genus == 0
    assert repair.after.volume == pytest.approx(measure_mesh(whole).volume, rel=5e-3)  # the caps are flat
    assert np.abs(repair.mesh.vertices.mean(axis=0) - offset).max() < 0.01


def test_duplicate_faces_go():
    whole = ball()
    doubled = MeshArrays(whole.vertices, np.concatenate([whole.triangles, whole.triangles[:50]]))
    repair = repair_mesh(doubled)
    assert not repair.before.edge_manifold
    assert repair.after.closed
    assert len(repair.mesh.triangles) == len(whole.triangles)


def test_holes_may_stay():
    whole = ball()
    open_ = MeshArrays(whole.vertices, whole.triangles[10:])
    assert not repair_mesh(open_, largest_hole=0).after.closed


def test_what_cannot_be_repaired_is_an_error():
    line = MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(GeometryError):
        repair_mesh(line)
    with pytest.raises(ValueError, match="largest_hole must be"):
        repair_mesh(ball(), largest_hole=-1)
