"""What belongs to vertices goes into files and comes out of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d import GeometryReadWarning, MeshArrays, PointArrays
from fsh3d_o3d.files import read_geometry_arrays

VERTICES, TRIANGLES = fsh.icosphere(2)
COLORS = np.rint(255 * (VERTICES + 1) / 2) / 255  # which eight bits hold
SMOOTH = VERTICES[TRIANGLES][:, :, :2]  # one place in the texture for each vertex
TORN = np.random.default_rng(1).random((len(TRIANGLES), 3, 2)).astype(np.float32).astype(np.float64)  # one a corner
ATTRIBUTES = {"height": VERTICES[:, 2], "a vector": 2 * VERTICES, "x": VERTICES[:, 0], "label_1": np.arange(42.0)}


@pytest.mark.parametrize("uvs", [None, SMOOTH, TORN], ids=["plain", "smooth", "torn"])
@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.off", "a.glb"])
def test_what_a_mesh_has_comes_back(name, uvs, tmp_path):
    mesh = MeshArrays(VERTICES, TRIANGLES, VERTICES, COLORS, uvs, ATTRIBUTES)
    fsh.write_geometry(tmp_path / name, mesh)
    again = read_geometry_arrays(tmp_path / name)
    tolerance = 1e-6 if name == "a.glb" else 0  # float32
    corners = mesh.triangles
    for own in (
        "vertices",
        "normals",
        "colors",
    ):  # at the corners, because glTF has more vertices where a texture is torn
        found, expected = getattr(again, own)[again.triangles], getattr(mesh, own)[corners]
        np.testing.assert_allclose(found, expected, rtol=0, atol=max(tolerance, 1e-15), err_msg=own)
    if uvs is None or name == "a.off":
        assert again.texture_uvs is None
    else:
        np.testing.assert_allclose(again.texture_uvs, uvs, rtol=0, atol=max(tolerance, 1e-15))
    if uvs is None or uvs is SMOOTH:
        assert len(again.vertices) == len(VERTICES)
    assert sorted(again.attributes) == (["a_vector", "height", "label_1", "x_"] if name == "a.ply" else [])
    if name == "a.ply":
        np.testing.assert_array_equal(again.attributes["a_vector"], 2 * VERTICES)
        np.testing.assert_array_equal(again.attributes["x_"], VERTICES[:, 0])


def test_what_a_cloud_has_comes_back(tmp_path):
    fsh.write_geometry(tmp_path / "a.ply", PointArrays(VERTICES, VERTICES, COLORS, {"height": VERTICES[:, 2]}))
    assert read_geometry_arrays(tmp_path / "a.ply") == PointArrays(
        VERTICES, VERTICES, COLORS, {"height": VERTICES[:, 2]}
    )


def test_colours_survive_the_way_through_a_shape(tmp_path):
    """From a coloured file to a coloured file, with nothing asked for."""
    vertices, triangles = fsh.icosphere(8)
    fsh.write_geometry(tmp_path / "in.ply", MeshArrays(vertices, triangles, None, (vertices + 1) / 2))
    for shape in (fsh.RadialShape, fsh.ShellShape, fsh.ConformalShape):
        fsh.write_geometry(tmp_path / "out.glb", shape.from_geometry(tmp_path / "in.ply", 8))
        again = read_geometry_arrays(tmp_path / "out.glb")
        directions = again.vertices / np.linalg.norm(again.vertices, axis=1, keepdims=True)
        # Eight bits, eight degrees, and a Gaussian's surface that lies its width off.
        assert np.abs(again.colors - (directions + 1) / 2).max() < 0.05, shape


QUAD = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
SQUARE_UVS = {(0, 0), (1, 0), (1, 1), (0, 1)}


@pytest.mark.parametrize(
    ("faces", "textured", "normals"),
    [
        (b"f 1/1/1 2/2/1 3/3/1 4/4/1\n", True, True),
        (b"f 1/1 2/2 3/3 4/4\n", True, False),
        (b"f 1//1 2//1 3//1 4//1\n", False, True),
        (b"f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1\n", True, True),
        (b"f 1/1 2/2 3/3\nf 1 3 4\n", False, False),  # mixed
        (b"f 1 2 3 4\n", False, False),
    ],
)
def test_obj_corners(faces, textured, normals, tmp_path):
    (tmp_path / "q.obj").write_bytes(QUAD + faces)
    mesh = read_geometry_arrays(tmp_path / "q.obj")
    assert len(mesh.triangles) == 2
    if textured:
        np.testing.assert_array_equal(mesh.texture_uvs, mesh.vertices[mesh.triangles][:, :, :2])
    else:
        assert mesh.texture_uvs is None
    if normals:
        np.testing.assert_array_equal(mesh.normals, np.tile([0.0, 0, 1], (4, 1)))
    else:
        assert mesh.normals is None


def test_corners_of_concave_polygons_keep_their_places(tmp_path):
    """An L of six corners: its triangles are not a fan, and each corner still has its own place."""
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    text = "".join(f"v {x} {y} 0\nvt {x / 2} {y / 2}\n" for x, y in corners)
    (tmp_path / "l.obj").write_text(text + "f " + " ".join(f"{k}/{k}" for k in (4, 5, 6, 1, 2, 3)) + "\n")
    mesh = read_geometry_arrays(tmp_path / "l.obj")
    np.testing.assert_array_equal(mesh.texture_uvs, mesh.vertices[mesh.triangles][:, :, :2] / 2)


def test_creases_have_the_mean_of_their_normals(tmp_path):
    roof = b"v 0 0 0\nv 1 0 0\nv 0 1 1\nv 0 -1 1\nvn 0 -1 1\nvn 0 1 1\nf 1//1 2//1 3//1\nf 2//2 1//2 4//2\n"
    (tmp_path / "r.obj").write_bytes(roof)
    np.testing.assert_allclose(read_geometry_arrays(tmp_path / "r.obj").normals[:2], [[0, 0, 1], [0, 0, 1]])


@pytest.mark.parametrize(
    ("name", "content", "note"),
    [
        ("a.obj", QUAD + b"f 1/9 2/9 3/9\n", "texture coordinates that the file does not have"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            b"property float quality\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            b"0 0 0 1\n1 0 0 nan\n0 1 0 2\n3 0 1 2\n",
            "'quality' of some vertices are not finite",
        ),
    ],
)
def test_a_surface_is_read_without_what_is_damaged(name, content, note, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.warns(GeometryReadWarning, match=note):
        mesh = read_geometry_arrays(tmp_path / name)
    assert (mesh.texture_uvs, mesh.colors, dict(mesh.attributes)) == (None, None, {})


def test_damaged_normals_of_gltf_are_left_out(tmp_path):
    fsh.write_geometry(tmp_path / "a.glb", MeshArrays(VERTICES, TRIANGLES, VERTICES, COLORS))
    data = (tmp_path / "a.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + size])
    tree["accessors"][1]["count"] -= 1  # of the normals
    text = json.dumps(tree, separators=(",", ":")).encode().ljust(size)
    (tmp_path / "a.glb").write_bytes(data[:20] + text + data[20 + size :])
    with pytest.warns(GeometryReadWarning, match="NORMAL has 41 items for 42 vertices; it was left out"):
        mesh = read_geometry_arrays(tmp_path / "a.glb")
    assert mesh.normals is None
    assert mesh.colors is not None


def test_gaps_are_not_carried():
    holes = np.where(VERTICES[:, 2] > 0.9, np.nan, 1.0)
    shape = fsh.RadialShape.from_geometry(
        MeshArrays(VERTICES, TRIANGLES, attributes={"q": holes, "h": VERTICES[:, 2]}), 4
    )
    assert list(shape.attributes) == ["h"]
