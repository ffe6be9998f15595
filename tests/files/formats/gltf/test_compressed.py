"""glTF whose geometry is compressed: by Draco's own encoder, and by streams of meshopt's."""

from __future__ import annotations

import sys
from typing import Any

import DracoPy
import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.sphere.icosahedron import icosphere
from tests.files.formats.gltf.gltf_files import GltfFile
from tests.files.formats.gltf.meshopt_streams import FILTERED, SHEET
from tests.files.formats.gltf.test_meshopt import plain_attributes, plain_triangles, sheet
from tests.files.mutations import pack_glb

DRACO = "KHR_draco_mesh_compression"
BALL, FACES = icosphere(3)
BITS = 14
# Draco rounds each coordinate to 2¹⁴ steps across the longest side of the box, here 2.
ROUNDED = 2 / 2**BITS


def parse(data: bytes) -> MeshArrays | PointArrays:
    return parse_content("/model.glb", data).geometry


def corners(mesh: MeshArrays) -> np.ndarray:
    """Corners (t, 3, 3) in an order that does not depend on that of vertices and triangles."""
    found = mesh.vertices[mesh.triangles]
    keys = np.round(found / 1e-3).astype(int)
    first = np.lexsort(keys.transpose(2, 0, 1), axis=1)[:, 0]
    turned = np.take_along_axis(found, ((first[:, None] + np.arange(3)) % 3)[:, :, None], axis=1)
    return turned[np.lexsort(np.round(turned / 1e-3).astype(int).reshape(-1, 9).T)]


def draco_file(stream: bytes, identifiers: dict[str, int], *, fallback: bool = False, **more: Any) -> GltfFile:
    """A file whose only primitive is compressed, with the same without compression beside it or not."""
    file = GltfFile(nodes=[{"mesh": 0}], extensionsUsed=[DRACO], **more)
    view = file.view(stream)
    if fallback:
        position, indices = file.array(BALL), file.array(FACES.ravel(), "u4")
    else:
        position = file.accessor(**file.described(BALL))
        indices = file.accessor(componentType=5125, count=FACES.size, type="SCALAR")
        file.tree["extensionsRequired"] = [DRACO]
    content = {"bufferView": view, "attributes": identifiers}
    file.mesh({"attributes": {"POSITION": position}, "indices": indices, "extensions": {DRACO: content}})
    return file


def position_of(stream: bytes) -> int:
    """The number that Draco gave to the positions."""
    return next(one["unique_id"] for one in DracoPy.decode(stream).attributes if one["attribute_type"] == 0)


def ball_stream(level: int = 7, **more: Any) -> bytes:
    return DracoPy.encode(BALL, FACES.astype(np.uint32), quantization_bits=BITS, compression_level=level, **more)


@pytest.mark.parametrize("isolated", [True, False])
@pytest.mark.parametrize("level", [0, 7, 10])
def test_draco(level, isolated, tmp_path):
    stream = ball_stream(level)
    path = tmp_path / "ball.glb"
    path.write_bytes(draco_file(stream, {"POSITION": position_of(stream)}).glb())
    # In the separate process as it runs: within a limit of address space.
    mesh = read_geometry_file(path, isolated=isolated, memory_limit=2**28).geometry
    assert mesh.triangles.shape == FACES.shape and len(mesh.vertices) == len(BALL)
    np.testing.assert_allclose(corners(mesh), corners(MeshArrays(BALL, FACES)), atol=ROUNDED)


def test_draco_with_a_skin():
    """Joints and weights are compressed as well; the order of vertices is the encoder's own."""
    left = (BALL[:, 0] < 0).astype(np.uint8)
    joints = np.stack([left, *[0 * left] * 3], axis=1)
    weights = np.tile(np.float32([1, 0, 0, 0]), (len(BALL), 1))
    stream = ball_stream(generic_attributes={1: joints, 2: weights})
    identifiers = {"POSITION": position_of(stream), "JOINTS_0": 1, "WEIGHTS_0": 2}
    file = draco_file(stream, identifiers)
    attributes = file.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = file.accessor(**file.described(joints, "u1"))
    attributes["WEIGHTS_0"] = file.accessor(**file.described(weights))
    file.tree["nodes"] = [{"mesh": 0, "skin": 0}, {"translation": [0, 0, 1]}, {"translation": [0, 0, -1]}]
    file.tree["skins"] = [{"joints": [1, 2]}]
    mesh = parse(file.glb())
    expected = BALL + np.stack([0 * left, 0 * left, np.where(left, -1, 1)], axis=1)
    # Vertices near x = 0 may be rounded to the other side, but not be moved differently.
    np.testing.assert_allclose(np.sort(mesh.vertices[:, 2]), np.sort(expected[:, 2]), atol=ROUNDED)
    assert (np.abs(mesh.vertices[:, 2] - np.where(mesh.vertices[:, 0] < -ROUNDED, -1, 1)) < 1 + ROUNDED).all()


def test_damaged_draco():
    stream = ball_stream()
    identifiers = {"POSITION": position_of(stream)}
    named = r"compressed \(KHR_draco_mesh_compression\)"
    points = DracoPy.encode(BALL)
    for content, given, reason in (
        (b"not a stream", identifiers, f"{named}, .* not a Draco stream"),
        (points, {"POSITION": position_of(points)}, f"{named}, .* points, not triangles"),
        (stream, {"POSITION": 77}, f"{named}, .* no attribute POSITION"),
        (stream, {}, "does not say where the vertices are"),
        (stream, {"POSITION": "0"}, "does not say where the vertices are"),
        (stream[: len(stream) // 2], identifiers, f"{named}, and what is compressed is damaged"),
    ):
        with pytest.raises(GeometryReadError, match=reason):
            parse(draco_file(content, given).glb())


def test_damage_to_draco_does_no_harm_to_the_separate_reader(tmp_path):
    rng = np.random.default_rng(0)
    stream = ball_stream()
    identifiers = {"POSITION": position_of(stream)}
    outcomes = set()
    for number in range(60):
        data = bytearray(stream)
        for _ in range(1 + number % 3):
            # Half of the damage goes to the header and the counts behind it.
            data[rng.integers(40 if number % 2 else len(data))] = rng.integers(256)
        path = tmp_path / f"{number}.glb"
        path.write_bytes(draco_file(bytes(data), identifiers).glb())
        try:
            read_geometry_file(path, memory_limit=2**28, timeout=60)
            outcomes.add("read")
        except GeometryReadError as error:
            assert "cannot be parsed" not in str(error) and "stopped" not in str(error)
            outcomes.add("refused")
    assert "refused" in outcomes


def test_without_the_draco_decoder(monkeypatch):
    stream = ball_stream()
    identifiers = {"POSITION": position_of(stream)}
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(
        GeometryReadError, match=r"KHR_draco_mesh_compression.*pip install DracoPy.*without compression"
    ):
        parse(draco_file(stream, identifiers).glb())
    fallback = parse(draco_file(stream, identifiers, fallback=True).glb())
    np.testing.assert_allclose(fallback.vertices, BALL, atol=1e-7)


# ---- meshopt ----


def meshopt_view(file: GltfFile, name: str, stream: bytes, count: int, stride: int, mode: str, **more: Any) -> int:
    """A buffer view that is compressed; what it would be without is in a buffer with no content."""
    file.data += bytes(-len(file.data) % 4)
    content = {"buffer": 0, "byteOffset": len(file.data), "byteLength": len(stream), "mode": mode, **more}
    content |= {"count": count, "byteStride": stride}
    file.data += stream
    view = {"buffer": 1, "byteLength": count * stride, "extensions": {name: content}}
    if mode == "ATTRIBUTES":
        view["byteStride"] = stride
    file.tree["bufferViews"].append(view)
    return len(file.tree["bufferViews"]) - 1


def meshopt_file(name: str, positions: tuple[bytes, int], indices: tuple[bytes, str]) -> GltfFile:
    """The bent sheet, compressed."""
    vertices, triangles = sheet()
    file = GltfFile(nodes=[{"mesh": 0}], extensionsRequired=[name], extensionsUsed=[name])
    stream, stride = positions
    view = meshopt_view(file, name, stream, len(vertices), stride, "ATTRIBUTES")
    component = 5122 if stride == 8 else 5126
    position = file.accessor(bufferView=view, componentType=component, count=len(vertices), type="VEC3")
    view = meshopt_view(file, name, indices[0], triangles.size, 2, indices[1])
    corner = file.accessor(bufferView=view, componentType=5123, count=triangles.size, type="SCALAR")
    file.mesh({"attributes": {"POSITION": position}, "indices": corner})
    return file


def with_fallback_buffer(file: GltfFile) -> bytes:
    """A .glb whose second buffer has no content."""
    buffers = [{"byteLength": len(file.data)}, {"byteLength": 10**6}]
    return pack_glb({**file.tree, "buffers": buffers}, bytes(file.data))


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("indices", ["triangles", "indices"])
@pytest.mark.parametrize("positions", ["shorts0", "shorts1", "floats0", "floats1"])
def test_meshopt(name, indices, positions):
    stride, scale = (8, 1) if positions.startswith("shorts") else (12, 8)
    data = with_fallback_buffer(meshopt_file(name, (SHEET[positions], stride), (SHEET[indices], indices.upper())))
    vertices, triangles = sheet()
    mesh = parse(data)
    np.testing.assert_array_equal(mesh.vertices, vertices[:, :3] / scale)
    np.testing.assert_array_equal(corners(mesh), corners(MeshArrays(vertices[:, :3] / scale, triangles)))


def test_meshopt_of_more_than_one_block(tmp_path):
    points = BALL.astype("<f4")
    file = GltfFile(nodes=[{"mesh": 0}])
    name = "KHR_meshopt_compression"
    items = points.view(np.uint8).reshape(len(points), 12)
    view = meshopt_view(file, name, plain_attributes(items, 1), len(points), 12, "ATTRIBUTES")
    position = file.accessor(bufferView=view, componentType=5126, count=len(points), type="VEC3")
    view = meshopt_view(file, name, plain_triangles(FACES), FACES.size, 4, "TRIANGLES")
    corner = file.accessor(bufferView=view, componentType=5125, count=FACES.size, type="SCALAR")
    file.mesh({"attributes": {"POSITION": position}, "indices": corner})
    path = tmp_path / "ball.glb"
    path.write_bytes(with_fallback_buffer(file))
    mesh = read_geometry_file(path).geometry
    np.testing.assert_array_equal(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.triangles, FACES)


def test_meshopt_filters_of_points():
    """Positions, normals and colours that only a filter makes of the stream."""
    name = "KHR_meshopt_compression"
    file = GltfFile(nodes=[{"mesh": 0}])
    attributes = {}
    for attribute, kind, filtered, stride, component in (
        ("POSITION", "VEC3", "EXPONENTIAL", 12, 5126),
        ("NORMAL", "VEC3", "OCTAHEDRAL", 8, 5122),
        ("COLOR_0", "VEC4", "COLOR", 4, 5121),
    ):
        view = meshopt_view(file, name, FILTERED[filtered, stride][0], 5, stride, "ATTRIBUTES", filter=filtered)
        attributes[attribute] = file.accessor(
            bufferView=view, componentType=component, count=5, type=kind, normalized=component != 5126
        )
    file.mesh({"mode": 0, "attributes": attributes})
    cloud = parse(with_fallback_buffer(file))
    given = np.array([[2, -1, 2], [6, -3, -2], [-4, 4, -7], [0, 0, -1], [-8, -1, 4]])
    np.testing.assert_array_equal(cloud.points, given * 0.75)
    lengths = np.linalg.norm(given, axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.normals, given / lengths, atol=2e-3)  # 12 bits
    np.testing.assert_allclose(cloud.colors, (given + 8) / 16, atol=2 / 255)  # 8 bits, in other colours


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"byteStride": 12}, "81 items of 12 bytes, not the 648 announced"),
        ({"byteLength": 100}, "truncated"),
        ({"byteLength": 10**6}, "a part compressed by .* exceeds its buffer"),
        ({"mode": "WORDS"}, "the mode 'WORDS'"),
        ({"filter": "SEPIA"}, "the filter 'SEPIA'"),
        ({"buffer": 1}, "buffer 1 has no content"),
        ({"count": None}, "count must be a number"),
    ],
)
def test_damaged_meshopt(change, reason):
    file = meshopt_file("KHR_meshopt_compression", (SHEET["shorts1"], 8), (SHEET["triangles"], "TRIANGLES"))
    file.tree["bufferViews"][0]["extensions"]["KHR_meshopt_compression"] |= change
    with pytest.raises(GeometryReadError, match=reason) as caught:
        parse(with_fallback_buffer(file))
    assert "cannot be parsed" not in str(caught.value)
    assert "compressed (KHR_meshopt_compression)" in str(caught.value) or "a part compressed by" in str(caught.value)


def test_meshopt_that_says_nothing_of_a_buffer_view():
    file = meshopt_file("KHR_meshopt_compression", (SHEET["shorts1"], 8), (SHEET["triangles"], "TRIANGLES"))
    del file.tree["bufferViews"][0]["extensions"]
    with pytest.raises(GeometryReadError, match=r"compressed \(KHR_meshopt_compression\).* buffer 1 has no content"):
        parse(with_fallback_buffer(file))


def test_meshopt_that_would_fill_memory(monkeypatch):
    monkeypatch.setattr("fsh3d_o3d.files.formats.gltf.buffers._MOST_DECOMPRESSED", 1000)
    file = meshopt_file("KHR_meshopt_compression", (SHEET["shorts1"], 8), (SHEET["triangles"], "TRIANGLES"))
    with pytest.raises(GeometryReadError, match=r"KHR_meshopt_compression\), and grows to more than 1000 bytes"):
        parse(with_fallback_buffer(file))
