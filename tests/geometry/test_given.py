"""Whatever holds a surface or points: what comes in, with what belongs to it, and what goes out to Open3D."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import GeometryError, MeshArrays, PointArrays
from fsh3d_o3d.geometry import geometry_arrays

VERTICES, TRIANGLES = fsh.icosphere(2)
COLORS = (VERTICES + 1) / 2
HEIGHT = VERTICES[:, 2]
UVS = np.random.default_rng(1).random((len(TRIANGLES), 3, 2))
MESH = MeshArrays(VERTICES, TRIANGLES, VERTICES, COLORS, UVS, {"height": HEIGHT, "twice": 2 * VERTICES})
CLOUD = PointArrays(VERTICES, VERTICES, COLORS, {"height": HEIGHT})


@pytest.mark.parametrize("geometry", [MESH, CLOUD], ids=["mesh", "cloud"])
def test_tensor_geometry_holds_everything(geometry):
    tensor = fsh.to_open3d(geometry, kind="tensor")
    again, kind = geometry_arrays(tensor)
    assert (again, kind) == (geometry, "tensor")
    assert isinstance(fsh.to_open3d(tensor), type(tensor))


def test_legacy_geometry_has_no_place_for_attributes_alone():
    legacy = fsh.to_open3d(MESH)
    assert geometry_arrays(legacy) == (MeshArrays(VERTICES, TRIANGLES, VERTICES, COLORS, UVS), "legacy")
    assert geometry_arrays(fsh.to_open3d(CLOUD)) == (PointArrays(VERTICES, VERTICES, COLORS), "legacy")


def test_texture_coordinates_of_vertices_become_those_of_corners():
    tensor = fsh.to_open3d(MeshArrays(VERTICES, TRIANGLES), kind="tensor")
    tensor.vertex.texture_uvs = o3d.core.Tensor(np.ascontiguousarray(VERTICES[:, :2]))
    np.testing.assert_array_equal(fsh.from_any(tensor).texture_uvs, VERTICES[:, :2][TRIANGLES])


@pytest.mark.parametrize(
    "given",
    [
        (VERTICES, TRIANGLES),
        [VERTICES.tolist(), TRIANGLES.tolist()],
        (VERTICES.astype(np.float32).astype(np.float64), TRIANGLES.astype(np.float64)),  # as np.loadtxt reads them
    ],
    ids=["arrays", "lists", "floats"],
)
def test_a_pair_of_arrays_is_a_mesh(given):
    mesh = fsh.from_any(given)
    assert isinstance(mesh, MeshArrays)
    np.testing.assert_allclose(mesh.vertices, VERTICES, atol=1e-7)  # float32 in one of them
    np.testing.assert_array_equal(mesh.triangles, TRIANGLES)


def test_an_array_is_a_cloud():
    for given in (VERTICES, VERTICES.tolist(), VERTICES[:2], VERTICES[:2].tolist()):
        np.testing.assert_array_equal(fsh.from_any(given).points, np.asarray(given))

    class Tensor:
        """What PyTorch's and others have in common."""

        def __array__(self, dtype=None, copy=None):
            return VERTICES

    np.testing.assert_array_equal(fsh.from_any(Tensor()).points, VERTICES)


def test_paths_and_what_holds_a_surface(tmp_path):
    fsh.write_geometry(tmp_path / "ball.ply", (VERTICES, TRIANGLES))
    for path in (tmp_path / "ball.ply", str(tmp_path / "ball.ply"), bytes(tmp_path / "ball.ply")):
        np.testing.assert_array_equal(fsh.from_any(path).vertices, VERTICES)
    shape = fsh.RadialShape.from_geometry(fsh.to_open3d(MESH, kind="tensor"), 4)
    mesh, kind = geometry_arrays(shape)
    assert (kind, sorted(mesh.attributes)) == ("tensor", ["height", "twice"])
    np.testing.assert_array_equal(mesh.vertices, shape.mesh_arrays()[0].vertices)
    assert fsh.from_any(fsh.prepare_closed((VERTICES, TRIANGLES))).triangles.shape == TRIANGLES.shape


def test_trimesh_is_recognised_with_its_colours():
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(VERTICES, TRIANGLES, process=False, vertex_colors=np.rint(255 * COLORS).astype(np.uint8))
    mesh.vertex_attributes["height"] = HEIGHT
    found = fsh.from_any(mesh)
    np.testing.assert_allclose(found.colors, COLORS, atol=0.5 / 255 + 1e-12)  # eight bits
    np.testing.assert_array_equal(found.attributes["height"], HEIGHT)
    assert found.normals is None  # trimesh would compute them only now
    cloud = trimesh.PointCloud(VERTICES, colors=np.rint(255 * COLORS).astype(np.uint8))
    np.testing.assert_allclose(fsh.from_any(cloud).colors, COLORS, atol=0.5 / 255 + 1e-12)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(trimesh.Trimesh(VERTICES, TRIANGLES, process=False))
    both = fsh.from_any(scene)
    assert (len(both.triangles), both.vertices[:, 0].max()) == (
        2 * len(TRIANGLES),
        pytest.approx(5 + VERTICES[:, 0].max()),
    )
    with pytest.raises(GeometryError, match="holds no mesh"):
        fsh.from_any(trimesh.Scene())


def test_texture_of_trimesh_is_sampled_at_the_vertices():
    trimesh = pytest.importorskip("trimesh")
    image = pytest.importorskip("PIL.Image").new("RGB", (4, 4), (255, 0, 0))
    visual = trimesh.visual.TextureVisuals(uv=np.abs(VERTICES[:, :2]), image=image)
    found = fsh.from_any(trimesh.Trimesh(VERTICES, TRIANGLES, process=False, visual=visual))
    np.testing.assert_allclose(found.colors, np.tile([1.0, 0, 0], (len(VERTICES), 1)))
    np.testing.assert_allclose(found.texture_uvs, np.abs(VERTICES[:, :2])[TRIANGLES])


def test_every_function_takes_everything(tmp_path):
    """The same mesh as arrays, as a file and as Open3D's, to functions of all folders."""
    vertices = VERTICES * (1.0, 1.2, 1.4)
    fsh.write_geometry(tmp_path / "egg.ply", (vertices, TRIANGLES))
    given = [(vertices, TRIANGLES), tmp_path / "egg.ply", fsh.to_open3d((vertices, TRIANGLES), kind="tensor")]
    for function in (
        lambda one: fsh.RadialShape.from_geometry(one, 4).coefficients,
        lambda one: fsh.ShellShape.from_geometry(one, 4, 6).coefficients,
        lambda one: fsh.ConformalShape.from_geometry(one, 4).coefficients,
        lambda one: fsh.shd_descriptor(one, fsh.SHDOption(bandwidth=4, shells=4, voxels=16)),
        lambda one: fsh.compute_cpshd_feature(one, fsh.CPSHDOption(bandwidth=4)).data,
        lambda one: fsh.surface_error(one, one, samples=100).rmse,
        lambda one: fsh.repair_mesh(one).mesh.vertices,
        lambda one: fsh.prepare_closed(one).mesh.vertices,
        lambda one: fsh.star_center(one).center,
        lambda one: fsh.vertex_distances(one, one),
        lambda one: fsh.conformal_map(one).positions,
        lambda one: fsh.registration_spherical(one, one).transformation,
    ):
        first, *others = [function(one) for one in given]
        for other in others:
            np.testing.assert_array_equal(other, first)


def test_surfaces_come_back_as_what_they_were():
    mesh = fsh.to_open3d(MESH, kind="tensor")
    kind = o3d.t.geometry.TriangleMesh
    for result in (
        fsh.RadialShape.from_geometry(mesh, 4),
        fsh.ShellShape.from_geometry(mesh, 4, 6),
        fsh.ConformalShape.from_geometry(mesh, 4),
        fsh.repair_mesh(mesh),
        fsh.prepare_closed(mesh),
        fsh.conformal_map(mesh),
    ):
        surface = result.to_triangle_mesh()
        assert isinstance(surface, kind)
        assert {"colors", "height", "twice"} <= {str(name) for name in surface.vertex}, type(result)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        (None, TypeError, "TriangleMesh or PointCloud .* a path, arrays .*, got builtins.NoneType"),
        ([1, "x"], TypeError, "got list"),
        (VERTICES[:, :2], GeometryError, r"\(n, 3\), got \(42, 2\); a mesh is a pair \(V, F\)"),
        ((VERTICES, TRIANGLES + 0.5), GeometryError, "whole numbers"),
        ((VERTICES, TRIANGLES[:, [0, 1, 2, 0]]), GeometryError, r"\(80, 4\); cut its polygons into triangles"),
        ((VERTICES, TRIANGLES + 42), GeometryError, "refer to vertices"),
        (np.full((4, 3), np.nan), GeometryError, "must be finite"),
        (np.empty((0, 3)), GeometryError, "empty"),
        (np.ma.masked_greater(VERTICES, 0.5), ValueError, "must not be masked"),
        (o3d.geometry.LineSet(), TypeError, "LineSet"),
    ],
    ids=str,
)
def test_what_holds_neither_is_refused(given, error, message):
    with pytest.raises(error, match=message):
        fsh.from_any(given)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"colors": COLORS[:-1]}, r"colors must have shape \(42, 3\) like the vertices, got \(41, 3\)"),
        ({"texture_uvs": UVS[:-1]}, r"texture_uvs must have shape \(80, 3, 2\) like the triangles"),
        ({"attributes": {"height": HEIGHT[:-1]}}, r"attribute 'height' must have shape \(42,\)"),
        ({"attributes": {"colors": HEIGHT}}, "name other than positions"),
        ({"attributes": {"\n": HEIGHT}}, "printable name"),
    ],
    ids=str,
)
def test_what_does_not_fit_the_vertices_is_refused(parts, message):
    with pytest.raises(GeometryError, match=message):
        MeshArrays(VERTICES, TRIANGLES, **parts)


def test_trimesh_is_not_imported():
    code = "import sys, fsh3d_o3d as fsh; fsh.from_any(fsh.icosphere(2)); print('trimesh' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
