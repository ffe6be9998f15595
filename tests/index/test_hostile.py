"""Files that lie about their size, and descriptions that hang, devour or die: each costs itself and nothing else."""

from __future__ import annotations

import base64
import json
import os
import signal
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.index.shape_index import ShapeIndex
from fsh3d_o3d.sphere.icosahedron import icosphere
from tests.files.mutations import gltf_tree, pack_glb
from tests.index.index_cases import QUICK, write_library
from tests.jobs.toys import let_an_hour_pass

HUGE = 10**10
ROOM = 2**28  # bytes that a file may take: far less than any of these files announces or unfolds to


def lying_files(folder: Path) -> dict[str, str]:
    """Write them; returns what is to be said of each by its name."""
    tree, binary = gltf_tree()
    points, corners = tree["accessors"]
    view, other = tree["bufferViews"]

    def glb(name: str, **changes: object) -> None:
        (folder / name).write_bytes(pack_glb({**tree, **changes}, binary))

    glb("count.glb", accessors=[{**points, "count": HUGE}, {**corners, "count": HUGE}])
    glb(
        "view.glb",
        accessors=[{**points, "count": HUGE}, corners],
        bufferViews=[{**view, "byteLength": 12 * HUGE}, other],
    )
    glb("still.glb", accessors=[{**points, "count": HUGE}, corners], bufferViews=[{**view, "byteStride": 0}, other])
    glb("wrap.glb", accessors=[{**points, "count": 2**61}, corners], bufferViews=[{**view, "byteStride": 2**61}, other])
    sparse = {"count": HUGE, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 0}}
    bare = {"componentType": 5126, "count": HUGE, "type": "VEC3"}
    glb("sparse.glb", accessors=[{**bare, "sparse": sparse}, corners])
    glb("zeros.glb", accessors=[bare, corners])
    # Two kilobytes that name eight triangles 16 million times: each node has two children, which are the next one.
    glb("doubling.glb", nodes=[{"children": [k + 1, k + 1]} for k in range(24)] + [{"mesh": 0}])
    for name, opening in (("lists.glb", b'{"nodes":' + b"[" * 10**6), ("objects.glb", b'{"a":' * 10**6)):
        text = opening + b" " * (-len(opening) % 4)
        chunk = len(text).to_bytes(4, "little") + b"JSON" + text
        (folder / name).write_bytes(b"glTF\2\0\0\0" + (12 + len(chunk)).to_bytes(4, "little") + chunk)
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    announced = {**tree, "buffers": [{"byteLength": 12 * HUGE, "uri": uri}]}
    (folder / "announced.gltf").write_text(json.dumps(announced))
    (folder / "digits.gltf").write_text('{"nodes": ' + "9" * 10**6 + "}")
    return {
        "count.glb": f"truncated or damaged: accessor 0 of {HUGE} items exceeds its buffer",
        "view.glb": f"truncated or damaged: buffer view 0 exceeds its buffer of {len(binary)} bytes",
        "still.glb": f"truncated or damaged: accessor 0 of {HUGE} items exceeds its buffer",
        "wrap.glb": f"truncated or damaged: accessor 0 of {2**61} items exceeds its buffer",
        "sparse.glb": f"damaged: accessor 0 has {HUGE} items and no buffer",
        "zeros.glb": f"damaged: accessor 0 has {HUGE} items and no buffer",
        "doubling.glb": "damaged: node 1 has two parents",
        "lists.glb": "damaged: the JSON is nested too deeply",
        "objects.glb": "damaged: the JSON is nested too deeply",
        "announced.gltf": f"truncated: buffer 0 announces {12 * HUGE} bytes and has {len(binary)}",
        "digits.gltf": "truncated or damaged JSON",
    }


def test_files_that_lie_about_their_size(tmp_path):
    (good,) = write_library(tmp_path, [0])
    expected = lying_files(tmp_path)
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    # Refused for what they say, not because room or time ran out.
    update = index.add_files([*(tmp_path / name for name in expected), good], workers=1, memory_limit=ROOM)
    assert (update.added, len(index)) == (1, 1)
    reasons = {Path(failed.path).name: failed.reason for failed in update.failed}
    assert reasons.keys() == expected.keys()
    for name, reason in expected.items():
        assert reasons[name].startswith(reason), name


def test_a_file_that_unfolds_runs_out_of_its_own_room(tmp_path):
    tree, _ = gltf_tree()
    count, times = 10**5, 10**4
    (position, _), (view, _) = tree["accessors"], tree["bufferViews"]
    # 1.2 MB of which 10⁹ triangle corners could be made.
    tree["accessors"] = [{**position, "count": count - count % 3}]
    tree["bufferViews"] = [{**view, "byteLength": 12 * count}]
    tree["buffers"] = [{"byteLength": 12 * count}]
    tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * times}]
    bomb = tmp_path / "bomb.glb"
    bomb.write_bytes(pack_glb(tree, bytes(12 * count)))
    assert bomb.stat().st_size < 2 * 10**6
    paths = [bomb, *write_library(tmp_path, [0])]
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    update = index.add_files(paths, workers=1, memory_limit=ROOM)
    assert [(Path(failed.path).name, failed.reason) for failed in update.failed] == [
        ("bomb.glb", "needs more memory than the reader is allowed")
    ]
    assert update.added == 1


@dataclass(frozen=True)
class Misbehaving:
    """Does what the number of vertices says, as long as there is no file ``log``/healed; notes each call there."""

    log: Path

    def __call__(self, geometry) -> bytes:
        number = len(geometry.vertices)
        with (self.log / "calls").open("a") as calls:
            calls.write(f"{number}\n")
        if not (self.log / "healed").exists():
            if number == SIZES["sleeps"]:
                (self.log / "asleep").touch()
                time.sleep(3600)
            elif number == SIZES["devours"]:
                bytearray(2 * ROOM)
            elif number == SIZES["killed"]:
                os.kill(os.getpid(), signal.SIGKILL)
            elif number == SIZES["crashes"]:
                os.kill(os.getpid(), signal.SIGSEGV)
            elif number == SIZES["leaves"]:
                os._exit(0)
        return b"picture"

    def calls(self) -> Counter[int]:
        return Counter(map(int, (self.log / "calls").read_text().split()))


FREQUENCY = {"sleeps": 3, "devours": 4, "killed": 5, "crashes": 6, "leaves": 7, "well": 8}
SIZES = {name: 10 * frequency**2 + 2 for name, frequency in FREQUENCY.items()}
REASONS = {
    "sleeps": "took longer than 3600 s",
    "devours": "out of memory",
    "killed": "the process describing it was killed by SIGKILL, perhaps for want of memory",
    "crashes": "the process describing it was killed by SIGSEGV",
    "leaves": "the process describing it ended with exit code 0",
}


def test_descriptions_that_hang_devour_or_die_are_listed_and_not_tried_again(tmp_path, monkeypatch):
    let_an_hour_pass(monkeypatch, tmp_path / "asleep")
    paths = []
    for name, frequency in FREQUENCY.items():
        directions, triangles = icosphere(frequency)
        paths.append(tmp_path / f"{name}.off")
        write_geometry(paths[-1], MeshArrays(directions * [1, 2, 3], triangles))
    thumbnail = Misbehaving(tmp_path)
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)

    def add(**options):
        return index.add_files(paths, workers=1, thumbnail=thumbnail, memory_limit=ROOM, timeout=3600, **options)

    first = add()
    assert {Path(failed.path).stem: failed.reason for failed in first.failed} == REASONS
    assert (first.added, len(index)) == (1, 1)
    assert index.query(paths[-1])[0].thumbnail == b"picture"
    assert thumbnail.calls() == Counter(SIZES.values())  # each had its turn, once

    (tmp_path / "healed").touch()
    again = add()
    assert (again.added, again.unchanged, again.failed) == (0, 1, first.failed)
    assert thumbnail.calls() == Counter(SIZES.values())

    retried = add(retry_failed=True)
    assert (retried.added, retried.unchanged, retried.failed) == (5, 1, ())
    assert (len(index), index.failures()) == (6, ())
    assert thumbnail.calls() == Counter(SIZES.values()) + Counter(SIZES[name] for name in REASONS)
