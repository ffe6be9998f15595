"""Snapping: vertices of a closed surface move onto the surface it stands for, and its triangles are evened out."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import BoolArray, UnitScene, closest_points, longest_edges, triangle_normals

_STEPS = 3  # of smoothing and drawing, a choice
_SMOOTHING = 0.5  # of the way to the mean of the neighbours in each step, a choice
_LEAST_COSINE = 0.2  # between normals before and after a step, a choice: a triangle turns by 78° at most
_LEAST_HEIGHT = 2e-3  # over the longest edge of a triangle, a choice: below, it counts as flattened
_OUTWARD = 0.4  # cells, a choice: from where the closer face of a wall is looked for
_FARTHEST_DRAWN = 1.6  # cells, a choice: vertices farther from the surface than this are not drawn to it


def fit(
    vertices: Float64Array, triangles: IntArray, scene: UnitScene, held: BoolArray, lift: Float64Array
) -> Float64Array:
    """Return vertices (v, 3) moved onto the surface of a scene, in units of the grid they come from.

    The surface stays what it is, topologically; no triangle is turned over or flattened by a step, or it is not taken.

    Args:
        vertices: (v, 3) of a closed manifold surface, wound outward, about a cell from the surface.
        triangles: (t, 3).
        scene: The surface.
        held: (v,) vertices that belong to no surface, such as membranes: evened out only.
        lift: (v,) distance from the surface to stop at, outward.
    """
    current = vertices
    for step in range(_STEPS):
        normal = _vertex_normals(current, triangles)
        pull = _SMOOTHING * (_neighbor_means(current, triangles) - current)
        smooth = current + pull
        along = pull - np.einsum("ij,ij->i", pull, normal)[:, None] * normal
        free = np.flatnonzero(~held)
        start = (current + along)[free]
        # First seen from farther out: of a wall's two faces the one on this side is then the closer one.
        outward = _OUTWARD if step == 0 else 0.0
        target = closest_points(scene, start + outward * normal[free])
        near = np.linalg.norm(target - start, axis=1) <= _FARTHEST_DRAWN
        drawn = smooth.copy()
        drawn[free[near]] = (target + lift[free, None] * normal[free])[near]
        current = _first_valid((drawn, smooth, current), triangles)
    return current


def _first_valid(choices: tuple[Float64Array, ...], triangles: IntArray) -> Float64Array:
    """Return the first choice of place for each vertex, or a later one where a triangle would turn over or flatten.

    The last choice is where the vertices were; triangles are compared with that.
    """
    before = choices[-1]
    normal, quality = _shape(before, triangles)
    result = choices[0].copy()
    taken = np.zeros(len(result), dtype=np.int64)
    suspects = np.arange(len(triangles))
    while True:
        turned, height = _shape(result, triangles[suspects])
        cosine = np.einsum("ij,ij->i", turned, normal[suspects])
        bad = (cosine < _LEAST_COSINE) | (height < np.minimum(_LEAST_HEIGHT, quality[suspects]))
        back = np.unique(triangles[suspects[bad]])
        back = back[taken[back] < len(choices) - 1]
        if back.size == 0:
            return result
        taken[back] += 1
        for number, choice in enumerate(choices):
            which = back[taken[back] == number]
            result[which] = choice[which]
        touched = np.zeros(len(result), dtype=np.bool_)
        touched[back] = True
        suspects = np.flatnonzero(touched[triangles].any(axis=1))


def _shape(vertices: Float64Array, triangles: IntArray) -> tuple[Float64Array, Float64Array]:
    """Unit normals (t, 3) and height over longest edge (t,)."""
    corners = vertices[triangles]
    normal = triangle_normals(corners)
    area = np.linalg.norm(normal, axis=1)
    return normal / np.maximum(area, 1e-300)[:, None], area / np.maximum(longest_edges(corners), 1e-300)


def _vertex_normals(vertices: Float64Array, triangles: IntArray) -> Float64Array:
    face = triangle_normals(vertices[triangles])
    total = _scattered(np.repeat(face, 3, axis=0), triangles.ravel(), len(vertices))
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])


def _neighbor_means(vertices: Float64Array, triangles: IntArray) -> Float64Array:
    # In a closed surface every neighbour is met twice, once in each triangle of the edge.
    following = vertices[triangles[:, (1, 2, 0)].ravel()]
    total = _scattered(following, triangles.ravel(), len(vertices))
    return np.asarray(total / np.bincount(triangles.ravel(), minlength=len(vertices))[:, None])


def _scattered(values: Float64Array, index: IntArray, count: int) -> Float64Array:
    return np.stack([np.bincount(index, values[:, k], count) for k in range(3)], axis=1)
