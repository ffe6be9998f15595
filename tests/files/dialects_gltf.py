"""glTF as programs write it."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tests.files.dialects import Dialect, encodings, line_ends
from tests.files.formats.gltf.gltf_files import GltfFile
from tests.files.mutations import COLORS, NORMALS, TRIANGLES, VERTICES


def gltf_dialects() -> Iterator[Dialect]:
    """Yield the octahedron as .gltf, embedded and with a file beside it, and as .glb."""
    for name, make in _TREES.items():
        file = make()
        file.tree.setdefault("nodes", [{"mesh": 0}])
        if "scenes" not in file.tree:
            file.tree |= {"scenes": [{"nodes": [0]}], "scene": 0}
        trimesh = _WRONG.get(name, "")
        yield Dialect(f"{name}.glb", file.glb(), trimesh=trimesh)
        yield Dialect(f"{name} embedded.gltf", file.gltf().encode(), trimesh=trimesh)
        beside = f"{name.replace(' ', '_')}.bin"
        yield Dialect(
            f"{name} beside.gltf", file.gltf(beside).encode(), trimesh=trimesh, beside={beside: bytes(file.data)}
        )
    yield from _texts()
    yield from _containers()


def _plain(**tree: Any) -> GltfFile:
    file = GltfFile(**tree)
    file.mesh(file.octahedron())
    return file


def _types(dtype: str) -> Callable[[], GltfFile]:
    def make() -> GltfFile:
        file = GltfFile()
        file.mesh({"attributes": {"POSITION": file.array(VERTICES)}, "indices": file.array(TRIANGLES.ravel(), dtype)})
        return file

    return make


def _without_indices() -> GltfFile:
    file = GltfFile()
    file.mesh({"attributes": {"POSITION": file.array(VERTICES[TRIANGLES].reshape(-1, 3))}})
    return file


def _attributes() -> GltfFile:
    file = GltfFile()
    file.mesh(
        file.octahedron(NORMAL=file.array(NORMALS), COLOR_0=file.array(COLORS / 255), POSITION=file.array(VERTICES))
    )
    return file


def _interleaved() -> GltfFile:
    file = GltfFile()
    table = np.hstack([VERTICES, NORMALS]).astype("<f4")
    view = file.view(table.tobytes(), byteStride=24)
    shared = {"bufferView": view, "componentType": 5126, "count": 6, "type": "VEC3"}
    place, normal = file.accessor(**shared), file.accessor(byteOffset=12, **shared)
    file.mesh(file.octahedron(POSITION=place, NORMAL=normal))
    return file


def _primitives() -> GltfFile:
    file = GltfFile()
    position = file.array(VERTICES)
    halves = [
        {"attributes": {"POSITION": position}, "indices": file.array(t.ravel(), "u1")} for t in np.split(TRIANGLES, 2)
    ]
    file.mesh(*halves)
    return file


def _meshes() -> GltfFile:
    file = GltfFile(nodes=[{"mesh": 0, "children": [1]}, {"mesh": 1}])
    for half in np.split(TRIANGLES, 2):
        file.mesh(file.octahedron() | {"indices": file.array(half.ravel(), "u2")})
    return file


def _moved(node: dict[str, Any]) -> Callable[[], GltfFile]:
    """A node that scales by two and moves by one, over vertices that undo it."""

    def make() -> GltfFile:
        file = GltfFile(nodes=[{"mesh": 0, **node}])
        file.mesh(file.octahedron(POSITION=file.array((VERTICES - [1, 0, 0]) / 2)))
        return file

    return make


def _nested() -> GltfFile:
    file = GltfFile(
        nodes=[{"children": [1], "scale": [2, 2, 2]}, {"children": [2]}, {"mesh": 0, "translation": [0.5, 0, 0]}]
    )
    file.mesh(file.octahedron(POSITION=file.array(VERTICES / 2 - [0.5, 0, 0])))
    return file


def _mirrored() -> GltfFile:
    file = GltfFile(nodes=[{"mesh": 0, "scale": [-1, 1, 1]}])
    mirrored = file.array(VERTICES * [-1, 1, 1])
    # Turned as well: a negative scale turns triangles back.
    file.mesh({"attributes": {"POSITION": mirrored}, "indices": file.array(TRIANGLES[:, ::-1].ravel(), "u2")})
    return file


def _sparse() -> GltfFile:
    file = GltfFile()
    values = file.view(VERTICES[[1, 4]].astype("<f4").tobytes())
    places = file.view(np.array([1, 4], dtype="<u2").tobytes())
    wrong = VERTICES.copy()
    wrong[[1, 4]] = 9
    position = file.array(
        wrong,
        sparse={
            "count": 2,
            "indices": {"bufferView": places, "componentType": 5123},
            "values": {"bufferView": values},
        },
    )
    file.mesh(file.octahedron(POSITION=position))
    return file


def _more_scenes() -> GltfFile:
    file = GltfFile(
        scenes=[{"nodes": [1]}, {"nodes": [0]}], scene=1, nodes=[{"mesh": 0}, {"mesh": 0, "scale": [5, 5, 5]}]
    )
    file.mesh(file.octahedron())
    return file


def _materials() -> GltfFile:
    return _plain(
        materials=[{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        extensionsUsed=["KHR_materials_unlit", "KHR_lights_punctual"],
        extras={"by": "hand"},
        cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
    )


_TREES: dict[str, Callable[[], GltfFile]] = {
    "plain": _plain,
    "bytes": _types("u1"),
    "words": _types("u4"),
    "loose": _without_indices,
    "attributes": _attributes,
    "interleaved": _interleaved,
    "primitives": _primitives,
    "two meshes": _meshes,
    "moved": _moved({"translation": [1, 0, 0], "scale": [2, 2, 2]}),
    "matrix": _moved({"matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1]}),
    "nested": _nested,
    "mirrored": _mirrored,
    "sparse": _sparse,
    "two scenes": _more_scenes,
    "materials": _materials,
}
_WRONG = {"sparse": "it reads what sparse accessors replace"}


def _texts() -> Iterator[Dialect]:
    plain = _plain(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}], scene=0).gltf()
    variants = {
        **encodings(plain.encode()),
        **line_ends(json.dumps(json.loads(plain), indent=2).encode()),
        "escaped": json.dumps({**json.loads(plain), "extras": "Größe ✓"}).encode(),
        "not escaped": json.dumps({**json.loads(plain), "extras": "Größe ✓"}, ensure_ascii=False).encode(),
        "octets": plain.replace("data:application/octet-stream", "data:application/gltf-buffer").encode(),
        "blanks behind": (plain + "  \n\n").encode(),
    }
    for name, data in variants.items():
        tail = len(data) - len(data.rstrip()) if data.isascii() else 0
        trimesh = "it decodes only UTF-8 without a mark" if name in ("utf8mark", "utf16none") else ""
        yield Dialect(f"{name} text.gltf", data, tail=tail, trimesh=trimesh)
    file = _plain(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}], scene=0)
    yield Dialect(
        "escaped name.gltf",
        file.gltf("a%20buffer%C3%A4.bin").encode(),
        trimesh="it looks for the escaped name",
        beside={"a bufferä.bin": bytes(file.data)},
    )


def _containers() -> Iterator[Dialect]:
    file = _plain(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}], scene=0)
    glb = file.glb()
    yield Dialect("zeros behind.glb", glb + bytes(4), tail=4)
    size = struct.pack("<I", len(glb) + 12)
    chunk = struct.pack("<I4s", 4, b"XTRA") + b"more"
    yield Dialect("more chunks.glb", glb[:8] + size + glb[12:] + chunk, tail=12)
    uri = "data:;base64," + base64.b64encode(file.data).decode()
    tree = {**file.tree, "buffers": [{"byteLength": len(file.data), "uri": uri}]}
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON")
    yield Dialect("embedded.glb", header + text)
