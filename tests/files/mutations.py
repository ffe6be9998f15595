"""Small valid files of every readable format, and damaged copies of them; the same ones at every run."""

from __future__ import annotations

import base64
import json
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

# An octahedron whose coordinates are exact in float32 and have few digits: every format holds it without loss.
VERTICES = np.array(
    [[1.5, 0, 0], [-1.5, 0, 0.25], [0, 1.25, 0], [0, -1.25, 0], [0, 0.125, 2], [0, 0, -2]], dtype=np.float64
)
TRIANGLES = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], dtype=np.int64
)
NORMALS = VERTICES / np.linalg.norm(VERTICES, axis=1, keepdims=True)
COLORS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [51, 102, 204], [0, 0, 0]])


@dataclass(frozen=True)
class SampleFile:
    """A file to be written and read."""

    name: str
    """File name with extension."""
    data: bytes
    """Content."""


def valid_files() -> dict[str, SampleFile]:
    """Return valid files by name; meshes are the octahedron above, point clouds its vertices."""
    files = [
        SampleFile("plain.off", _off("OFF\n6 8 12\n", VERTICES)),
        SampleFile("glued.off", _off("OFF6 8 0\n", VERTICES)),
        SampleFile("colored.off", _off("CNOFF\n# made by hand\n6 8 0\n", np.hstack([VERTICES, NORMALS, COLORS]))),
        SampleFile("plain.obj", _obj("f %d %d %d\n", TRIANGLES + 1)),
        SampleFile("slashes.obj", b"vn 0 0 1\r\n" + _obj("f %d//1 %d//1 %d//1\r\n", TRIANGLES + 1)),
        SampleFile("negative.obj", _obj("f %d %d %d\n", TRIANGLES - 6)),
        SampleFile("text.ply", _ply("ascii")),
        SampleFile("little.ply", _ply("binary_little_endian")),
        SampleFile("big.ply", _ply("binary_big_endian")),
        SampleFile("strips.ply", _strips()),
        SampleFile("points.ply", _ply("binary_little_endian", faces=False)),
        SampleFile("points_text.ply", _ply("ascii", faces=False)),
        SampleFile("binary.stl", _stl()),
        SampleFile("text.stl", _stl_text()),
        SampleFile("mesh.glb", _glb()),
        SampleFile("mesh.gltf", _gltf()),
        SampleFile("points.xyz", _text("%r %r %r\n", VERTICES)),
        SampleFile("points.xyzn", _text("%r %r %r %r %r %r\n", np.hstack([VERTICES, NORMALS]))),
        SampleFile("points.xyzrgb", _text("%r %r %r %r %r %r\n", np.hstack([VERTICES, COLORS / 255]))),
        SampleFile("points.pts", b"6\n" + _text("%r %r %r 0 %d %d %d\n", np.hstack([VERTICES, COLORS]))),
        SampleFile("text.pcd", _pcd("ascii")),
        SampleFile("binary.pcd", _pcd("binary")),
        SampleFile("compressed.pcd", _pcd("binary_compressed")),
    ]
    return {file.name: file for file in files}


def mutated_files(count: int, *, seed: int = 0, files: list[SampleFile] | None = None) -> Iterator[SampleFile]:
    """Yield ``count`` damaged files, every format and every kind of damage in turn; some may still be readable.

    They are made from ``files``, by default the valid ones of this module.
    """
    rng = random.Random(seed)
    files = list(valid_files().values()) if files is None else files
    for number in range(count):
        file = files[number % len(files)]
        damage = DAMAGES[(number // len(files)) % len(DAMAGES)]
        changed = damage(file, rng, files)
        yield SampleFile(f"{number:05d}_{damage.__name__.strip('_')}_{changed.name}", changed.data)


def _truncate(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    return SampleFile(file.name, file.data[: rng.randrange(len(file.data))])


def _flip_bytes(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    data = bytearray(file.data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return SampleFile(file.name, bytes(data))


def _change_number(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    """Replace a run of digits near the beginning, where counts stand."""
    at = [i for i in range(min(len(file.data), 400)) if file.data[i : i + 1].isdigit()]
    if not at:
        return _flip_bytes(file, rng, files)
    start = rng.choice(at)
    stop = start
    while file.data[stop : stop + 1].isdigit():
        stop += 1
    new = rng.choice([b"0", b"-1", b"7", b"4000000000", b"99999999999999999999", b"9" * 5000, b"1e9", b"", b"3.5"])
    return SampleFile(file.name, file.data[:start] + new + file.data[stop:])


def _set_word(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    """Overwrite four bytes by an extreme integer or float."""
    at = rng.randrange(max(1, len(file.data) - 4))
    word = rng.choice(
        [
            b"\xff\xff\xff\xff",
            b"\x00\x00\x00\x80",
            b"\xff\xff\xff\x7f",
            b"\x00\x00\xc0\x7f",
            b"\x00\x00\x80\x7f",
            b"\0\0\0\0",
        ]
    )
    return SampleFile(file.name, file.data[:at] + word + file.data[at + 4 :])


def _insert_nan(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    words = file.data.split(b" ")
    words[rng.randrange(len(words))] = rng.choice([b"nan", b"inf", b"-inf", b"1e400", b"NaN(7)", b"0x1p3", b"1_0"])
    return SampleFile(file.name, b" ".join(words))


def _delete_lines(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    lines = file.data.split(b"\n")
    start = rng.randrange(len(lines))
    del lines[start : start + rng.choice((1, 1, 2, 5))]
    return SampleFile(file.name, b"\n".join(lines))


def _duplicate(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    start = rng.randrange(len(file.data))
    stop = rng.randrange(start, len(file.data)) + 1
    return SampleFile(file.name, file.data[:stop] + file.data[start:])


def _other_extension(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    return SampleFile(rng.choice(files).name, file.data)


def _replace_all(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    data = rng.choice(
        [b"", b"\n", b"\0" * 300, bytes(rng.randrange(256) for _ in range(500)), file.data[:12] + b"\xff" * 400]
    )
    return SampleFile(file.name, data)


def _insert_bytes(file: SampleFile, rng: random.Random, files: list[SampleFile]) -> SampleFile:
    at = rng.randrange(len(file.data))
    junk = rng.choice(
        [b"\xc3\x28", b"\0", b"#", b"\n", b"\r", b" - ", b"/", b"\\\n", b"{" * 100, b"[" * 50000, b"1" * 400]
    )
    return SampleFile(file.name, file.data[:at] + junk + file.data[at:])


DAMAGES: list[Callable[[SampleFile, random.Random, list[SampleFile]], SampleFile]] = [
    _truncate,
    _flip_bytes,
    _change_number,
    _set_word,
    _insert_nan,
    _delete_lines,
    _duplicate,
    _other_extension,
    _replace_all,
    _insert_bytes,
]


def _text(pattern: str, table: np.ndarray) -> bytes:
    return "".join(pattern % tuple(row.tolist()) for row in table).encode()


def _off(header: str, vertices: np.ndarray) -> bytes:
    pattern = " ".join(["%r"] * 6 + ["%d"] * 3) if vertices.shape[1] == 9 else "%r %r %r"
    return header.encode() + _text(pattern + "\n", vertices) + _text("3 %d %d %d\n", TRIANGLES)


def _obj(face: str, triangles: np.ndarray) -> bytes:
    return b"# octahedron\no shape\n" + _text("v %r %r %r\n", VERTICES) + _text(face, triangles)


def _ply(kind: str, *, faces: bool = True) -> bytes:
    names = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header = ["ply", f"format {kind} 1.0", "comment octahedron", f"element vertex {len(VERTICES)}", *names]
    if faces:
        header += [f"element face {len(TRIANGLES)}", "property list uchar int vertex_indices"]
    head = "\n".join([*header, "end_header", ""]).encode()
    table = np.hstack([VERTICES, NORMALS, COLORS])
    if kind == "ascii":
        body = _text("%r %r %r %.9g %.9g %.9g %d %d %d\n", table)
        return head + body + (_text("3 %d %d %d\n", TRIANGLES) if faces else b"")
    order = "<" if "little" in kind else ">"
    body = b"".join(struct.pack(order + "6f3B", *row[:6], *map(int, row[6:])) for row in table.tolist())
    if faces:
        body += b"".join(struct.pack(order + "B3i", 3, *row) for row in TRIANGLES.tolist())
    return head + body


def _strips() -> bytes:
    """The octahedron as one list: two strips of a fan each, ended by -1, and two triangles alone."""
    strips = [[2, 4, 0, 3], [2, 1, 4, 3], [1, 2, 5, 0], [3, 1, 5], [0, 3, 5]]
    flat = [index for strip in strips for index in (*strip, -1)]
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    body = VERTICES.astype("<f4").tobytes() + struct.pack(f"<i{len(flat)}i", len(flat), *flat)
    return head.encode() + body


def _stl() -> bytes:
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *VERTICES[t].ravel().tolist(), 0) for t in TRIANGLES)
    return b"solid but binary".ljust(80) + struct.pack("<I", len(TRIANGLES)) + body


def _stl_text() -> bytes:
    facets = "".join(
        "  facet normal 0 0 0\n    outer loop\n"
        + "".join(f"      vertex {x!r} {y!r} {z!r}\n" for x, y, z in VERTICES[triangle].tolist())
        + "    endloop\n  endfacet\n"
        for triangle in TRIANGLES
    )
    return f"solid octahedron\n{facets}endsolid octahedron\n".encode()


def gltf_tree(**node: object) -> tuple[dict[str, object], bytes]:
    """Return a glTF document of the octahedron, whose only node has the given properties, and its buffer."""
    binary = VERTICES.astype("<f4").tobytes() + TRIANGLES.astype("<u2").tobytes()
    tree: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 24, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 72},
            {"buffer": 0, "byteOffset": 72, "byteLength": 48},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }
    return tree, binary


def pack_glb(tree: dict[str, object], binary: bytes) -> bytes:
    """Return a .glb of a document and its buffer."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _glb() -> bytes:
    return pack_glb(*gltf_tree())


def _gltf() -> bytes:
    tree, binary = gltf_tree()
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    return json.dumps({**tree, "buffers": [{"byteLength": len(binary), "uri": uri}]}, indent=1).encode()


def _pcd(kind: str) -> bytes:
    packed = COLORS @ np.array([1 << 16, 1 << 8, 1])
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z normal_x normal_y normal_z rgb\nSIZE 4 4 4 4 4 4 4\n"
        "TYPE F F F F F F U\n"
        f"COUNT 1 1 1 1 1 1 1\nWIDTH 6\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA {kind}\n"
    ).encode()
    table = np.hstack([VERTICES, NORMALS])
    if kind == "ascii":
        return head + _text("%r %r %r %.9g %.9g %.9g %d\n", np.hstack([table, packed[:, None]]))
    if kind == "binary":
        return head + b"".join(
            struct.pack("<6fI", *row, color) for row, color in zip(table.tolist(), packed.tolist(), strict=True)
        )
    fields = table.T.astype("<f4").tobytes() + packed.astype("<u4").tobytes()
    squeezed = lzf_compress(fields)
    return head + struct.pack("<II", len(squeezed), len(fields)) + squeezed


def lzf_compress(data: bytes) -> bytes:
    """Pack bytes as LZF: greedy, slow, with overlapping copies, long copies and runs of literals."""
    out, literals, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            piece = literals[start : start + 32]
            out.extend(bytes([len(piece) - 1]) + piece)
        literals.clear()

    while at < len(data):
        best, back = 0, 0
        for start in range(max(0, at - 8192), at):
            length = 0
            while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
                length += 1
            if length > best:
                best, back = length, at - start - 1
        if best < 3:
            literals.append(data[at])
            at += 1
            continue
        flush()
        code = best - 2
        if code < 7:
            out += bytes([code << 5 | back >> 8, back & 255])
        else:
            out += bytes([7 << 5 | back >> 8, code - 7, back & 255])
        at += best
    flush()
    return bytes(out)
