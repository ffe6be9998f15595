"""Points that cover a surface at a given spacing."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry.surface import Surface
from fsh3d_o3d.geometry.triangles import triangle_areas

_MOST_POINTS = 4_000_000  # 96 MB of them, a choice


def surface_points(surface: Surface, spacing: float) -> Float64Array:
    """Return points (n, 3) on every triangle of a surface, neighbours no farther apart than ``spacing``.

    Triangles are cut along their longest edge and across it, so that a needle costs its length only. Surfaces that
    would need more than four million points (thousands of large triangles over each other) get a wider spacing. A
    cloud is its own points.
    """
    if surface.triangles is None:
        return surface.vertices
    corners = surface.vertices[surface.triangles]
    edge = corners[:, (1, 2, 0)] - corners
    square = np.einsum("ijk,ijk->ij", edge, edge)
    large = square.max(axis=1) > spacing**2
    middles = corners[~large].sum(axis=1) / 3
    return np.concatenate((middles, _subdivided(corners[large], np.sqrt(square[large]), spacing)))


def _subdivided(corners: Float64Array, edge: Float64Array, spacing: float) -> Float64Array:
    """Points on triangles (t, 3, 3) whose edges are longer than the spacing."""
    # The longest edge runs from the first corner to the second, the third is the apex.
    turn = (edge.argmax(axis=1)[:, None] + np.arange(3)) % 3
    first, second, apex = np.take_along_axis(corners, turn[:, :, None], axis=1).transpose(1, 0, 2)
    base = edge.max(axis=1)
    height = 2 * triangle_areas(np.stack((first, second, apex), axis=1)) / base
    while True:
        across, up = (np.maximum(np.ceil(length / spacing), 1) for length in (base, height))
        if (across * up).sum() <= max(_MOST_POINTS, len(base)):
            break
        spacing *= np.sqrt(2)
    count = (across * up).astype(np.int64)
    owner = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(number, across[owner].astype(np.int64))
    u = ((column + 0.5) / across[owner])[:, None]
    v = ((row + 0.5) / up[owner])[:, None]
    return np.asarray((1 - v) * ((1 - u) * first[owner] + u * second[owner]) + v * apex[owner])
