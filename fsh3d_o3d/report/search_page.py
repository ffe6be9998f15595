"""One HTML file that shows what a query of a library found; works offline."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays, UnitCube, transformed
from fsh3d_o3d.index import Hit
from fsh3d_o3d.report.colors import ORIGINAL_COLOR, RECONSTRUCTION_COLOR, css_color
from fsh3d_o3d.report.display import Displayed, displayed, geometry_json
from fsh3d_o3d.report.html import write_page
from fsh3d_o3d.report.thumbnail import encode_png, render_thumbnail
from fsh3d_o3d.report.view import camera_eye, positions

__all__ = ["SearchResult", "write_search_page"]

_SIDE = 220  # pixels of a picture
_MOST_ELEMENTS = 8_000  # triangles or points of one shape: a page holds dozens


@value
class SearchResult:
    """A query and what it found."""

    title: str
    """The query's name; any text."""
    geometry: MeshArrays | PointArrays
    """The query."""
    hits: Sequence[Hit]
    """Best first, as ``ShapeIndex.query`` gives them."""


@dataclass(frozen=True, eq=False)
class _Shape:
    """A hit laid over its query, or only its picture where the file is gone."""

    hit: Hit
    picture: bytes
    note: str
    displayed: Displayed | None


def write_search_page(path: str | os.PathLike[str], results: Sequence[SearchResult]) -> None:
    """Write a page with queries, and under each its hits: turned as the query lies, with bars for their distances.

    A click on a hit lays it over the query in 3D. Files of hits are read anew for that; where one cannot be read, the
    picture is the one that the index keeps. The page holds everything it needs and asks the network for nothing. A
    policy in it lets only its own scripts run.

    Args:
        path: The HTML file; replaced as a whole or not at all.
        results: One or more.

    Raises:
        ValueError: No results.
        OSError: The file cannot be written.
    """
    if not results:
        raise ValueError("a page needs at least one result")
    shown, data = [], []
    for result in results:
        cube = UnitCube.around(positions(result.geometry))
        query = displayed(result.geometry, cube, _MOST_ELEMENTS)
        shapes = [_shape(hit, cube) for hit in result.hits]
        shown.append((result.title, _picture(result.geometry, ORIGINAL_COLOR), shapes))
        data.append(_overlays(query, shapes))
    colors = [css_color(ORIGINAL_COLOR), css_color(RECONSTRUCTION_COLOR)]
    write_page(
        path,
        "search.html",
        data={"results": data, "eye": camera_eye(math.sqrt(3) / 2), "colors": colors},
        title=results[0].title if len(results) == 1 else f"{len(results)} queries",
        results=shown,
    )


def _shape(hit: Hit, cube: UnitCube) -> _Shape:
    try:
        aligned = transformed(read_geometry_arrays(hit.path), hit.transformation)
        picture = _picture(aligned, RECONSTRUCTION_COLOR)
        shape = displayed(aligned, cube, _MOST_ELEMENTS)
    except (GeometryError, OSError) as error:
        reason = "not there any more" if isinstance(error, FileNotFoundError) else "cannot be read now"
        return _Shape(hit, hit.thumbnail, f"The file is {reason}: picture as indexed.", None)
    return _Shape(hit, picture, "" if shape.shown == shape.total else f"In 3D {shape.note()}.", shape)


def _picture(geometry: MeshArrays | PointArrays, color: Any) -> bytes:
    return encode_png(render_thumbnail(geometry, width=_SIDE, height=_SIDE, color=color, background=None))


def _overlays(query: Displayed, shapes: Sequence[_Shape]) -> dict[str, Any]:
    own = float(np.abs(query.points).max())
    hits = [
        None
        if shape.displayed is None
        else {
            "geometry": geometry_json(shape.displayed, None),
            "reach": max(own, float(np.abs(shape.displayed.points).max())),
        }
        for shape in shapes
    ]
    return {"query": geometry_json(query, None), "hits": hits}
