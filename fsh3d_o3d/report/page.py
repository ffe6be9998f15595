"""One HTML file that shows an original, its reconstruction and how far they are apart; works offline."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, real_array
from fsh3d_o3d.geometry import MeshArrays, PointArrays, geometry_arrays
from fsh3d_o3d.report.colors import ORIGINAL_COLOR, RECONSTRUCTION_COLOR, color_stops, css_color, error_colors
from fsh3d_o3d.report.display import Displayed, common_cube, displayed, geometry_json, packed, shaded_points
from fsh3d_o3d.report.figures import FigureValue, figure_rows
from fsh3d_o3d.report.html import write_page
from fsh3d_o3d.report.thumbnail import encode_png, render_thumbnail, side_by_side
from fsh3d_o3d.report.view import TOWARDS_VIEWER, camera_eye, xyz

__all__ = ["reconstruction_picture", "write_reconstruction_page"]

_SIDE = 400  # pixels, beside each other in a row of three
_QUANTILE = 0.99  # of the errors, where the colour scale ends, so that one spike does not hide everything else


def write_reconstruction_page(
    path: str | os.PathLike[str],
    *,
    title: str,
    original: Any,
    reconstruction: Any,
    errors: Any,
    energies: Any,
    figures: Mapping[str, FigureValue],
    options: Mapping[str, FigureValue] | None = None,
) -> None:
    """Write a page with both shapes as interactive 3D, the error on the surface, energies and figures.

    The file holds everything it needs, plotly's script among it, and asks the network for nothing. A policy in it lets
    only its own scripts run. Large meshes and clouds are shown with fewer triangles or points, and the page says so;
    figures are shown as given. The same input gives the same bytes.

    Args:
        path: The HTML file; replaced as a whole or not at all.
        title: Any text, such as the name of the file.
        original: Mesh or point cloud, as ``from_any`` takes it.
        reconstruction: Triangle mesh.
        errors: (v,) distance of each vertex of the reconstruction to the original, >= 0, in the units of the geometry.
        energies: (b,) energy of each degree (``degree_energies``), >= 0.
        figures: What the measurement found. ``rmse``, ``mae``, ``max`` (parts of the bounding-box diagonal) and
            ``volume_error`` (a part of the volume) are written in percent; ``method``, ``bandwidth``, ``diagonal``,
            ``closed`` and ``genus`` are explained too; others stay as they are.
        options: How it was done, shown in a table of its own.

    Raises:
        TypeError: An argument of another kind.
        ValueError: Arrays of the wrong shape or range.
        GeometryError: A geometry that is empty or has no extent.
        OSError: The file cannot be written.
    """
    if not isinstance(title, str):
        raise TypeError(f"title must be text, got {type(title).__name__}")
    first, second, distances = _checked(original, reconstruction, errors)
    spectrum = real_array(energies, "energies")
    if spectrum.ndim != 1 or len(spectrum) == 0 or spectrum.min() < 0:
        raise ValueError(f"energies must have shape (b,) with b >= 1 and be >= 0, got {spectrum.shape}")
    relative = distances / (first.diagonal or 1.0)
    top = _scale_end(relative)
    cube, reach = common_cube(first, second)
    shapes = {"original": displayed(first, cube), "reconstruction": displayed(second, cube)}
    tables = {"Figures": figure_rows(figures), "Method and options": figure_rows(options or {})}
    power = np.cumsum(np.square(spectrum / (spectrum.max() or 1.0)))
    write_page(
        path,
        "reconstruction.html",
        data=_page_data(first, second, shapes, relative, top, spectrum, reach),
        title=title,
        shapes=shapes,
        pictures=[encode_png(image) for image in _pictures(first, second, relative, top, background=None, size=_SIDE)],
        ramp=color_stops(),
        scale_end=top,
        largest_error=float(relative.max()),
        tables={caption: rows for caption, rows in tables.items() if rows},
        degrees=len(spectrum),
        enough=np.searchsorted(power, (1 - 1e-6) * power[-1]),
    )


def reconstruction_picture(original: Any, reconstruction: Any, errors: Any, *, size: int = 480) -> NDArray[np.uint8]:
    """Return original, reconstruction and error map side by side with captions, (h, w, 3) uint8.

    All three have the same direction and scale. Arguments as for :func:`write_reconstruction_page`; ``size`` is the
    side of each picture in pixels.
    """
    first, second, distances = _checked(original, reconstruction, errors)
    relative = distances / (first.diagonal or 1.0)
    top = _scale_end(relative)
    images = _pictures(first, second, relative, top, background=(1.0, 1.0, 1.0), size=size)
    scale = f"error, dark = {100 * top:.2g} % of diagonal"
    return side_by_side(images, ["original", "reconstruction", scale])


def _checked(
    original: Any, reconstruction: Any, errors: Any
) -> tuple[MeshArrays | PointArrays, MeshArrays, Float64Array]:
    first, second = geometry_arrays(original)[0], geometry_arrays(reconstruction)[0]
    if not isinstance(second, MeshArrays):
        raise TypeError("reconstruction must be a triangle mesh, got a point cloud")
    distances = real_array(errors, "errors").astype(np.float64)
    if distances.shape != (len(second.vertices),):
        raise ValueError(
            f"errors must have shape (v,) = ({len(second.vertices)},), one for each vertex of the reconstruction, "
            f"got {distances.shape}"
        )
    if distances.min() < 0:
        raise ValueError(f"errors must be distances >= 0, but the least is {distances.min():g}")
    return first, second, distances


def _scale_end(relative: Float64Array) -> float:
    """Return the error at the dark end of the colour scale, > 0."""
    return float(np.quantile(relative, _QUANTILE)) or float(relative.max()) or 1e-12


def _pictures(
    original: MeshArrays | PointArrays,
    reconstruction: MeshArrays,
    relative: Float64Array,
    top: float,
    *,
    background: Any,
    size: int,
) -> list[NDArray[np.uint8]]:
    look: dict[str, Any] = {"width": size, "height": size, "background": background}
    return [
        render_thumbnail(original, color=ORIGINAL_COLOR, **look),
        render_thumbnail(reconstruction, color=RECONSTRUCTION_COLOR, around=original, **look),
        render_thumbnail(reconstruction, colors=error_colors(relative, top), around=original, **look),
    ]


def _page_data(
    original: MeshArrays | PointArrays,
    reconstruction: MeshArrays,
    shapes: Mapping[str, Displayed],
    relative: Float64Array,
    top: float,
    energies: Float64Array | Any,
    reach: float,
) -> dict[str, Any]:
    first, second = shapes["original"], shapes["reconstruction"]
    # A light is placed in the units of the data: above the viewer's left shoulder, far away.
    left = np.cross(TOWARDS_VIEWER, (0.0, 0.0, 1.0))
    light = 1e3 * (0.6 * TOWARDS_VIEWER + 0.7 * left / np.linalg.norm(left) + (0.0, 0.0, 0.7))
    if isinstance(original, PointArrays):
        colors: Float64Array | None = shaded_points(first, original, ORIGINAL_COLOR, light)
    else:
        colors = None if original.colors is None else original.colors[first.source]
    again = None if reconstruction.colors is None else reconstruction.colors[second.source]
    # The bounding sphere fits the field of view. Plotly measures in sides of the cube that holds both shapes.
    radius = max(float(np.linalg.norm(shape.points, axis=1).max()) for shape in shapes.values())
    common = {"light": xyz(light)}
    size = float(np.clip(240 / math.sqrt(len(first.points)), 1.2, 5))
    return {
        "reach": reach,
        "eye": camera_eye(radius / (2 * reach)),
        "geometries": {
            "original": geometry_json(first, colors),
            "reconstruction": geometry_json(second, again),
        },
        "views": [
            {"id": "plot-original", "geometry": "original", "color": css_color(ORIGINAL_COLOR), "size": size} | common,
            {"id": "plot-reconstruction", "geometry": "reconstruction", "color": css_color(RECONSTRUCTION_COLOR)}
            | common,
            {"id": "plot-error", "geometry": "reconstruction", "errors": True} | common,
        ],
        "errors": {
            "percent": packed(100 * relative[second.source], "f4"),
            "maximum": 100 * top,
            "colorscale": color_stops(),
        },
        "energies": _energy_json(energies),
    }


def _energy_json(energies: Float64Array | Any) -> dict[str, Any]:
    positive = energies[energies > 0]
    decades = math.log10(positive.max()) - math.log10(positive.min()) if positive.size else 1
    values = [value if value > 0 else None for value in energies.astype(np.float64).tolist()]
    return {"values": values, "dtick": max(1, math.ceil(decades / 6))}
