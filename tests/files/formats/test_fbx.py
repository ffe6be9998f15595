"""FBX: binary and text, where models stand, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.scene_transforms import rotation
from fsh3d_o3d.files.parsing import parse_content
from tests.files.exchange import fbx_binary, fbx_bytes
from tests.files.mutations import TRIANGLES, VERTICES

TEXT = fbx_bytes(VERTICES, TRIANGLES.tolist())
X, Y, Z = np.eye(3)


def placed(*properties: str, more: str = "", links: str = "") -> np.ndarray:
    """The vertices of the octahedron below a model with these properties."""
    inside = parse_content("/a.fbx", TEXT).geometry
    plain = fbx_bytes(VERTICES, TRIANGLES.tolist()).decode()
    begin, end = plain.index('\t\t\tP: "Lcl Translation"'), plain.index("\t\t}\n\t}\n}\nConnections")
    lines = "".join(
        f'\t\t\tP: "{entry.partition(" = ")[0]}", "", "", "",{entry.partition(" = ")[2]}\n' for entry in properties
    )
    text = plain[:begin] + lines + plain[end:]
    text = text.replace("\t}\n}\nConnections:  {\n", f"\t}}\n{more}}}\nConnections:  {{\n{links}")
    assert len(inside.vertices) == 6
    return parse_content("/a.fbx", text.encode()).geometry.vertices


INSIDE = (VERTICES - [1, 2, 3])[:, [1, 0, 2]] * [1, -1, 1]  # what the file holds


def turn(axis: np.ndarray, degrees: float) -> np.ndarray:
    return rotation(axis, np.radians(degrees))[:, :3]


def test_models_are_moved_turned_and_scaled_in_that_order():
    found = placed("Lcl Translation = 5,6,7", "Lcl Rotation = 10,20,30", "Lcl Scaling = 1,2,3")
    matrix = turn(Z, 30) @ turn(Y, 20) @ turn(X, 10) @ np.diag([1, 2, 3])
    np.testing.assert_allclose(found, INSIDE @ matrix.T + [5, 6, 7], atol=1e-9)


def test_pivots_offsets_orders_and_turns_before_and_after():
    found = placed(
        "RotationActive = 1",
        "RotationOrder = 2",
        "Lcl Rotation = 10,20,30",
        "PreRotation = 90,0,0",
        "PostRotation = 0,45,0",
        "RotationPivot = 1,2,3",
        "RotationOffset = 4,5,6",
        "ScalingPivot = 3,1,2",
        "ScalingOffset = 1,1,0",
        "Lcl Scaling = 2,2,-2",
        "GeometricTranslation = 0,0,9",
    )
    outer = turn(X, 90) @ turn(X, 10) @ turn(Z, 30) @ turn(Y, 20) @ turn(Y, 45).T  # about y, then z, then x
    scaled = (INSIDE + np.array([0, 0, 9]) - [3, 1, 2]) * [2, 2, -2] + [3, 1, 2] + np.array([1, 1, 0])
    np.testing.assert_allclose(found, (scaled - [1, 2, 3]) @ outer.T + [1, 2, 3] + np.array([4, 5, 6]), atol=1e-9)


def test_models_stand_in_models_and_meshes_are_shown_twice():
    more = (
        '\tModel: 30, "Model::above", "Null" {\n\t\tProperties70:  {\n'
        '\t\t\tP: "Lcl Translation", "", "", "",0,0,50\n\t\t}\n\t}\n'
        '\tModel: 40, "Model::other", "Mesh" {\n\t}\n'
    )
    links = '\tC: "OO",20,30\n\tC: "OO",30,0\n\tC: "OO",10,40\n'
    found = placed("Lcl Translation = 5,6,7", more=more, links=links)
    np.testing.assert_allclose(found.reshape(2, 6, 3)[0], INSIDE, atol=1e-9)
    np.testing.assert_allclose(found.reshape(2, 6, 3)[1], INSIDE + np.array([5, 6, 57]), atol=1e-9)


def test_refused_with_the_reason():
    def refuse(data: bytes, reason: str) -> None:
        with pytest.raises(GeometryReadError, match=reason):
            parse_content("/a.fbx", data)

    binary = fbx_binary(7400)
    refuse(TEXT.replace(b"7400", b"6100"), "its version is 6100; those from 7000 on")
    refuse(TEXT[:-3], "truncated: the record 'Connections' is not closed")
    refuse(TEXT.replace(b"Connections", b"Con nections"), "where a record should begin")
    refuse(TEXT.replace(b",-5\n", b",5\n").replace(b",-6\n", b",5\n"), "has no end")
    refuse(TEXT.replace(b'"OO",20,0', b'"OO",20,20'), "a model is above itself")
    refuse(b"; FBX\nA: {" * 100, "neither binary FBX|nested")
    refuse(binary[:-60], "breaks off")
    refuse(binary.replace(b"\x18\x00\x00\x00\x01\x00\x00\x00", b"\xff\xff\xff\xff\x01\x00\x00\x00"), "an array of")
