"""Small valid files of the formats in which CAD, printing, surveying and medicine exchange shapes."""

from __future__ import annotations

import base64
import io
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.files.serialise import Content
from fsh3d_o3d.files.serialise_las import las_bytes
from fsh3d_o3d.files.serialise_vtp import vtp_bytes
from tests.files.mutations import COLORS, NORMALS, TRIANGLES, VERTICES
from tests.files.volumes import labels, nifti, nrrd

with pytest.MonkeyPatch.context() as _patch:
    _patch.syspath_prepend(str(Path(__file__).parents[2] / "samples"))
    from _cad_writers import iges_bytes, step_bytes
    from _scene_writers import dae_bytes, fbx_bytes, threemf_bytes, x3d_bytes
    from _survey_writers import Scan, e57_bytes

CLOUD = Content(VERTICES, None, None, COLORS / 255)
TURNED = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # a quarter about z

# The cloud as lazrs 0.8 packs it, kept as text, so that it is there to be refused without lazrs as well.
LAZ = base64.b85decode(
    "OhHpd00000000000000000000000000Rm4{NJUZr000000000000000000000000000000003rlXftGAZ!=^dFfKAKFaQ7m00000"
    "0000000000000000083vM*#o;0RR91f*Jq@00006000000000000000000000000wj4<Mkc||@tj4<Mkc||@tj4<Mkc||?|00000"
    "0QkQE000000QA2A00000006)M000000Qf%u000000QkQE000000Q5fq000000QA2A00000002M$00000006)M0Bm7%dTDSVWo~0{"
    "WMyOk0K8T%0Bm7;a&rIx00000000000000000000000000000000IC200II40000008qmK0RR90|NsC0|NsC0|NsC0{{jF802BZM"
    "00;mE00IEF0RR9100000qu~)iS#t*f!s`nF00{s900030{{R3000WT>h;kDL!azbHz^X<3X_q6X{2nYV8RbK_ek@7bVcPn-wTDQd"
    ")<5&K3``76q@@qTgEqm}Ot`>68{`|(1N&}f+B+Mk5R?Hi00000000010000yiU0rr"
)


@dataclass(frozen=True)
class Exchange:
    """A file that holds the octahedron of ``mutations``, or its vertices as a cloud."""

    name: str
    """File name with extension, different for each."""
    data: bytes
    """Content."""
    shape: str = "octahedron"
    """Or "cloud", or "labels" of ``volumes``."""
    tolerance: float = 0.0
    """How far coordinates may be off, where the format rounds them."""
    needs: str = ""
    """The module without which it cannot be read."""
    tail: int = 0
    """How many bytes at the end may be missing without loss."""


def exchange_files() -> dict[str, Exchange]:
    """Return the files by name."""
    files = [
        Exchange("plain.3mf", pack_3mf(model_3mf(object_3mf(1), '<item objectid="1"/>'))),
        Exchange("placed.3mf", _placed_3mf()),
        Exchange("plain.step", step_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-6, "cascadio", tail=2),
        Exchange("plain.stp", step_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-6, "cascadio", tail=2),
        Exchange("plain.igs", iges_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-6, "cascadio", tail=8),
        Exchange("plain.iges", iges_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-6, "cascadio", tail=8),
        *_volumes(),
        Exchange("component.3mf", threemf_bytes(VERTICES, TRIANGLES)),
        Exchange("plain.dae", dae_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-12, tail=1),
        Exchange("text.fbx", fbx_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-12, tail=1),
        Exchange("binary.fbx", fbx_binary(7400), "octahedron", 1e-12, tail=13),
        Exchange("wide.fbx", fbx_binary(7700), "octahedron", 1e-12, tail=25),
        Exchange("plain.x3d", x3d_bytes(VERTICES, TRIANGLES.tolist()), "octahedron", 1e-12, tail=1),
        Exchange("plain.vtk", vtk_text(), tail=1),
        Exchange("plain.vtp", vtp_bytes(Content(VERTICES, TRIANGLES, NORMALS, COLORS / 255)), tail=11),
        Exchange("plain.vtu", vtu(), tail=1),
        Exchange("scan.e57", e57_bytes([Scan("scan", VERTICES, colors=COLORS / 255)]), "cloud"),
        Exchange("plain.las", las_bytes(CLOUD), "cloud", 1e-8),
        Exchange("packed.laz", LAZ, "cloud", 1e-8, "lazrs"),
    ]
    return {file.name: file for file in files}


def rows(pattern: str, table: np.ndarray) -> str:
    """Lines of a table."""
    return "".join(pattern % tuple(row) for row in table.tolist())


def object_3mf(number: int, vertices: np.ndarray = VERTICES, more: str = "") -> str:
    """An object of 3MF with a mesh."""
    return (
        f'<object id="{number}" type="model" name="part {number}"{more}><mesh>\n<vertices>\n'
        + rows('<vertex x="%r" y="%r" z="%r" />\n', vertices)
        + "</vertices>\n<triangles>\n"
        + rows('<triangle v1="%d" v2="%d" v3="%d" />\n', TRIANGLES)
        + "</triangles>\n</mesh></object>\n"
    )


def model_3mf(resources: str, items: str, more: str = "") -> str:
    """A model of 3MF."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" '
        f'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"{more}>\n'
        f"<resources>{resources}</resources>\n<build>{items}</build></model>"
    )


def pack_3mf(model: str | bytes, **others: str) -> bytes:
    """A package of 3MF; others are further models by name."""
    relations = (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r" '
        'Target="/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
        "</Relationships>"
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(zipfile.ZipInfo("_rels/.rels"), relations)
        for name, text in {"3dmodel": model, **others}.items():
            file.writestr(zipfile.ZipInfo(f"3D/{name}.model"), text)
    return buffer.getvalue()


def _placed_3mf() -> bytes:
    """Written with single quotes, other orders and a component, and placed back to where it belongs."""
    inside = (VERTICES - [1, 2, 3]) @ TURNED  # which TURNED and a shift bring back
    text = object_3mf(4, inside).replace(' z="', " material='7' z=\"").replace('"', "'")
    text = text.replace("v1=", "p1 = '0' v1 = ").replace("<vertices>", "<vertices><!-- <vertex/> -->")
    column = " ".join(f"{value!r}" for value in TURNED.T.ravel().tolist())
    outer = f'<object id="5"><components><component objectid="4" transform="{column} 1 0 0"/></components></object>'
    return pack_3mf(model_3mf(text + outer, '<item objectid="5" transform="1 0 0 0 1 0 0 0 1 0 2 3"/>'))


def vtk_text(more: str = "") -> bytes:
    """Legacy VTK as text."""
    return (
        "# vtk DataFile Version 3.0\noctahedron\nASCII\nDATASET POLYDATA\nPOINTS 6 double\n"
        + rows("%r %r %r\n", VERTICES)
        + "POLYGONS 8 32\n"
        + rows("3 %d %d %d\n", TRIANGLES)
        + more
    ).encode()


def packed(values: np.ndarray) -> str:
    """Values as VTK packs them: in blocks of 64 bytes by zlib, in base64, with their lengths in front."""
    data = values.tobytes()
    blocks = [zlib.compress(data[at : at + 64]) for at in range(0, len(data), 64)]
    head = struct.pack(f"<{3 + len(blocks)}I", len(blocks), 64, len(data) % 64, *map(len, blocks))
    return (base64.b64encode(head) + base64.b64encode(b"".join(blocks))).decode()


def vtu(points: np.ndarray = VERTICES, cells: np.ndarray = TRIANGLES, kind: int = 5, more: str = "") -> bytes:
    """An unstructured grid of cells of one kind."""
    arrays = {
        "connectivity": ("Int64", cells.astype("<i8")),
        "offsets": ("Int64", np.arange(1, len(cells) + 1, dtype="<i8") * cells.shape[1]),
        "types": ("UInt8", np.full(len(cells), kind, dtype="u1")),
    }
    lists = "".join(
        f'<DataArray type="{name}" Name="{key}" format="binary">{packed(values)}</DataArray>\n'
        for key, (name, values) in arrays.items()
    )
    return (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">\n{more}'
        f'<Points><DataArray type="Float64" NumberOfComponents="3" format="binary">{packed(points)}</DataArray>'
        f"</Points><Cells>{lists}</Cells></Piece></UnstructuredGrid></VTKFile>\n"
    ).encode()


def fbx_binary(version: int) -> bytes:
    """Binary FBX of the octahedron below a model that is moved and turned, arrays packed."""
    wide = version >= 7500
    head, empty = ("<QQQB", bytes(25)) if wide else ("<IIIB", bytes(13))
    inside = (VERTICES - [1.0, 2.0, 3.0]) @ TURNED
    listed = np.where(np.arange(24) % 3 == 2, -1 - TRIANGLES.ravel(), TRIANGLES.ravel())

    def value(one: object) -> bytes:
        if isinstance(one, str):
            return b"S" + struct.pack("<I", len(one)) + one.encode()
        if isinstance(one, np.ndarray):
            data = zlib.compress(one.tobytes())
            return {"f8": b"d", "i4": b"i"}[one.dtype.str[1:]] + struct.pack("<III", one.size, 1, len(data)) + data
        return b"L" + struct.pack("<q", one) if isinstance(one, int) else b"D" + struct.pack("<d", one)

    def record(at: int, name: str, values: list, children: list) -> bytes:
        body = name.encode() + b"".join(map(value, values))
        size = len(body) - len(name)
        begin = struct.calcsize(head)
        for child in children:
            body += record(at + begin + len(body), *child)
        body += empty if children else b""
        return struct.pack(head, at + begin + len(body), len(values), size, len(name)) + body

    turned = ["Lcl Rotation", "Lcl Rotation", "", "A", 0.0, 0.0, 90.0]
    moved = ["Lcl Translation", "Lcl Translation", "", "A", 1.0, 2.0, 3.0]
    geometry = [("Vertices", [inside.ravel()], []), ("PolygonVertexIndex", [listed.astype("<i4")], [])]
    properties = ("Properties70", [], [("P", moved, []), ("P", turned, [])])
    tree = [
        ("Objects", [], [("Geometry", [10, "part", "Mesh"], geometry), ("Model", [20, "part", "Mesh"], [properties])]),
        ("Connections", [], [("C", ["OO", 20, 0], []), ("C", ["OO", 10, 20], [])]),
    ]
    result = b"Kaydara FBX Binary  \0\x1a\0" + struct.pack("<I", version)
    for one in tree:
        result += record(len(result), *one)
    return result + empty


def _volumes() -> list[Exchange]:
    """Volumes of labels; a flipped bit among the voxels goes unseen where nothing is packed."""
    buffer = io.BytesIO()
    np.save(buffer, labels())
    head, body = nrrd(labels(), "gzip")
    files = [
        Exchange("labels.nii", nifti(labels()), "labels"),
        Exchange("labels.nrrd", head + body, "labels"),
        Exchange("labels.nhdr", head + body, "labels"),
        Exchange("labels.npy", buffer.getvalue(), "labels"),
    ]
    return files + [
        Exchange(f"labels{ending}", TIFF, "labels", needs="tifffile", tail=4) for ending in (".tif", ".tiff")
    ]


def pack_tiff(pages: np.ndarray) -> bytes:
    """A stack of pages of one byte a pixel, without compression."""
    tags = {256: pages.shape[2], 257: pages.shape[1], 258: 8, 259: 1, 262: 1, 277: 1, 278: pages.shape[1]}
    size = 2 + 12 * (len(tags) + 2) + 4
    first = 8 + pages.size
    data = struct.pack("<2sHI", b"II", 42, first) + pages.tobytes()
    for number, page in enumerate(pages):
        entries = dict(sorted({**tags, 273: 8 + number * page.size, 279: page.size}.items()))
        data += struct.pack("<H", len(entries))
        data += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries.items())
        data += struct.pack("<I", first + (number + 1) * size if number + 1 < len(pages) else 0)
    return data


TIFF = pack_tiff(np.transpose(labels()))
FORMATS = {Path(name).suffix for name in exchange_files()}
"""Extensions of these files."""
