"""VTK: every way of writing arrays, kinds of cells, the surface of solid ones, and values at points."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import serialise
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.files.serialise_vtp import vtp_bytes
from fsh3d_o3d.geometry import EdgeTable, PointArrays
from tests.files.exchange import packed, rows, vtk_text, vtu
from tests.files.mutations import COLORS, NORMALS, TRIANGLES, VERTICES

SURFACE = serialise.Content(VERTICES, TRIANGLES, NORMALS, COLORS / 255)
CUBE = np.array(list(itertools.product((0, 1), repeat=3)), dtype=float)[:, ::-1]  # rows of a voxel: x fastest


def volume(mesh) -> float:
    return float(np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6)


def refuse(name: str, data: bytes, reason: str) -> None:
    with pytest.raises(GeometryReadError, match=reason):
        parse_content(f"/{name}", data)


def test_normals_colours_and_other_values_come_along():
    more = (
        "POINT_DATA 6\nSCALARS pressure float 1\nLOOKUP_TABLE default\n1 2 3 4 5 6\nNORMALS n float\n"
        + rows("%r %r %r\n", NORMALS)
        + "COLOR_SCALARS c 3\n"
        + rows("%r %r %r\n", COLORS / 255)
        + "FIELD FieldData 1\nspeed 2 6 double\n"
        + rows("%r %r\n", VERTICES[:, :2])
        + "CELL_DATA 8\nSCALARS x int\nLOOKUP_TABLE default\n1 2 3 4 5 6 7 8\n"
    )
    legacy = parse_content("/a.vtk", vtk_text(more)).geometry
    arrays = {"Normals": NORMALS, "RGB": COLORS.astype("u1"), "pressure": np.arange(1, 7.0), "speed": VERTICES[:, :2]}
    inner = "".join(
        f'<DataArray type="{"UInt8" if name == "RGB" else "Float64"}" Name="{name}" format="binary" '
        f'NumberOfComponents="{np.size(values[0])}">{packed(np.ascontiguousarray(values))}</DataArray>'
        for name, values in arrays.items()
    )
    xml = parse_content("/a.vtu", vtu(more=f"<PointData>{inner}</PointData>")).geometry
    written = parse_content("/a.vtp", vtp_bytes(SURFACE)).geometry
    for mesh in (legacy, xml, written):
        np.testing.assert_array_equal(mesh.vertices, VERTICES)
        np.testing.assert_array_equal(mesh.normals, NORMALS)
        np.testing.assert_allclose(mesh.colors, COLORS / 255, atol=1e-15)
    for mesh in (legacy, xml):
        np.testing.assert_array_equal(mesh.attributes["pressure"], np.arange(1, 7))
        np.testing.assert_array_equal(mesh.attributes["speed"], VERTICES[:, :2])


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("form", ["ascii", "base64", "zlib", "raw"])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
def test_every_way_of_writing_arrays(order, form, header):
    import base64
    import zlib

    mark = "<" if order == "little" else ">"
    size = mark + ("u4" if header == "UInt32" else "u8")
    appended = b""

    def array(values: np.ndarray, kind: str, name: str = "", width: int = 1) -> str:
        nonlocal appended
        data = values.astype(values.dtype.newbyteorder(mark)).tobytes()
        begin = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format='
        if form == "ascii":
            return f'{begin}"ascii">{" ".join(map(repr, values.ravel().tolist()))}</DataArray>'
        if form == "base64":
            text = base64.b64encode(np.array([len(data)], size).tobytes() + data).decode()
            return f'{begin}"binary">\n  {text}\n</DataArray>'
        place = len(appended)
        if form == "zlib":
            block = zlib.compress(data)
            appended += np.array([1, len(data), 0, len(block)], size).tobytes() + block
        else:
            appended += np.array([len(data)], size).tobytes() + data
        return f'{begin}"appended" offset="{place}"/>'

    points = array(VERTICES.astype("f4"), "Float32", width=3)
    polygons = array(TRIANGLES.ravel().astype("i4"), "Int32", "connectivity")
    polygons += array(np.arange(3, 25, 3).astype("i4"), "Int32", "offsets")
    text = (
        f'<?xml version="1.0"?><VTKFile type="PolyData" byte_order="{order.title()}Endian" header_type="{header}"'
        f"{' compressor=' + chr(34) + 'vtkZLibDataCompressor' + chr(34) if form == 'zlib' else ''}>"
        f'<PolyData><Piece NumberOfPoints="6" NumberOfPolys="8"><Points>{points}</Points><Polys>{polygons}</Polys>'
        f'</Piece></PolyData><AppendedData encoding="raw">_'
    )
    mesh = parse_content("/a.vtp", text.encode() + appended + b"</AppendedData></VTKFile>").geometry
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.triangles, TRIANGLES)


@pytest.mark.parametrize("version", [3, 5])
def test_binary_legacy(version):
    head = f"# vtk DataFile Version {version}.1\nx\nBINARY\nDATASET POLYDATA\nPOINTS 6 float\n".encode()
    body = VERTICES.astype(">f4").tobytes() + b"\n"
    if version == 3:
        body += b"POLYGONS 8 32\n" + np.insert(TRIANGLES, 0, 3, axis=1).astype(">i4").tobytes() + b"\n"
    else:
        body += b"METADATA\nINFORMATION 0\n\nPOLYGONS 9 24\nOFFSETS vtktypeint64\n"
        body += np.arange(0, 25, 3).astype(">i8").tobytes() + b"\nCONNECTIVITY vtktypeint64\n"
        body += TRIANGLES.astype(">i8").tobytes() + b"\n"
    data = head + body
    mesh = parse_content("/a.vtk", data).geometry
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.triangles, TRIANGLES)
    for size in range(len(head), len(data) - 1):
        with pytest.raises(GeometryReadError):
            parse_content("/a.vtk", data[:size])


def test_solid_cells_give_their_outer_surface():
    """Two boxes that share a face, as hexahedra and voxels; the face between them is inside."""
    points = np.vstack([CUBE, CUBE + np.array([1, 0, 0])])
    for kind, order in ((11, [0, 1, 2, 3, 4, 5, 6, 7]), (12, [0, 1, 3, 2, 4, 5, 7, 6])):
        cells = np.array([order, [k + 8 for k in order]])
        cells[1] = np.where(np.isin(cells[1] - 8, [0, 2, 4, 6]), cells[1] - 7, cells[1])  # the corners that are shared
        mesh = parse_content("/a.vtu", vtu(points, cells, kind)).geometry
        assert volume(mesh) == pytest.approx(2) and len(mesh.triangles) == 20 and len(mesh.vertices) == 12
        assert (EdgeTable(mesh.triangles).faces == 2).all()
    tetrahedra = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    mesh = parse_content("/a.vtu", vtu(CUBE, tetrahedra, 10)).geometry
    assert volume(mesh) == pytest.approx(1) and len(mesh.triangles) == 12
    wedge = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1.0]])
    assert volume(parse_content("/a.vtu", vtu(wedge, np.arange(6)[None], 13)).geometry) == pytest.approx(0.5)
    pyramid = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    assert volume(parse_content("/a.vtu", vtu(pyramid, np.arange(5)[None], 14)).geometry) == pytest.approx(1 / 3)


def test_strips_pixels_and_clouds():
    text = vtk_text().partition(b"POLYGONS")[0]
    strips = text + b"TRIANGLE_STRIPS 3 17\n6 2 4 0 3 5 1\n5 2 5 0 1 4\n3 1 3 4\n"
    found = parse_content("/a.vtk", strips).geometry.triangles.tolist()
    assert found[:4] == [[2, 4, 0], [0, 4, 3], [0, 3, 5], [5, 3, 1]] and found[-1] == [1, 3, 4]
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    mesh = parse_content("/a.vtu", vtu(square, np.arange(4)[None], 8)).geometry
    areas = np.cross(*np.diff(mesh.vertices[mesh.triangles], axis=1).transpose(1, 0, 2))[:, 2]
    np.testing.assert_array_equal(areas, [1, 1])
    cloud = parse_content("/a.vtp", vtp_bytes(serialise.Content(VERTICES, None, NORMALS, COLORS / 255))).geometry
    assert cloud == PointArrays(VERTICES, NORMALS, COLORS / 255)
    vertices = b"VERTICES 1 7\n6 0 1 2 3 4 5\n"
    assert parse_content("/a.vtk", text + vertices).geometry == PointArrays(VERTICES)
    refuse("a.vtk", text, "truncated, or only points")


def test_refused_with_the_reason():
    text = vtk_text()
    refuse("a.vtk", text.replace(b"POLYDATA", b"STRUCTURED_POINTS"), "holds 'DATASET STRUCTURED_POINTS'")
    refuse("a.vtk", text.replace(b"POINTS 6", b"POINTS 7"), "21 numbers announced, 18 follow")
    refuse("a.vtk", text.replace(b"3 0 2 4", b"3 0 2 9"), "points 0 … 9, but there are points 0 … 5")
    refuse("a.vtk", text.replace(b"8 32", b"8 31"), "31 numbers announced, 32 follow")
    refuse("a.vtk", text.replace(b"double", b"triple"), "of type 'triple'")
    refuse("a.vtk", text.partition(b"POLYGONS")[0] + b"LINES 1 3\n2 0 1\n", "no surface, only lines|kind")
    refuse("a.vtu", vtu(kind=42), "cells are of kind 42, which is not read")
    refuse("a.vtu", vtu().replace(b"vtkZLib", b"vtkLZ4"), "packed by vtkLZ4DataCompressor, which is not read")
    refuse("a.vtu", vtu().replace(b'NumberOfCells="8"', b'NumberOfCells="9"'), "8 cells, but 8 kinds|kinds of them")
    refuse("a.vtp", vtp_bytes(SURFACE).replace(b'NumberOfPolys="8"', b'NumberOfPolys="7"'), "7 Polys are announced, 8")
    refuse("a.vtp", vtp_bytes(SURFACE).replace(b'offset="0"', b'offset="9999"'), "beyond the appended data")
    bomb = packed(VERTICES)
    import base64
    import struct

    huge = base64.b64encode(struct.pack("<4I", 2**31, 2**31, 0, 10)).decode()
    refuse("a.vtu", vtu().replace(bomb.encode(), huge.encode()), "announces 2147483648 packed blocks")
