"""Small valid files of the formats in which CAD, printing, surveying and medicine exchange shapes."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.files.mutations import TRIANGLES, VERTICES

TURNED = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # a quarter about z


@dataclass(frozen=True)
class Exchange:
    """A file that holds the octahedron of ``mutations``, or its vertices as a cloud."""

    name: str
    """File name with extension, different for each."""
    data: bytes
    """Content."""
    shape: str = "octahedron"
    """Or "cloud"."""
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


FORMATS = {Path(name).suffix for name in exchange_files()}
"""Extensions of these files."""
