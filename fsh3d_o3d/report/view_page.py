"""One HTML file that shows a mesh or a cloud to be turned; works offline."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from fsh3d_o3d.geometry import MeshArrays, UnitCube, from_any
from fsh3d_o3d.report.colors import ORIGINAL_COLOR, css_color
from fsh3d_o3d.report.display import displayed, geometry_json, shaded_points
from fsh3d_o3d.report.html import write_page
from fsh3d_o3d.report.images import encode_png
from fsh3d_o3d.report.thumbnail import render_thumbnail
from fsh3d_o3d.report.view import TOWARDS_VIEWER, camera_eye, positions, xyz

__all__ = ["write_view_page"]

_SIDE = 640  # pixels of the still picture
_FLAT_BELOW = 3000  # triangles, a choice: of so few the facets are the shape; more are meant to be smooth


def write_view_page(path: str | os.PathLike[str], geometry: Any, *, title: str) -> None:
    """Write a page with a mesh or a cloud as interactive 3D in its own colours.

    The file holds everything it needs and asks the network for nothing; a policy in it lets only its own scripts run.
    What is large is shown with fewer triangles or points, and the page says so.

    Args:
        path: The HTML file; replaced as a whole or not at all.
        geometry: Mesh or point cloud, as ``from_any`` takes it.
        title: Any text, such as the name of the file.

    Raises:
        TypeError: Not a geometry, or no text.
        GeometryError: An empty geometry, or one without extent.
        OSError: The file cannot be written.
    """
    if not isinstance(title, str):
        raise TypeError(f"title must be text, got {type(title).__name__}")
    arrays = from_any(geometry)
    cube = UnitCube.around(positions(arrays))
    shape = displayed(arrays, cube)
    light = 1e3 * (TOWARDS_VIEWER + np.array([0.0, 0.0, 0.5]))
    if isinstance(arrays, MeshArrays):
        colors = None if arrays.colors is None else arrays.colors[shape.source]
        facts = [f"{len(arrays.vertices):,} vertices, {len(arrays.triangles):,} triangles"]
    else:
        colors = shaded_points(shape, arrays, ORIGINAL_COLOR, light)
        facts = [f"{len(arrays.points):,} points"]
    facts.append(f"{arrays.diagonal:.6g} across")
    own = {"normals": arrays.normals, "colours": arrays.colors, **arrays.attributes}
    named = [name for name, array in own.items() if array is not None]
    if named:
        facts.append(f"with {', '.join(named)}")
    if shape.shown != shape.total:
        facts.append(shape.note())
    radius = float(np.linalg.norm(shape.points, axis=1).max())
    reach = float(np.abs(shape.points).max())
    write_page(
        path,
        "view.html",
        data={
            "reach": reach,
            "eye": camera_eye(radius / (2 * reach)),
            "geometry": geometry_json(shape, colors),
            "color": css_color(ORIGINAL_COLOR),
            "size": float(np.clip(240 / math.sqrt(len(shape.points)), 1.2, 5)),
            "light": xyz(light),
            "flat": shape.triangles is not None and shape.shown < _FLAT_BELOW,
        },
        title=title,
        facts="; ".join(facts),
        picture=encode_png(render_thumbnail(arrays, width=_SIDE, height=_SIDE, background=None)),
    )
