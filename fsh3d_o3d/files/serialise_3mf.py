"""3MF: one object, built once where it stands."""

from __future__ import annotations

import io
import zipfile

from fsh3d_o3d.files.serialise import Content, format_rows

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_DATE = (1980, 1, 1, 0, 0, 0)  # the first that ZIP knows: the same surface gives the same bytes on every day
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'


def threemf_bytes(surface: Content) -> bytes:
    """3MF in millimetres: coordinates with the digits that float64 needs; no normals, no colours."""
    assert surface.triangles is not None
    vertices = format_rows('<vertex x="%r" y="%r" z="%r"/>\n', surface.points)
    triangles = format_rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', surface.triangles)
    model = (
        f'{_HEAD}<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">\n<resources>\n'
        f'<object id="1" type="model">\n<mesh>\n<vertices>\n{vertices}</vertices>\n'
        f"<triangles>\n{triangles}</triangles>\n</mesh>\n</object>\n"
        '</resources>\n<build>\n<item objectid="1"/>\n</build>\n</model>\n'
    )
    types = (
        f'{_HEAD}<Types xmlns="{_PACKAGE}/content-types">\n'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>\n'
        '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>\n</Types>\n'
    )
    relations = (
        f'{_HEAD}<Relationships xmlns="{_PACKAGE}/relationships">\n<Relationship Target="/3D/3dmodel.model" Id="rel0" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>\n</Relationships>\n'
    )
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as package:
        for name, text in (("[Content_Types].xml", types), ("_rels/.rels", relations), ("3D/3dmodel.model", model)):
            part = zipfile.ZipInfo(name, _DATE)
            part.compress_type = zipfile.ZIP_DEFLATED
            package.writestr(part, text.encode("ascii"))
    return result.getvalue()
