"""3MF: what is built, where, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import serialise
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.files.serialise_3mf import threemf_bytes
from tests.files.exchange import model_3mf, object_3mf, pack_3mf
from tests.files.mutations import TRIANGLES, VERTICES
from tests.files.test_archives import zipped

PATH = ' xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" requiredextensions="p"'


def read(data: bytes):
    return parse_content("/a.3mf", data)


def refuse(data: bytes, reason: str) -> None:
    with pytest.raises(GeometryReadError, match=reason):
        read(data)


def volume(mesh) -> float:
    return float(np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6)


def test_each_item_and_component_is_a_part_where_it_is_placed():
    double = '<object id="9" name="pair"><components><component objectid="1"/>'
    double += '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/></components></object>'
    found = read(
        pack_3mf(
            model_3mf(
                object_3mf(1) + object_3mf(2) + double,
                '<item objectid="9"/><item objectid="2" transform="2 0 0 0 2 0 0 0 -2 0 0 7"/>',
            )
        )
    )
    assert [(part.name, part.points, part.triangles) for part in found.parts] == [
        ("part 1", 6, 8),
        ("part 1", 6, 8),
        ("part 2", 6, 8),
    ]
    first, second, third = found.geometry.vertices.reshape(3, 6, 3)
    np.testing.assert_array_equal(first, VERTICES)
    np.testing.assert_array_equal(second, VERTICES + np.array([10, 0, 0]))
    np.testing.assert_array_equal(third, VERTICES * [2, 2, -2] + [0, 0, 7])
    # Mirrored, yet its outside is outside: twice its volume by 2³ and two of its size.
    single = read(pack_3mf(model_3mf(object_3mf(1), '<item objectid="1"/>'))).geometry
    assert volume(found.geometry) == pytest.approx(10 * volume(single)) and volume(single) > 0


def test_models_in_other_parts_of_the_package():
    item = '<item objectid="1" p:path="/3D/other.model"/>'
    found = read(pack_3mf(model_3mf("", item, PATH), other=model_3mf(object_3mf(1), "")))
    np.testing.assert_array_equal(found.geometry.vertices, VERTICES)


def test_supports_are_left_out_and_units_are_named():
    support = object_3mf(2).replace('type="model"', 'type="support"')
    text = model_3mf(object_3mf(1) + support, '<item objectid="1"/><item objectid="2"/>')
    found = read(pack_3mf(text.replace("millimeter", "inch")))
    assert len(found.geometry.triangles) == 8
    assert found.notes == ("its coordinates are in the unit 'inch', and stay so", "1 support of the print left out")


def test_model_in_utf16():
    text = model_3mf(object_3mf(1), '<item objectid="1"/>').replace("UTF-8", "UTF-16")
    np.testing.assert_array_equal(read(pack_3mf(text.encode("utf-16"))).geometry.vertices, VERTICES)


def test_refused_with_the_reason():
    item = '<item objectid="1"/>'
    whole = model_3mf(object_3mf(1), item)
    refuse(zipped({"a.txt": b"x"}), "no 3MF: '_rels/.rels' is missing")
    refuse(pack_3mf(model_3mf(object_3mf(1), "")), "builds nothing")
    refuse(pack_3mf(model_3mf(object_3mf(1), '<item objectid="3"/>')), "object 3, which is not there")
    refuse(pack_3mf(whole.replace('v3="4"', 'v3="6"', 1)), "vertices 0 … 6, but there are vertices 0 … 5")
    refuse(pack_3mf(whole.replace('x="1.5"', 'x="1,5"', 1)), "expected one number, found '1,5'|expected numbers")
    refuse(pack_3mf(whole.replace('x="1.5"', 'x="nan"', 1)), "NaN or infinite")
    refuse(pack_3mf(whole.replace('x="1.5" ', "", 1)), "'vertex' has no attribute 'x'")
    refuse(pack_3mf(whole.replace('x="1.5"', 'x="1.5" x="2"', 1)), "or has it twice")
    refuse(pack_3mf(whole.replace("<vertex ", "<point ", 1)), "1 other elements stand among those named 'vertex'")
    refuse(pack_3mf(whole[:-20]), "no whole XML")
    refuse(pack_3mf(model_3mf(object_3mf(1) * 2, item)), "two objects have the number 1")
    strange = whole.replace("<model ", '<model xmlns:b="http://x/beamlattice/2017/02" requiredextensions="b" ')
    refuse(pack_3mf(strange), "requires an extension that is not read: http://x/beamlattice")
    entities = '<?xml version="1.0"?><!DOCTYPE model [<!ENTITY a "b">]>'
    refuse(pack_3mf(whole.replace('<?xml version="1.0" encoding="UTF-8"?>', entities)), "defines entities of its own")
    refuse(pack_3mf(whole.replace("<build>", "<a>" * 300 + "</a>" * 300 + "<build>")), "nested more than 200 deep")


def test_components_that_hold_themselves_or_double_without_end_are_refused():
    circle = '<object id="1"><components><component objectid="1"/></components></object>'
    refuse(pack_3mf(model_3mf(circle, '<item objectid="1"/>')), "hold themselves")
    doubles = object_3mf(1) + "".join(
        f'<object id="{n}"><components>{f"""<component objectid="{n - 1}"/>""" * 2}</components></object>'
        for n in range(2, 40)
    )
    refuse(pack_3mf(model_3mf(doubles, '<item objectid="39"/>')), "more than 65536 meshes")


def test_lib3mf_agrees_on_what_is_written():
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf, a second opinion, is not installed")
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.QueryReader("3mf").ReadFromBuffer(threemf_bytes(serialise.Content(VERTICES * np.pi, TRIANGLES, None, None)))
    meshes = model.GetMeshObjects()
    assert meshes.MoveNext()
    mesh = meshes.GetCurrentMeshObject()
    vertices = np.array([list(vertex.Coordinates) for vertex in mesh.GetVertices()])
    np.testing.assert_allclose(vertices, VERTICES * np.pi, rtol=1e-7)  # it keeps float32
    assert [list(triangle.Indices) for triangle in mesh.GetTriangleIndices()] == TRIANGLES.tolist()
