from __future__ import annotations

import errno
import os
import stat

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import serialise
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.files.writing import WRITABLE_CLOUD_FORMATS, WRITABLE_MESH_FORMATS, write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from tests.files import mutations

EXACT_MESH = (".ply", ".obj", ".off", ".3mf", ".vtp")
NOT_OF_OPEN3D = (
    ".3mf",
    ".vtp",
    ".las",
    ".laz",
)  # what its readers do not know; others look at these in test_exchange.py
MESH = MeshArrays(mutations.VERTICES * np.pi, mutations.TRIANGLES)
CLOUD = PointArrays(mutations.VERTICES * np.pi, mutations.NORMALS, mutations.COLORS / 255)


def legacy_mesh():
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(MESH.vertices)),
        o3d.utility.Vector3iVector(MESH.triangles.astype(np.int32)),
    )
    mesh.vertex_normals = o3d.utility.Vector3dVector(mutations.NORMALS)
    mesh.vertex_colors = o3d.utility.Vector3dVector(mutations.COLORS / 255)
    return mesh


def legacy_cloud():
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(CLOUD.points)))
    cloud.normals = o3d.utility.Vector3dVector(mutations.NORMALS)
    cloud.colors = o3d.utility.Vector3dVector(mutations.COLORS / 255)
    return cloud


def same_surface(a: MeshArrays, b: MeshArrays, tolerance: float) -> None:
    """Triangle by triangle and corner by corner: STL numbers its vertices anew."""
    np.testing.assert_allclose(a.vertices[a.triangles], b.vertices[b.triangles], rtol=tolerance, atol=0)


@pytest.mark.parametrize("suffix", WRITABLE_MESH_FORMATS)
@pytest.mark.parametrize("kind", ["arrays", "legacy", "tensor"])
def test_mesh_comes_back(suffix, kind, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    geometry = MESH if kind == "arrays" else legacy_mesh()
    if kind == "tensor":
        geometry = open3d().t.geometry.TriangleMesh.from_legacy(geometry)
    write_geometry(path, geometry)
    # Half a unit in the last place of float32 for formats, and for tensors, that hold no more.
    exact = suffix in EXACT_MESH and kind != "tensor"
    same_surface(read_geometry_arrays(path), MESH, 0 if exact else 6e-8)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", WRITABLE_CLOUD_FORMATS)
@pytest.mark.parametrize("kind", ["arrays", "legacy", "tensor"])
def test_cloud_comes_back_with_its_attributes(suffix, kind, tmp_path):
    if suffix == ".laz":
        pytest.importorskip("lazrs", reason="lazrs is not installed: the extra of this format is absent")
    path = tmp_path / f"cloud{suffix}"
    geometry = CLOUD if kind == "arrays" else legacy_cloud()
    if kind == "tensor":
        geometry = open3d().t.geometry.PointCloud.from_legacy(geometry)
    write_geometry(path, geometry)
    back = read_geometry_arrays(path)
    tolerance = 0 if suffix != ".pcd" and kind != "tensor" else 6e-8  # half a unit in the last place of float32
    rounded = 5e-9 if suffix in (".las", ".laz") else 0  # half of the scale
    np.testing.assert_allclose(back.points, CLOUD.points, rtol=tolerance, atol=rounded)
    if suffix in (".las", ".laz"):
        assert back.normals is None
    else:
        np.testing.assert_allclose(back.normals, mutations.NORMALS, rtol=tolerance, atol=0)
    if suffix == ".xyz":
        assert back.colors is None
    else:
        np.testing.assert_array_equal(back.colors, mutations.COLORS / 255)  # eight bits, and eight bits they were


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITABLE_MESH_FORMATS if suffix not in NOT_OF_OPEN3D])
def test_open3d_and_trimesh_read_what_is_written(suffix, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    write_geometry(path, legacy_mesh())
    mesh = open3d().io.read_triangle_mesh(str(path))
    corners = np.asarray(mesh.triangles)  # compared at corners, as Open3D numbers the vertices of some formats anew
    np.testing.assert_allclose(np.asarray(mesh.vertices)[corners], MESH.vertices[MESH.triangles], rtol=6e-8)
    assert mesh.has_vertex_colors() == (suffix != ".stl")
    if suffix != ".stl":
        normals, colors = mutations.NORMALS[MESH.triangles], mutations.COLORS[MESH.triangles] / 255
        np.testing.assert_allclose(np.asarray(mesh.vertex_normals)[corners], normals, atol=6e-8)  # float32 in .glb
        np.testing.assert_allclose(np.asarray(mesh.vertex_colors)[corners], colors, atol=6e-8)
    other = trimesh.load_mesh(path, process=False)
    np.testing.assert_allclose(other.vertices[other.faces], MESH.vertices[MESH.triangles], rtol=6e-8)


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITABLE_CLOUD_FORMATS if suffix not in NOT_OF_OPEN3D])
def test_open3d_reads_the_clouds(suffix, tmp_path):
    path = tmp_path / f"cloud{suffix}"
    write_geometry(path, CLOUD)
    cloud = open3d().io.read_point_cloud(str(path))
    np.testing.assert_allclose(np.asarray(cloud.points), CLOUD.points, rtol=6e-8)
    if suffix != ".xyz":
        np.testing.assert_allclose(np.asarray(cloud.normals), mutations.NORMALS, atol=6e-8)
        np.testing.assert_allclose(np.asarray(cloud.colors), mutations.COLORS / 255, atol=1e-15)


def test_stl_normals_point_outward_whatever_the_scale(tmp_path):
    for scale in (1e-30, 1.0, 1e30):
        mesh = MeshArrays(mutations.VERTICES * scale, mutations.TRIANGLES)
        data = serialise.stl_bytes(serialise.Content(mesh.vertices, mesh.triangles, None, None))
        facets = np.frombuffer(data, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")], offset=84)
        sides = np.diff(mutations.VERTICES[mutations.TRIANGLES], axis=1)
        expected = np.cross(sides[:, 0], sides[:, 1])
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(facets["n"], expected, atol=1e-7)  # float32


@settings(max_examples=60)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=30))
def test_text_keeps_every_bit(values):
    points = np.array(values[: len(values) // 3 * 3]).reshape(-1, 3)
    text = serialise.xyz_bytes(serialise.Content(points, None, None, None)).decode()
    np.testing.assert_array_equal([[float(word) for word in line.split()] for line in text.splitlines()], points)


def test_same_geometry_same_bytes(tmp_path):
    for suffix in WRITABLE_MESH_FORMATS:
        for name in "ab":
            write_geometry(tmp_path / f"{name}{suffix}", MESH)
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


# ---- refusals leave everything as it was ----


@pytest.mark.parametrize(
    ("name", "geometry", "error", "reason"),
    [
        ("a.xyzq", MESH, ValueError, r"cannot write '\.xyzq'; meshes go to \.ply"),
        ("a", MESH, ValueError, "without extension"),
        ("a.pcd", MESH, ValueError, r"\.pcd cannot hold a mesh; choose"),
        ("a.obj", CLOUD, ValueError, r"\.obj cannot hold a point cloud"),
        ("a.ply", {"points": [0, 0, 0]}, TypeError, "geometry must be"),
        ("a.stl", MeshArrays(mutations.VERTICES * 1e60, mutations.TRIANGLES), ValueError, "float32"),
        ("a.glb", MeshArrays(mutations.VERTICES * 1e60, mutations.TRIANGLES), ValueError, "float32"),
        ("a.pcd", PointArrays(mutations.VERTICES * 1e60), ValueError, "float32"),
        (
            "a.ply",
            PointArrays(mutations.VERTICES, mutations.VERTICES * np.nan),
            GeometryError,
            "normals must be finite",
        ),
    ],
)
def test_refused_geometry(name, geometry, error, reason, tmp_path):
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(error, match=reason):
        write_geometry(tmp_path / name, geometry)
    assert (tmp_path / name).read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_missing_folder_folder_and_device(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none/a\.ply"):
        write_geometry(tmp_path / "none" / "a.ply", MESH)
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(IsADirectoryError, match=r"folder\.ply"):
        write_geometry(tmp_path / "folder.ply", MESH)
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(OSError, match="not a regular file"):
        write_geometry(tmp_path / "pipe.ply", MESH)
    assert stat.S_ISFIFO((tmp_path / "pipe.ply").stat().st_mode)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(NotADirectoryError):
        write_geometry(tmp_path / "file" / "a.ply", MESH)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("os.open", PermissionError(errno.EACCES, "Permission denied", ".temporary")),
        ("pathlib.Path.replace", OSError(errno.EXDEV, "Cross-device link", ".temporary")),
        ("os.fchmod", KeyboardInterrupt()),
        ("os.fchmod", OSError(errno.ENOSPC, "No space left on device")),
    ],
)
def test_failure_midway_leaves_the_old_file_alone(call, error, tmp_path, monkeypatch):
    """Permissions do not stop root, under which tests may run: the failures are made."""

    def fail(*args: object, **options: object) -> None:
        raise error

    path = tmp_path / "a.ply"
    path.write_bytes(b"old")
    with monkeypatch.context() as patch:
        patch.setattr(call, fail)
        with pytest.raises(type(error)) as caught:
            write_geometry(path, MESH)
    if isinstance(error, OSError):
        assert caught.value.filename == str(path) and caught.value.errno == error.errno
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_atomic_write_permissions_links_and_long_names(tmp_path):
    old = os.umask(0o027)
    try:
        atomic_write_bytes(tmp_path / "new", b"1")
        assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640
        (tmp_path / "kept").write_bytes(b"old")
        (tmp_path / "kept").chmod(0o604)
        atomic_write_bytes(tmp_path / "kept", b"2")
        assert stat.S_IMODE((tmp_path / "kept").stat().st_mode) == 0o604
    finally:
        os.umask(old)
    (tmp_path / "link").symlink_to("kept")
    atomic_write_bytes(str(tmp_path / "link"), b"3")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "kept").read_bytes() == b"3"
    longest = tmp_path / ("n" * 251 + ".ply")
    write_geometry(longest, MESH)
    assert len(read_geometry_arrays(longest).triangles) == 8


def test_relative_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_geometry("a.off", MESH)
    same_surface(read_geometry_arrays("a.off"), MESH, 0)
