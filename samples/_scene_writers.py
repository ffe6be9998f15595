"""Writers of scenes and packages: 3MF, COLLADA, X3D, FBX as text. The same polygons give the same bytes everywhere."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _writers import Array, IndexArray, rounded

Polygons = Sequence[Sequence[int]]
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"
_QUARTER = "0 1 0 -1 0 0 0 0 1"  # the rows of a turn by 90 degrees about z, as 3MF writes them


def words(values: Array | IndexArray) -> str:
    """Numbers with blanks between them."""
    return " ".join(map(repr, values.ravel().tolist()))


def threemf_bytes(points: Array, triangles: IndexArray) -> bytes:
    """3MF: the surface lies turned and moved in a component, which its place in the build turns and moves back."""
    x, y, z = (rounded(points) - [1.0, 2.0, 3.0]).T
    inside = rounded(np.stack([y, -x, z], axis=1))  # what a turn by 90 degrees about z brings back
    vertices = "".join(f'<vertex x="{a!r}" y="{b!r}" z="{c!r}"/>\n' for a, b, c in inside.tolist())
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in triangles.tolist())
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xmlns="{_CORE}">\n<resources>\n'
        f'<object id="1" type="model" name="part"><mesh>\n<vertices>\n{vertices}</vertices>\n<triangles>\n{faces}'
        '</triangles>\n</mesh></object>\n<object id="2" type="model" name="assembly"><components>'
        f'<component objectid="1" transform="{_QUARTER} 1 0 0"/></components></object>\n</resources>\n'
        '<build><item objectid="2" transform="1 0 0 0 1 0 0 0 1 0 2 3"/></build>\n</model>\n'
    )
    relations = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="{_RELATIONS}"><Relationship Id="r1" '
        'Target="/3D/model.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
        "</Relationships>\n"
    )
    types = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" '
        'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
    )
    return zip_bytes({"[Content_Types].xml": types, "_rels/.rels": relations, "3D/model.model": model})


def zip_bytes(parts: dict[str, str | bytes]) -> bytes:
    """A ZIP file of the first day that it knows, stored: other versions of zlib pack to other bytes."""
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as file:
        for name, content in parts.items():
            file.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content)
    return result.getvalue()


def dae_bytes(points: Array, polygons: Polygons) -> bytes:
    """COLLADA: polygons in a node that is moved and turned, within one that is not."""
    moved = rounded(rounded(points) - [1.0, 2.0, 3.0])
    x, y, z = moved.T
    inside = rounded(np.stack([y, -x, z], axis=1))
    corners = words(np.array([corner for polygon in polygons for corner in polygon]))
    counts = words(np.array([len(polygon) for polygon in polygons]))
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1">\n<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>\n<library_geometries>'
        '<geometry id="part" name="part"><mesh>\n<source id="places"><float_array id="numbers" '
        f'count="{inside.size}">{words(inside)}</float_array></source>\n<vertices id="corners"><input '
        f'semantic="POSITION" source="#places"/></vertices>\n<polylist count="{len(polygons)}"><input '
        f'semantic="VERTEX" source="#corners" offset="0"/><vcount>{counts}</vcount>\n<p>{corners}</p></polylist>\n'
        '</mesh></geometry></library_geometries>\n<library_visual_scenes><visual_scene id="scene"><node><node>'
        "<translate>1 2 3</translate><rotate>0 0 1 90</rotate>"
        '<instance_geometry url="#part"/></node></node></visual_scene></library_visual_scenes>\n'
        '<scene><instance_visual_scene url="#scene"/></scene>\n</COLLADA>\n'
    ).encode("ascii")


def x3d_bytes(points: Array, polygons: Polygons) -> bytes:
    """X3D: an indexed face set, moved, turned by a third about the diagonal, twice as large inside."""
    x, y, z = ((rounded(points) - [1.0, 2.0, 3.0]) / 2.0).T
    inside = rounded(np.stack([y, z, x], axis=1), 7)
    corners = " ".join(" ".join([*map(str, polygon), "-1"]) for polygon in polygons)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 3.3//EN" '
        '"http://www.web3d.org/specifications/x3d-3.3.dtd">\n<X3D profile="Interchange" version="3.3"><Scene>\n'
        f'<Transform translation="1 2 3" rotation="1 1 1 {2 * np.pi / 3!r}" scale="2 2 2"><Shape DEF="part">'
        f'<IndexedFaceSet coordIndex="{corners}"><Coordinate point="{words(inside)}"/></IndexedFaceSet></Shape>'
        "</Transform>\n</Scene></X3D>\n"
    ).encode("ascii")


def fbx_bytes(points: Array, polygons: Polygons) -> bytes:
    """FBX 7.4 as text: polygons below a model that is moved and turned."""
    x, y, z = (rounded(points) - [1.0, 2.0, 3.0]).T
    inside = rounded(np.stack([y, -x, z], axis=1))
    corners = ",".join(
        str(corner if place < len(polygon) - 1 else -corner - 1)
        for polygon in polygons
        for place, corner in enumerate(polygon)
    )
    count = sum(map(len, polygons))
    return (
        "; FBX 7.4.0 project file\nFBXHeaderExtension:  {\n\tFBXVersion: 7400\n}\nGlobalSettings:  {\n\tVersion: 1000\n"
        '\tProperties70:  {\n\t\tP: "UpAxis", "int", "Integer", "",2\n'
        '\t\tP: "UnitScaleFactor", "double", "Number", "",1\n\t}\n}\nObjects:  {\n'
        f'\tGeometry: 10, "Geometry::part", "Mesh" {{\n\t\tVertices: *{inside.size} {{\n'
        f"\t\t\ta: {words(inside).replace(' ', ',')}\n\t\t}}\n\t\tPolygonVertexIndex: *{count} {{\n\t\t\ta: {corners}\n"
        '\t\t}\n\t\tGeometryVersion: 124\n\t}\n\tModel: 20, "Model::part", "Mesh" {\n\t\tVersion: 232\n'
        '\t\tProperties70:  {\n\t\t\tP: "Lcl Translation", "Lcl Translation", "", "A",1,2,3\n'
        '\t\t\tP: "Lcl Rotation", "Lcl Rotation", "", "A",0,0,90\n\t\t}\n\t}\n}\nConnections:  {\n'
        '\tC: "OO",20,0\n\tC: "OO",10,20\n}\n'
    ).encode("ascii")


def write_3mf(path: Path, points: Array, triangles: IndexArray) -> None:
    """3MF with a component."""
    path.write_bytes(threemf_bytes(points, triangles))


def write_dae(path: Path, points: Array, polygons: Polygons) -> None:
    """COLLADA with nodes."""
    path.write_bytes(dae_bytes(points, polygons))


def write_x3d(path: Path, points: Array, polygons: Polygons) -> None:
    """X3D with a transform."""
    path.write_bytes(x3d_bytes(points, polygons))


def write_fbx(path: Path, points: Array, polygons: Polygons) -> None:
    """FBX as text."""
    path.write_bytes(fbx_bytes(points, polygons))
