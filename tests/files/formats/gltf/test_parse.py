from __future__ import annotations

import base64
import json
import os
import random
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content, read_file
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from tests.files.formats.gltf.gltf_files import GltfFile
from tests.files.mutations import DAMAGES, NORMALS, TRIANGLES, VERTICES, SampleFile, gltf_tree, pack_glb

# 90 degrees about z; exact but for the square root.
QUARTER = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
CLOSE = {"atol": 1e-6}  # coordinates of a few units, stored as float32


def parse(data: bytes | str, name: str = "/model.glb") -> MeshArrays | PointArrays:
    return parse_content(name, data.encode() if isinstance(data, str) else data).geometry


def notes(data: bytes | str, name: str = "/model.glb") -> tuple[str, ...]:
    return parse_content(name, data.encode() if isinstance(data, str) else data).notes


def refuse(data: bytes | str, reason: str, name: str = "/model.glb") -> None:
    with pytest.raises(GeometryReadError, match=reason) as caught:
        parse(data, name)
    assert len(str(caught.value).splitlines()) == 1 and "cannot be parsed" not in str(caught.value)


def volume(mesh: MeshArrays) -> float:
    """Enclosed volume, positive where triangles face outward."""
    return float(np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6)


def moved(offset: list[float]) -> np.ndarray:
    """The octahedron's vertices somewhere else."""
    return VERTICES + np.array(offset)


OWN_VOLUME = volume(MeshArrays(VERTICES, TRIANGLES))


def placed(nodes: list[dict], **tree: object) -> GltfFile:
    """The octahedron as mesh 0, with nodes of which the first is the root."""
    file = GltfFile(nodes=nodes, scenes=[{"nodes": [0]}], scene=0, **tree)
    file.mesh(file.octahedron())
    return file


# ---- geometry ----


def test_nodes_are_placed_and_mirrored_triangles_turned():
    half_turn = {"rotation": [0, 0, 1, 0], "scale": [2, 2, -2], "translation": [1, 0, 0], "children": [1]}
    inner_node = {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]}
    mesh = parse(placed([{"mesh": 0, **half_turn}, inner_node]).glb())
    outer = VERTICES * [-2, -2, -2] + [1, 0, 0]
    inner = moved([0, 0, 5]) * [-2, -2, -2] + [1, 0, 0]
    np.testing.assert_array_equal(mesh.vertices, np.vstack([outer, inner]))
    # A surface that faces outward still does.
    assert volume(mesh) == pytest.approx(2 * 8 * OWN_VOLUME)


def test_strides_and_triangle_strips():
    tree, _ = gltf_tree()
    points = np.zeros((4, 5), dtype="<f4")
    points[:, :3] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    tree["bufferViews"] = [{"buffer": 0, "byteLength": 80, "byteStride": 20}]
    tree["buffers"] = [{"byteLength": 80}]
    tree["accessors"] = [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}]
    for mode, expected in ((5, [[0, 1, 2], [1, 3, 2]]), (6, [[0, 1, 2], [0, 2, 3]])):
        tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}]
        assert parse(pack_glb(tree, points.tobytes())).triangles.tolist() == expected
    tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 7}]}]
    refuse(pack_glb(tree, points.tobytes()), "unknown mode 7")


def test_what_lies_is_refused():
    tree, binary = gltf_tree()

    def glb(**changes: object) -> bytes:
        return pack_glb({**tree, **changes}, binary)

    bomb = [{"bufferView": 0, "componentType": 5126, "count": 10**15, "type": "VEC3"}, tree["accessors"][1]]
    refuse(glb(accessors=bomb), "exceeds its buffer")
    refuse(glb(accessors=[{**bomb[0], "bufferView": None}, bomb[1]]), "no entry 'None' in bufferViews")
    bare = {key: value for key, value in bomb[0].items() if key != "bufferView"}
    refuse(glb(accessors=[bare, bomb[1]]), "1000000000000000 items and no buffer")
    view, other = tree["bufferViews"]
    refuse(glb(bufferViews=[{**view, "byteStride": 0}, other]), "exceeds")
    refuse(glb(bufferViews=[{**view, "byteLength": 100, "byteOffset": 21}, other]), "buffer view 0 exceeds its buffer")
    refuse(glb(accessors=[{**tree["accessors"][0], "count": 5}, tree["accessors"][1]]), "a face names vertex 5 of 5")
    refuse(glb(accessors=[tree["accessors"][0], {**tree["accessors"][1], "count": 23}]), "23 indices are not triangles")
    refuse(glb(accessors=[tree["accessors"][0], {**tree["accessors"][1], "componentType": 5122}]), "unsigned integers")
    refuse(glb(nodes=[{}]), "places no triangles")
    refuse(b'{"a":' + b"[" * 200_000, "nested too deeply", "/model.gltf")
    short = {**tree, "buffers": [{"byteLength": 500, "uri": "data:;base64," + base64.b64encode(binary).decode()}]}
    refuse(json.dumps(short), "truncated: buffer 0 announces 500 bytes", "/model.gltf")


def test_copies_are_bounded(monkeypatch):
    monkeypatch.setattr("fsh3d_o3d.files.formats.gltf.meshes._MAXIMUM_TRIANGLES", 79)
    file = placed([{"mesh": 0}] * 10)
    file.tree["scenes"] = [{"nodes": list(range(10))}]
    refuse(file.glb(), "the scene places more than 79 triangles")
    one = placed([{"mesh": 0}])
    one.tree["meshes"][0]["primitives"] *= 10
    refuse(one.glb(), "mesh 0 has more than 79 triangles")


def test_buffers_are_decoded_once(monkeypatch):
    """Else a small file with many primitives over one large buffer takes as long as it likes."""
    file = placed([{"mesh": 0}])
    file.tree["meshes"][0]["primitives"] *= 10
    calls: list[object] = []
    decode = base64.b64decode
    monkeypatch.setattr("base64.b64decode", lambda *text, **how: calls.append(text) or decode(*text, **how))
    assert len(parse(file.gltf(), "/model.gltf").triangles) == 80
    assert len(calls) == 1


# ---- what a file requires ----


@pytest.mark.parametrize(
    "name",
    [
        "KHR_materials_unlit",
        "KHR_texture_transform",
        "KHR_texture_basisu",
        "EXT_texture_webp",
        "KHR_lights_punctual",
        "KHR_xmp_json_ld",
        "KHR_animation_pointer",
        "KHR_materials_variants",
        "KHR_mesh_quantization",
    ],
)
def test_required_extensions_that_move_no_vertex(name):
    assert len(parse(placed([{"mesh": 0}], extensionsRequired=[name]).glb()).triangles) == 8


@pytest.mark.parametrize("name", ["ACME_unknown_geometry", "KHR_materials", "XKHR_materials_unlit", "CESIUM_RTC"])
def test_required_extensions_that_are_not_understood(name):
    refuse(placed([{"mesh": 0}], extensionsRequired=[name]).glb(), f"requires .* not understood: {name}$")
    assert len(parse(placed([{"mesh": 0}], extensionsUsed=[name]).glb()).triangles) == 8


@pytest.mark.parametrize("normalized", [True, False])
@pytest.mark.parametrize(("dtype", "scale"), [("i1", 50), ("u1", 60), ("i2", 8000), ("u2", 16000)])
def test_quantized_positions(dtype, scale, normalized):
    stored = np.round((VERTICES + (2 if dtype[0] == "u" else 0)) * scale)
    file = GltfFile(extensionsRequired=["KHR_mesh_quantization"], nodes=[{"mesh": 0}])
    file.mesh(file.octahedron(POSITION=file.array(stored, dtype, normalized=normalized)))
    largest = np.iinfo(dtype).max if normalized else 1
    np.testing.assert_allclose(parse(file.glb()).vertices, stored / largest, rtol=1e-15)


def test_versions():
    refuse('{"asset": {"version": "1.0"}, "nodes": {}, "meshes": {}}', r"version 1\.0 is not read, only 2", "/a.gltf")
    refuse('{"nodes": {"n": {}}, "meshes": {}}', r"version 1\.0 is not read, only 2", "/a.gltf")
    refuse(placed([{"mesh": 0}], asset={"version": "3.0"}).glb(), r"version 3\.0 is not read")
    refuse(placed([{"mesh": 0}], asset={"version": "1e9.0"}).glb(), r"version 1e9\.0 is not read")
    refuse(b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "version 1 is not read, only 2")
    assert len(parse(placed([{"mesh": 0}], asset={"version": "2.1"}).glb()).triangles) == 8


# ---- instances ----


def instancing(**attributes: int) -> dict:
    return {"EXT_mesh_gpu_instancing": {"attributes": attributes}}


@pytest.mark.parametrize("required", [True, False])
def test_instances(required):
    offsets = np.array([[0, 0, 0], [10, 0, 0], [0, 20, 0]])
    scaled = np.array([[1, 1, 1], [2, 1, 1], [1, 1, -1]])
    file = placed([{"mesh": 0, "translation": [0, 0, 7], "children": [1]}, {"mesh": 0}])
    attributes = {
        "TRANSLATION": file.array(offsets),
        "ROTATION": file.array(np.round(np.array([[0, 0, 0, 1], QUARTER, QUARTER]) * 32767), "i2", normalized=True),
        "SCALE": file.array(scaled),
        "_ID": file.array([1, 2, 3], "u2"),
    }
    file.tree["nodes"][0]["extensions"] = instancing(**attributes)
    file.tree["extensionsRequired" if required else "extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    mesh = parse(file.glb())
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    expected = [VERTICES, VERTICES * scaled[1] @ turn.T + offsets[1], VERTICES * scaled[2] @ turn.T + offsets[2]]
    below = moved([0, 0, 7])  # instances move the node's own mesh, not its children
    every = np.vstack([below, *(part + np.array([0, 0, 7]) for part in expected)])
    np.testing.assert_allclose(mesh.vertices, every, atol=2e-4)  # rotations of 16 bits
    parts = [MeshArrays(mesh.vertices, triangles) for triangles in mesh.triangles.reshape(4, 8, 3)]
    np.testing.assert_allclose([volume(part) for part in parts], OWN_VOLUME * np.array([1, 1, 2, 1]), rtol=1e-3)


def test_instances_are_bounded_before_they_are_made(monkeypatch):
    monkeypatch.setattr("fsh3d_o3d.files.formats.gltf.meshes._MAXIMUM_TRIANGLES", 79)
    file = placed([{"mesh": 0}])
    file.tree["nodes"][0]["extensions"] = instancing(
        TRANSLATION=file.accessor(componentType=5126, count=9_999_999, type="VEC3")
    )
    refuse(file.glb(), "the scene places more than 79 triangles")
    file.tree["nodes"][0]["extensions"] = instancing(TRANSLATION=file.array(np.zeros((9, 3))))
    assert len(parse(file.glb()).triangles) == 72


def test_instances_of_different_number():
    file = placed([{"mesh": 0}])
    attributes = {"TRANSLATION": file.array(np.zeros((3, 3))), "SCALE": file.array(np.ones((2, 3)))}
    file.tree["nodes"][0]["extensions"] = instancing(**attributes)
    refuse(file.glb(), "instances of node 0 have attributes of different length")


# ---- skins and morph targets ----


def skinned(joints: np.ndarray, weights: np.ndarray, inverse: np.ndarray | None, nodes: list[dict], **more) -> GltfFile:
    """The octahedron with a skin over nodes 1, 2, …; node 0 has the mesh."""
    file = GltfFile(scenes=[{"nodes": [0, *more.pop("roots", [1])]}], **more)
    attributes = {}
    for number in range(joints.shape[1] // 4):
        part = slice(4 * number, 4 * number + 4)
        attributes[f"JOINTS_{number}"] = file.array(joints[:, part], "u1")
        attributes[f"WEIGHTS_{number}"] = file.array(weights[:, part])
    file.mesh(file.octahedron(**attributes))
    skin = {"joints": list(range(1, len(nodes) + 1))}
    if inverse is not None:
        skin["inverseBindMatrices"] = file.array(inverse.transpose(0, 2, 1).reshape(-1, 16))
    file.tree |= {"skins": [skin], "nodes": [{"mesh": 0, "skin": 0, "scale": [5, 5, 5]}, *nodes]}
    return file


def spread(seed: int, sets: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Joints and weights of the octahedron's vertices, of two joints."""
    rng = np.random.default_rng(seed)
    weights = rng.random((6, 4 * sets))
    return rng.integers(0, 2, (6, 4 * sets)), weights / weights.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("sets", [1, 2])
@pytest.mark.parametrize("reached", [True, False])
def test_joints_move_the_vertices_and_their_node_does_not(sets, reached):
    joints, weights = spread(sets, sets)
    rng = np.random.default_rng(5)
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[:, :3] += 0.1 * rng.standard_normal((2, 3, 4))
    nodes = [{"scale": [3, 3, 3], "children": [2]}, {"translation": [1, 2, 3], "rotation": QUARTER}]
    file = skinned(joints, weights, inverse, nodes, roots=[1] if reached else [])
    first, second = np.diag([3.0, 3, 3, 1]), np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    matrices = np.array([first, first @ second]) @ inverse
    blended = np.einsum("nk,nkij->nij", weights, matrices[joints])
    expected = np.einsum("nij,nj->ni", blended, np.hstack([VERTICES, np.ones((6, 1))]))[:, :3]
    np.testing.assert_allclose(parse(file.glb()).vertices, expected, atol=1e-5)  # float32 in the file
    assert notes(file.glb()) == ()


def test_skin_without_matrices_or_weights():
    joints, weights = spread(0)
    file = skinned(joints, weights, None, [{"scale": [3, 3, 3]}, {"scale": [3, 3, 3]}], roots=[1, 2])
    np.testing.assert_allclose(parse(file.glb()).vertices, 3 * VERTICES, **CLOSE)
    del file.tree["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    np.testing.assert_allclose(parse(file.glb()).vertices, 3 * VERTICES, **CLOSE)
    assert "without weights" in notes(file.glb())[0]


def test_mirroring_joints_leave_a_surface_facing_outward():
    joints, weights = spread(0)
    file = skinned(joints, weights, None, [{"scale": [1, 1, -2]}] * 2, roots=[1, 2])
    assert volume(parse(file.glb())) == pytest.approx(2 * OWN_VOLUME)


def test_weights_that_do_not_add_up():
    joints, weights = spread(0)
    file = skinned(joints, 3 * weights, None, [{"translation": [1, 0, 0]}] * 2, roots=[1, 2])
    np.testing.assert_allclose(parse(file.glb()).vertices, moved([1, 0, 0]), **CLOSE)
    assert "weights that do not add up to 1 were normalised, at vertices: 6" in notes(file.glb())[0]
    none = skinned(joints, 0 * weights, None, [{"translation": [1, 0, 0]}] * 2, roots=[1, 2])
    np.testing.assert_allclose(parse(none.glb()).vertices, moved([1, 0, 0]), **CLOSE)
    bytes_ = skinned(joints, weights, None, [{"translation": [1, 0, 0]}] * 2, roots=[1, 2])
    attributes = bytes_.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = bytes_.array(np.round(255 * weights), "u1", normalized=True)
    np.testing.assert_allclose(parse(bytes_.glb()).vertices, moved([1, 0, 0]), **CLOSE)
    assert notes(bytes_.glb()) == ()


def test_damaged_skins():
    joints, weights = spread(0)
    refuse(skinned(joints + 2, weights, None, [{}, {}], roots=[1, 2]).glb(), "follows joint [23] of a skin with 2")
    assert parse(skinned(joints + 200 * (weights == 0), weights, None, [{}, {}], roots=[1, 2]).glb()) is not None
    refuse(skinned(joints, weights, np.eye(4)[None], [{}, {}], roots=[1, 2]).glb(), "2 joints and 1 matrices")
    file = skinned(joints, weights, None, [{}, {}], roots=[1, 2])
    for skin, reason in (({"joints": []}, "no joints"), ({"joints": [9, 1]}, "no entry '9' in nodes")):
        file.tree["skins"] = [skin]
        refuse(file.glb(), reason)
    ring = skinned(joints, weights, None, [{"children": [2]}, {"children": [1]}], roots=[])
    refuse(ring.glb(), "is above itself")


def test_joint_chains_outside_the_scene_are_walked_once():
    """Ten thousand joints in a chain that the scene does not reach: not each from the top again."""
    count = 10_000
    nodes = [{"translation": [0.001, 0, 0], "children": [number + 2]} for number in range(count - 1)]
    joints, weights = spread(0)
    file = skinned(joints, weights, None, [*nodes, {"translation": [0.001, 0, 0]}], roots=[])
    file.tree["skins"][0]["joints"] = [count] * 2 + list(range(1, count + 1))[::-1]
    np.testing.assert_allclose(parse(file.glb()).vertices, moved([0.001 * count, 0, 0]), **CLOSE)


def test_morph_targets_have_the_weights_of_the_node_or_the_mesh():
    file = GltfFile(nodes=[{"mesh": 0}, {"mesh": 0, "weights": [0, 1, 0]}, {"mesh": 0, "weights": [2]}])
    wide, tall = VERTICES * [9, 0, 0], VERTICES * [0, 0, 1]
    sparse = {
        "count": 2,
        "indices": {"bufferView": file.view(np.array([4, 5], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(tall[4:].astype("<f4").tobytes())},
    }
    targets = [
        {"POSITION": file.array(wide)},
        {"POSITION": file.accessor(componentType=5126, count=6, type="VEC3", sparse=sparse)},
        {"NORMAL": file.array(wide)},
    ]
    file.mesh({**file.octahedron(), "targets": targets}, weights=[1, 0.5, 1])
    changed = tall.copy()
    changed[:4] = 0
    expected = [VERTICES + wide + changed / 2, VERTICES + changed, VERTICES + 2 * wide]
    np.testing.assert_allclose(parse(file.glb()).vertices, np.vstack(expected), **CLOSE)
    del file.tree["meshes"][0]["weights"]  # then nothing is morphed
    np.testing.assert_allclose(parse(file.glb()).vertices[:6], VERTICES, **CLOSE)
    targets[0]["POSITION"] = file.array(wide[:5])
    refuse(file.glb(), "a morph target does not have 6 vertices")
    file.tree["nodes"][0]["weights"] = ["1"]
    refuse(file.glb(), "weights of a node must be numbers")


# ---- buffers ----


@pytest.fixture
def write(tmp_path):
    def write(name: str, content: bytes | str) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.mark.parametrize("isolated", [True, False])
@pytest.mark.parametrize(
    ("uri", "name"),
    [
        ("model.bin", "model.bin"),
        ("./model.bin", "model.bin"),
        ("my%20part.bin", "my part.bin"),
        ("my part.bin", "my part.bin"),
        ("%C3%BC%2b.bin", "ü+.bin"),
        ("ü.bin", "ü.bin"),
        ("%E4.bin", os.fsdecode(b"\xe4.bin")),
    ],
)
def test_buffer_beside_the_file(uri, name, isolated, write):
    file = placed([{"mesh": 0}])
    write(name, bytes(file.data) + b"more than the buffer needs")
    path = write("model.gltf", file.gltf(uri))
    found = read_geometry_file(path, isolated=isolated)
    np.testing.assert_array_equal(found.geometry.vertices, VERTICES)
    assert found.notes == ()
    assert [content[: len(file.data)] for content in read_file(str(path)).used] == [bytes(file.data)]


@pytest.mark.parametrize("isolated", [True, False])
def test_buffer_beside_the_file_that_is_missing_or_no_file(isolated, write, tmp_path):
    file = placed([{"mesh": 0}])
    path = write("model.gltf", file.gltf("model.bin"))

    def reason() -> str:
        with pytest.raises(GeometryReadError) as caught:
            read_geometry_file(path, isolated=isolated, memory_limit=2**26)
        return str(caught.value).removeprefix(f"{path}: ")

    assert reason().startswith("it needs the file 'model.bin' beside it: No such file")
    assert "a .glb file holds all in one" in reason()
    write("model.bin", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n")
    assert "Git LFS pointer" in reason()
    write("model.bin", bytes(file.data)[:-1])
    assert reason() == f"truncated: buffer 0 announces {len(file.data)} bytes and has {len(file.data) - 1}"
    (tmp_path / "model.bin").unlink()
    os.mkfifo(tmp_path / "model.bin")
    assert "is not a regular file" in reason()
    (tmp_path / "model.bin").unlink()
    (tmp_path / "model.bin").mkdir()
    assert "is not a regular file" in reason()
    (tmp_path / "model.bin").rmdir()
    with (tmp_path / "model.bin").open("wb") as stream:
        stream.write(b"1")
        stream.truncate(2**27)  # a hole: it takes no room on disk
    if isolated:
        assert "needs more memory than the reader is allowed" in reason()


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "%2e%2e%2fsecret.bin",
        "/etc/passwd",
        "sub/model.bin",
        "..\\secret.bin",
        "%2Fetc%2Fpasswd",
        "http://example.org/a.bin",
        "file:///etc/passwd",
        "%252e%252e%252fsecret.bin",
        "..",
        "%2e%2e",
        "C:model.bin",
        "a%00.bin",
        "",
        "a" * 300 + ".bin",
        "././model.bin",
        ".//etc/passwd",
    ],
)
def test_no_path_and_no_address_is_opened(uri, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr("fsh3d_o3d.files.parsing.file_content", lambda path: opened.append(path))
    refuse(placed([{"mesh": 0}]).gltf(uri), "only plain names in the same folder are opened", "/models/model.gltf")
    assert opened == []


def test_uri_that_is_no_text():
    refuse(placed([{"mesh": 0}]).gltf("\ud800.bin"), "uri of buffer 0 is not text", "/model.gltf")
    tree, binary = gltf_tree()
    tree["buffers"] = [{"byteLength": len(binary), "uri": 7}]
    refuse(json.dumps(tree), "uri of buffer 0 is not text", "/model.gltf")


def test_embedded_buffers():
    file = placed([{"mesh": 0}])
    plain = base64.b64encode(file.data).decode()
    percent = "".join(f"%{byte:02x}" for byte in file.data)
    uris = [
        f"data:{kind};base64,{plain}" for kind in ("application/octet-stream", "application/gltf-buffer", "", "x/y;a=b")
    ]
    uris += [f"DATA:;BASE64,{plain}", f"data:;base64,{plain.replace('=', '%3D')}", f"data:,{percent}"]
    for uri in uris:
        data = file.gltf(uri)
        np.testing.assert_array_equal(parse(data, "/model.gltf").vertices, VERTICES)
        assert notes(data, "/model.gltf") == ()
    file.data += b"\0"  # of a length that needs padding
    short = file.gltf("data:;base64," + base64.b64encode(file.data).decode().rstrip("="))
    np.testing.assert_array_equal(parse(short, "/model.gltf").vertices, VERTICES)
    assert "padding" in notes(short, "/model.gltf")[0]
    broken = file.gltf("data:;base64," + "\n".join(base64.encodebytes(file.data).decode().split()))
    np.testing.assert_array_equal(parse(broken, "/model.gltf").vertices, VERTICES)
    refuse(file.gltf("data:;base64,!!!!"), "buffer 0 is not base64", "/model.gltf")
    refuse(file.gltf("data:;base64,AAAA"), "truncated: buffer 0", "/model.gltf")


def test_binary_container():
    file = placed([{"mesh": 0}])
    data = file.glb()
    size = struct.unpack_from("<I", data, 12)[0]
    json_end = 20 + size

    def packed(*chunks: tuple[bytes, bytes], padded: bool = False) -> bytes:
        body = b"".join(
            struct.pack("<I4s", len(content), kind) + content + bytes(-len(content) % 4 if padded else 0)
            for kind, content in chunks
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    text, binary = data[20:json_end].rstrip(), data[json_end + 8 :]
    both = ((b"JSON", text + b" " * (-len(text) % 4 + 1)), (b"BIN\0", binary))
    for changed, note in (
        (data + bytes(4), "4 bytes behind the announced end"),
        (packed(*both), "length of a chunk is not a multiple of 4"),
        (packed(*both, padded=True), "length of a chunk is not a multiple of 4"),
        (packed((b"JSON", text + bytes(-len(text) % 4 + 4)), both[1]), "padded with zero bytes"),
    ):
        np.testing.assert_array_equal(parse(changed).vertices, VERTICES)
        assert len(notes(changed)) == 1 and note in notes(changed)[0]
    more = packed((b"JSON", text + b" " * (-len(text) % 4)), (b"WHAT", b"1234"), (b"BIN\0", binary), (b"MORE", b""))
    np.testing.assert_array_equal(parse(more).vertices, VERTICES)
    assert notes(more) == ()
    refuse(data[:-1], f"truncated or damaged: the header announces {len(data)} bytes")
    refuse(struct.pack("<4sII", b"glTF", 2, len(data) - 8) + data[12:], "a chunk reaches beyond the end")
    refuse(packed((b"BIN\0", binary)), "no JSON chunk")


# ---- accessors ----


def test_sparse_accessors():
    changed = VERTICES.copy()
    changed[[1, 4]] = [[2, 4, 6], [7, 8, 9]]
    for dtype, component in (("u1", 5121), ("<u2", 5123), ("<u4", 5125)):
        file = GltfFile(nodes=[{"mesh": 0}])
        where = file.view(b"\0\0\0\0" + np.array([1, 4], dtype).tobytes())
        values = file.view(np.array([[2, 4, 6], [7, 8, 9]], "<f4").tobytes())
        sparse = {
            "count": 2,
            "indices": {"bufferView": where, "byteOffset": 4, "componentType": component},
            "values": {"bufferView": values},
        }
        position = file.array(VERTICES, sparse=sparse)
        file.mesh(file.octahedron(POSITION=position))
        np.testing.assert_array_equal(parse(file.glb()).vertices, changed)
        # trimesh does not read sparse accessors; Open3D does.
    base = file.tree["accessors"][position]
    del base["bufferView"]  # then the others are zero
    changed[[0, 2, 3, 5]] = 0
    np.testing.assert_array_equal(parse(file.glb()).vertices, changed)
    for bad, reason in (
        ({"count": 3}, "exceeds its buffer"),
        ({"count": 7}, "replaces 7 of 6 items"),
        ({"count": 0}, "exceeds its buffer"),
        ({"count": 10**15}, "replaces 10{15} of 6 items"),
        ({"indices": {"bufferView": where, "componentType": 5126}}, "unknown indices"),
        ({"indices": {"bufferView": where, "componentType": 5121}}, "do not increase within 6 items"),
        ({"indices": None}, "not a whole sparse accessor"),
        ({"values": {"bufferView": where}}, "exceeds its buffer"),
    ):
        base["sparse"] = {**sparse, **bad}
        refuse(file.glb(), reason)
    base |= {"sparse": sparse, "count": 10**9}
    refuse(file.glb(), "has 1000000000 items and no buffer")


def test_only_the_vertices_that_a_primitive_uses_are_taken():
    """Else a hundred primitives over one large buffer, as CAD programs write them, hold it a hundred times."""
    file = GltfFile(nodes=[{"mesh": 0}])
    points = np.arange(3 * 10_000).reshape(-1, 3)
    position = file.array(points)
    rows = [[3 * number, 3 * number + 1, 3 * number + 2] for number in range(100)]
    file.mesh(*({"attributes": {"POSITION": position}, "indices": file.array(row, "u2")} for row in rows))
    mesh = parse(file.glb())
    assert mesh.vertices.shape == (300, 3) and mesh.triangles.shape == (100, 3)
    np.testing.assert_array_equal(mesh.vertices[mesh.triangles], points[rows])


# ---- points and lines ----


def test_points_become_a_cloud():
    colors = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 9], [51, 102, 204, 0], [0, 0, 0, 0], [255] * 4])
    file = GltfFile(nodes=[{"mesh": 0, "scale": [1, 2, -4], "rotation": QUARTER}])
    file.mesh(
        {
            "mode": 0,
            "attributes": {
                "POSITION": file.array(VERTICES),
                "NORMAL": file.array(NORMALS),
                "COLOR_0": file.array(colors, "u1", normalized=True),
            },
        }
    )
    cloud = parse(file.glb())
    matrix = np.array([[0, -2, 0], [1, 0, 0], [0, 0, -4]])
    turned = NORMALS @ np.linalg.inv(matrix)
    assert isinstance(cloud, PointArrays)
    np.testing.assert_allclose(cloud.points, VERTICES @ matrix.T, **CLOSE)
    np.testing.assert_allclose(cloud.normals, turned / np.linalg.norm(turned, axis=1, keepdims=True), **CLOSE)
    np.testing.assert_allclose(cloud.colors, colors[:, :3] / 255, atol=1e-15)
    primitive = file.tree["meshes"][0]["primitives"][0]
    primitive["indices"] = file.array([5, 3, 3, 1], "u1")  # some of them, each once
    assert len(parse(file.glb()).points) == len(parse(file.glb()).normals) == 3
    file.mesh({"mode": 0, "attributes": {"POSITION": file.array(VERTICES)}})
    file.tree["nodes"].append({"mesh": 1})
    both = parse(file.glb())
    assert (len(both.points), both.normals, both.colors) == (9, None, None)
    assert "only some have normals" in notes(file.glb())[0]


def test_points_and_lines_beside_triangles_are_passed_over_with_a_note():
    file = placed([{"mesh": 0}])
    lines = {"mode": 3, "attributes": {"POSITION": 0}}
    file.tree["meshes"][0]["primitives"] += [{"mode": 0, "attributes": {"POSITION": 0}}, lines, lines]
    assert len(parse(file.glb()).triangles) == 8
    assert notes(file.glb()) == ("points and lines beside the triangles were passed over",)
    del file.tree["meshes"][0]["primitives"][0]
    assert isinstance(parse(file.glb()), PointArrays)
    assert notes(file.glb()) == ("lines beside the points were passed over",)
    del file.tree["meshes"][0]["primitives"][0]
    refuse(file.glb(), "there are no triangles, only lines")
    file.tree["meshes"][0]["primitives"] = []
    refuse(file.glb(), "the scene places no triangles and no points")


# ---- the scene ----


def test_primitives_without_positions_are_passed_over():
    file = placed([{"mesh": 0}])
    file.tree["meshes"][0]["primitives"].append({"attributes": {"NORMAL": 0}})
    assert len(parse(file.glb()).triangles) == 8
    assert notes(file.glb()) == ("a primitive of mesh 0 has no positions; it was passed over",)


def test_the_default_scene_is_read():
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0], "children": [2]}, {"mesh": 0}]
    file = placed(nodes)
    file.tree |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    np.testing.assert_allclose(parse(file.glb()).vertices, np.tile(moved([5, 0, 0]), (2, 1)))
    assert notes(file.glb()) == ("of 2 scenes only scene 1 was read",)
    del file.tree["scene"]
    np.testing.assert_allclose(parse(file.glb()).vertices, VERTICES)
    file.tree["scenes"] = []  # then all nodes that are below no other
    assert len(parse(file.glb()).triangles) == 24
    del file.tree["nodes"]  # then all meshes
    assert len(parse(file.glb()).triangles) == 8
    file.tree |= {"scene": 3, "nodes": nodes, "scenes": [{"nodes": [0]}]}
    refuse(file.glb(), "no entry '3' in scenes")


def test_hidden_nodes():
    hidden = {"KHR_node_visibility": {"visible": False}}
    file = placed([{"mesh": 0, "children": [1, 2]}, {"extensions": hidden, "children": [3]}, {"mesh": 0}, {"mesh": 0}])
    assert len(parse(file.glb()).triangles) == 16
    assert notes(file.glb()) == ("hidden nodes were left out: 1 with a mesh",)


def test_nodes_must_form_a_tree():
    for nodes in ([{"mesh": 0, "children": [0]}], [{"children": [1, 1]}, {"mesh": 0}]):
        refuse(placed(nodes).glb(), "two parents")
    refuse(placed([{"children": [1]}, {"children": [2]}, {"mesh": 0, "children": [1]}]).glb(), "node 1 has two parents")
    file = placed([{"children": [1]}, {"children": [0], "mesh": 0}])
    del file.tree["scenes"], file.tree["scene"]
    refuse(file.glb(), "the scene places no triangles")  # a ring has no root
    for bad in ([7], ["1"], [True], [[]], [{}], 5, [1.0]):
        file = placed([{"children": bad}, {"mesh": 0}])
        refuse(file.glb(), "no entry|is not a list")
        del file.tree["scenes"], file.tree["scene"]
        refuse(file.glb(), "no entry|is not a list|not an object")


@pytest.mark.parametrize(
    ("node", "reason"),
    [
        ({"scale": [1, 1, "1"]}, "scale of a node must be 3 numbers"),
        ({"scale": [1, 1]}, "scale of a node"),
        ({"translation": [1, 1, True]}, "translation of a node"),
        ({"translation": [10**400, 0, 0]}, "translation of a node"),
        ({"rotation": [0, 0, float("nan"), 1]}, "rotation of a node must be 4 numbers"),
        ({"matrix": [1e200] * 16}, "matrix of a node must be 16 numbers"),
        ({"mesh": 1}, "no entry '1' in meshes"),
        ({"mesh": [0]}, r"no entry '\[0\]' in meshes"),
        ({"skin": 0}, "no entry '0' in skins"),
        ({"weights": {}}, "weights is not a list"),
    ],
)
def test_damaged_nodes(node, reason):
    refuse(placed([{"mesh": 0, **node}]).glb(), reason)


def test_rotations_are_normalised():
    file = placed([{"mesh": 0, "rotation": [0, 0, 5, 5]}])
    np.testing.assert_allclose(parse(file.glb()).vertices, VERTICES @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], **CLOSE)
    assert notes(file.glb()) == ("rotations that are not unit quaternions were normalised: 1",)


def test_a_hundred_thousand_roots_and_a_chain_as_deep():
    count = 100_000
    file = placed([{"mesh": 0, "translation": [number, 0, 0]} for number in range(count)])
    file.tree["scenes"] = [{"nodes": list(range(count))}]
    mesh = parse(file.glb())
    assert len(mesh.triangles) == 8 * count
    np.testing.assert_array_equal(mesh.vertices[-6:], moved([count - 1, 0, 0]))
    chain = placed([{"translation": [1, 0, 0], "children": [number + 1]} for number in range(count)] + [{"mesh": 0}])
    np.testing.assert_array_equal(parse(chain.glb()).vertices, moved([count, 0, 0]))


# ---- other readers ----


@pytest.fixture
def scene() -> trimesh.Scene:
    """Three bodies, one of them twice, under nodes that turn, stretch and mirror."""
    rng = np.random.default_rng(0)
    result = trimesh.Scene()
    for number, body in enumerate(
        (trimesh.creation.box((1, 2, 3)), trimesh.creation.icosphere(2), trimesh.creation.torus(2, 0.5))
    ):
        matrix = trimesh.transformations.random_rotation_matrix(rng.random(3))
        matrix[:3, :3] *= rng.uniform(0.5, 2, 3) * (-1) ** number
        matrix[:3, 3] = rng.uniform(-5, 5, 3)
        result.add_geometry(body, f"body{number}", f"geometry{number}", transform=matrix)
    result.graph.update("again", "body0", geometry="geometry0", matrix=np.diag([1, -2, 1, 1]))
    return result


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_agrees_with_trimesh_and_open3d(kind, scene, tmp_path):
    if kind == "glb":
        (tmp_path / "model.glb").write_bytes(scene.export(file_type="glb"))
    else:
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(content)
    [path] = tmp_path.glob("model.*")
    found = read_geometry_file(path)
    mesh = found.geometry
    other = trimesh.load_scene(path).to_geometry()
    assert len(mesh.triangles) == len(other.faces)
    order, others = (np.lexsort(np.round(points, 4).T) for points in (mesh.vertices, other.vertices))
    np.testing.assert_allclose(mesh.vertices[order], other.vertices[others], atol=2e-4)
    assert volume(mesh) == pytest.approx(
        float(sum(part.volume for part in other.split(only_watertight=False))), rel=1e-4
    )
    o3d = open3d().io.read_triangle_mesh(str(path))
    assert len(o3d.triangles) == len(mesh.triangles)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), np.asarray(o3d.vertices).min(axis=0), atol=1e-5)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), np.asarray(o3d.vertices).max(axis=0), atol=1e-5)


def test_sparse_accessors_agree_with_open3d(tmp_path):
    file = GltfFile(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}], scene=0)
    sparse = {
        "count": 1,
        "indices": {"bufferView": file.view(b"\4\0"), "componentType": 5123},
        "values": {"bufferView": file.view(np.array([2, 4, 6], "<f4").tobytes())},
    }
    file.mesh(file.octahedron(POSITION=file.array(VERTICES, sparse=sparse)))
    path = tmp_path / "sparse.gltf"
    path.write_text(file.gltf())
    mesh, other = parse(path.read_bytes(), str(path)), open3d().io.read_triangle_mesh(str(path))
    corners = np.asarray(other.vertices)[np.asarray(other.triangles)]  # it numbers vertices anew
    np.testing.assert_allclose(mesh.vertices[mesh.triangles], corners, **CLOSE)


# ---- damage ----


def rich_files() -> list[SampleFile]:
    """Files that use what the plain samples do not."""
    joints, weights = spread(0)
    skin = skinned(joints, weights, np.tile(np.eye(4), (2, 1, 1)), [{"scale": [2, 2, 2]}, {}], roots=[1, 2])
    morphed = placed([{"mesh": 0, "weights": [0.5]}])
    sparse = {
        "count": 2,
        "indices": {"bufferView": morphed.view(b"\1\4"), "componentType": 5121},
        "values": {"bufferView": morphed.view(np.ones(6, "<f4").tobytes())},
    }
    target = morphed.accessor(componentType=5126, count=6, type="VEC3", sparse=sparse)
    morphed.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": target}]
    instanced = placed([{"mesh": 0}])
    instanced.tree["nodes"][0]["extensions"] = instancing(TRANSLATION=instanced.array(np.eye(3)))
    cloud = GltfFile()
    cloud.mesh({"mode": 0, "attributes": {"POSITION": cloud.array(VERTICES), "NORMAL": cloud.array(NORMALS)}})
    files = [SampleFile(f"{name}.glb", file.glb()) for name, file in (("skin", skin), ("cloud", cloud))]
    return [*files, SampleFile("morph.gltf", morphed.gltf().encode()), SampleFile("instances.glb", instanced.glb())]


def test_damage_is_read_or_refused():
    rng = random.Random(0)
    files = rich_files()
    outcomes = []
    for number in range(len(files) * len(DAMAGES) * 12):
        damage = DAMAGES[number // len(files) % len(DAMAGES)]
        changed = damage(files[number % len(files)], rng, files)
        try:
            parse(changed.data, f"/{changed.name}")
            outcomes.append("read")
        except GeometryReadError as error:
            assert "cannot be parsed" not in str(error), (damage.__name__, str(error))
            outcomes.append("refused")
    assert min(outcomes.count("read"), outcomes.count("refused")) > len(outcomes) // 20


def test_any_value_may_stand_anywhere_in_the_json():
    """Each value of the documents in turn becomes something else: read, or refused for a reason that was foreseen."""
    for sample in rich_files():
        data = sample.data
        text = data[20 : 20 + struct.unpack_from("<I", data, 12)[0]] if data[:4] == b"glTF" else data
        binary = data[28 + len(text) :]
        for change in (None, -1, 10**12, 1.5, "x", [], {}, [[]], [{}], [0, 0], True):
            for place in range(sum(1 for _ in places(json.loads(text)))):
                tree = json.loads(text)
                holder, key = list(places(tree))[place]
                holder[key] = change
                changed = pack_glb(tree, binary) if data[:4] == b"glTF" else json.dumps(tree).encode()
                try:
                    parse(changed, f"/{sample.name}")
                except GeometryReadError as error:
                    assert "cannot be parsed" not in str(error), (sample.name, place, change, str(error))


def places(tree):
    """Every holder and key of a value in a JSON tree."""
    for key, value in list(tree.items()) if isinstance(tree, dict) else list(enumerate(tree)):
        yield tree, key
        if isinstance(value, (dict, list)):
            yield from places(value)
