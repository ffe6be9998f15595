"""COLLADA and X3D: nodes, transforms, lists of faces, parts that are used again, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.scene_transforms import composed, rotation
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry import PointArrays
from tests.files.exchange import dae_bytes, x3d_bytes
from tests.files.mutations import TRIANGLES, VERTICES

DAE, X3D = dae_bytes(VERTICES, TRIANGLES.tolist()), x3d_bytes(VERTICES, TRIANGLES.tolist())


def dae(geometry: str, nodes: str, more: str = "") -> bytes:
    return (
        f"<COLLADA>{more}<library_geometries>{geometry}</library_geometries><library_visual_scenes>"
        f'<visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    ).encode()


def mesh_of_dae(lists: str, key: str = "g") -> str:
    places = " ".join(map(repr, VERTICES.ravel().tolist()))
    return (
        f'<geometry id="{key}"><mesh><source id="{key}p"><float_array count="18">{places}</float_array></source>'
        f'<vertices id="{key}v"><input semantic="POSITION" source="#{key}p"/></vertices>{lists}</mesh></geometry>'
    )


VERTEX = '<input semantic="VERTEX" source="#gv" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>'
NODE = '<node><instance_geometry url="#g"/></node>'


def refuse(name: str, data: bytes, reason: str) -> None:
    with pytest.raises(GeometryReadError, match=reason):
        parse_content(f"/{name}", data)


def test_lists_of_collada():
    pairs = " ".join(f"{a} 0 {b} 0 {c} 0" for a, b, c in TRIANGLES.tolist())
    triangles = f'<triangles count="8">{VERTEX}<p>{pairs}</p></triangles>'
    found = parse_content("/a.dae", dae(mesh_of_dae(triangles), NODE)).geometry
    np.testing.assert_array_equal(found.triangles, TRIANGLES)
    strip = f'<tristrips count="1">{VERTEX}<p>2 0 4 0 0 0 3 0 5 0</p></tristrips>'
    fan = f'<trifans count="1">{VERTEX}<p>4 0 0 0 2 0 1 0</p></trifans>'
    polygons = f'<polygons count="2">{VERTEX}<p>0 0 2 0 4 0</p><p>0 0 1 0 2 0 3 0</p></polygons>'
    found = parse_content("/a.dae", dae(mesh_of_dae(strip + fan), NODE)).geometry.triangles.tolist()
    assert found == [[2, 4, 0], [0, 4, 3], [0, 3, 5], [4, 0, 2], [4, 2, 1]]
    assert len(parse_content("/a.dae", dae(mesh_of_dae(polygons), NODE)).geometry.triangles) == 3


def test_nodes_of_collada_place_what_they_hold():
    pairs = " ".join(f"{a} 0 {b} 0 {c} 0" for a, b, c in TRIANGLES.tolist())
    geometry = mesh_of_dae(f'<triangles count="8">{VERTEX}<p>{pairs}</p></triangles>')
    nodes = (
        "<node><matrix>0 0 1 5 1 0 0 6 0 1 0 7 0 0 0 1</matrix>"
        '<node><scale>2 2 -2</scale><instance_geometry url="#g"/></node></node>'
        '<node id="again"><translate>0 0 9</translate><instance_geometry url="#g"/></node>'
        '<node><translate>1 0 0</translate><instance_node url="#again"/></node>'
    )
    found = parse_content("/a.dae", dae(geometry, nodes, '<asset><unit meter="0.01"/></asset>'))
    first, second, third = found.geometry.vertices.reshape(3, 6, 3)
    np.testing.assert_allclose(first, (VERTICES * [2, 2, -2])[:, [2, 0, 1]] + np.array([5, 6, 7]), atol=1e-12)
    np.testing.assert_allclose(second, VERTICES + np.array([0, 0, 9]), atol=1e-12)
    np.testing.assert_allclose(third, VERTICES + np.array([1, 0, 9]), atol=1e-12)
    volumes = np.linalg.det(found.geometry.vertices[found.geometry.triangles]).reshape(3, 8).sum(axis=1)
    assert (volumes > 0).all()  # the mirrored one, too
    assert found.notes == ("its coordinates are in units of 0.01 m, and stay so",)
    assert len(found.parts) == 3
    alone = f"<COLLADA><library_geometries>{geometry}</library_geometries></COLLADA>"
    np.testing.assert_array_equal(parse_content("/a.dae", alone.encode()).geometry.vertices, VERTICES)


def test_skins_are_read_as_they_are():
    controller = '<library_controllers><controller id="c"><skin source="#g"/></controller></library_controllers>'
    pairs = " ".join(f"{a} 0 {b} 0 {c} 0" for a, b, c in TRIANGLES.tolist())
    geometry = mesh_of_dae(f'<triangles count="8">{VERTEX}<p>{pairs}</p></triangles>')
    found = parse_content("/a.dae", dae(geometry, '<node><instance_controller url="#c"/></node>', controller))
    assert found.notes == ("1 skin read in the shape that it has without its bones",)
    np.testing.assert_array_equal(found.geometry.vertices, VERTICES)


def shape(content: str, places: str = "0 0 0, 1 0 0, 1 1 0, 0 1 0") -> bytes:
    text = content.replace("COORD", f'<Coordinate point="{places}"/>')
    return f"<X3D><Scene><Shape>{text}</Shape></Scene></X3D>".encode()


def test_faces_of_x3d():
    forms = {
        '<IndexedFaceSet coordIndex="0 1 2 3 -1">COORD</IndexedFaceSet>': [[0, 1, 2], [0, 2, 3]],
        '<IndexedFaceSet coordIndex="0 1 2 -1 0 2 3" ccw="false">COORD</IndexedFaceSet>': [[2, 1, 0], [3, 2, 0]],
        '<IndexedTriangleSet index="0 1 2 0 2 3">COORD</IndexedTriangleSet>': [[0, 1, 2], [0, 2, 3]],
        '<IndexedTriangleStripSet index="0 1 3 2 -1">COORD</IndexedTriangleStripSet>': [[0, 1, 3], [3, 1, 2]],
        '<IndexedTriangleFanSet index="0 1 2 3 -1">COORD</IndexedTriangleFanSet>': [[0, 1, 2], [0, 2, 3]],
        "<QuadSet>COORD</QuadSet>": [[0, 1, 2], [0, 2, 3]],
    }
    for text, expected in forms.items():
        assert parse_content("/a.x3d", shape(text)).geometry.triangles.tolist() == expected, text
    points = parse_content("/a.x3d", shape("<PointSet>COORD</PointSet>")).geometry
    assert isinstance(points, PointArrays) and len(points.points) == 4


def test_parts_of_x3d_that_are_used_again():
    text = (
        '<X3D><Scene><Group DEF="all"><Shape DEF="one"><TriangleSet><Coordinate DEF="c" point="0 0 0 1 0 0 0 1 0"/>'
        '</TriangleSet></Shape></Group><Transform translation="0 0 2" scale="1 1 -1"><Group USE="all"/></Transform>'
        '<Switch whichChoice="1"><Shape/><Shape><TriangleSet><Coordinate USE="c"/></TriangleSet></Shape></Switch>'
        '<Switch><Shape USE="one"/></Switch><Shape><Box/></Shape><Inline url="other.x3d"/></Scene></X3D>'
    )
    found = parse_content("/a.x3d", text.encode())
    np.testing.assert_array_equal(found.geometry.vertices[:, 2].reshape(3, 3)[:, 0], [0, 2, 0])
    assert found.geometry.triangles.tolist()[1] == [5, 4, 3]  # mirrored, and turned over for it
    assert found.notes == ("1 shape of kind Box passed over", "1 other file that it names passed over")


def test_transform_of_x3d_has_a_centre_and_a_slant():
    text = X3D.replace(b'translation="1 2 3"', b'translation="1 2 3" center="4 5 6" scaleOrientation="0 0 1 0.5"')
    text = text.replace(b'scale="2 2 2"', b'scale="2 1 1"')
    plain = parse_content("/a.x3d", X3D).geometry.vertices - [1, 2, 3]
    inside = plain[:, [1, 2, 0]] / 2  # undo the turn and the scale
    turn, slant = rotation(np.ones(3), 2 * np.pi / 3)[:, :3], rotation(np.array([0, 0, 1.0]), 0.5)[:, :3]
    moved = (inside - [4, 5, 6]) @ (turn @ slant @ np.diag([2, 1, 1]) @ slant.T).T + [4, 5, 6] + np.array([1, 2, 3])
    np.testing.assert_allclose(parse_content("/a.x3d", text).geometry.vertices, moved, atol=1e-9)
    assert composed().shape == (3, 4)


def test_refused_with_the_reason():
    refuse("a.dae", DAE.replace(b"#part", b"#none"), "places the geometry 'none', which is not in the file")
    refuse("a.dae", DAE.replace(b'count="8"', b'count="9"'), "9 polygons are announced")
    refuse("a.dae", DAE.replace(b"<translate>1 2 3", b"<translate>1 2"), "'translate' has 2 numbers")
    refuse("a.dae", DAE.replace(b'count="18"', b'count="21"'), "18 coordinates")
    refuse("a.dae", X3D, "not COLLADA")
    circle = '<node id="n"><instance_node url="#n"/></node>'
    refuse("a.dae", dae("", circle), "hold themselves")
    refuse("a.x3d", DAE, "not X3D")
    refuse("a.x3d", b'<X3D><Scene><Group DEF="a"><Group USE="a"/></Group></Scene></X3D>', "hold themselves")
    refuse("a.x3d", shape('<IndexedFaceSet coordIndex="0 1 9 -1">COORD</IndexedFaceSet>'), "vertices 0 … 9")
    refuse("a.x3d", b"<X3D><Scene><Shape><Sphere/></Shape></Scene></X3D>", "no surface and no points")
    bomb = '<!DOCTYPE a [<!ENTITY x "xxxxxxxxxx"><!ENTITY y "&x;&x;&x;">]>'
    refuse("a.x3d", f"{bomb}<X3D>&y;</X3D>".encode(), "defines entities of its own")
    refuse("a.dae", f'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>{DAE.decode()[39:]}'.encode(), "entities")
