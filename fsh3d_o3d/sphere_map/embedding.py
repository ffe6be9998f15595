"""A map of any closed genus-0 triangulation onto the sphere, valid by construction, from coarse to fine.

After the progressive embedding of Praun and Hoppe (2003) and the hierarchical one of Hu, Fu and Liu (2018): a
tetrahedron is easy to embed, and a vertex that comes back finds its star open. Its star is the fan from the neighbour
that it was collapsed onto, so near that neighbour lies a point that sees the whole rim: the kernel of the star
polygon is never empty. On the sphere that kernel is an intersection of half-spaces, {p : n_j · p > 0} with a normal for
each edge of the rim, and the point in it that is farthest from all edges is found in closed form.

Left to itself that halves triangles over and over, until float64 ends; so every level is relaxed before the next.
Relaxing balances areas as well: what is far apart on the mesh is near on a coarse level, so the map comes out balanced
at the cost of a few passes over it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import triangle_normals
from fsh3d_o3d.sphere_map import relaxation as _relaxation
from fsh3d_o3d.sphere_map.hierarchy import Stars, build_hierarchy
from fsh3d_o3d.sphere_map.validity import orientations

Relax = Callable[[Float64Array, IntArray, Float64Array], Float64Array]
"""(vertices (k, 3), triangles (t, 3), sphere (k, 3)) of a level → a better sphere, as valid as the given one."""

_CHUNK = 2**22  # numbers in the largest temporary of a placement, 32 MB; a choice


class EmbeddingError(ArithmeticError):
    """Float64 has no room left between a vertex and the edges around it, or a relaxation broke the embedding."""


def embed(vertices: Float64Array, triangles: IntArray, *, relax: Relax | None = None) -> Float64Array:
    """Map a closed genus-0 mesh onto the unit sphere with every triangle positively oriented.

    The result is deterministic, and turned so that it follows the pose of the mesh.

    Args:
        vertices: (n, 3) float64 positions.
        triangles: (2n − 4, 3) int64, closed, manifold, of one component and genus 0, oriented outwards, using every
            vertex.
        relax: Improves the embedding of each level, coarsest first, and must keep it valid; by default a few
            steps that balance areas against angles.

    Returns:
        (n, 3) unit vectors with det[a, b − a, c − a] > 0 for every triangle, covering the sphere once.

    Raises:
        EmbeddingError: A triangle has become too small for float64, or ``relax`` turned one over.
    """
    relax = _relaxation.relax if relax is None else relax
    hierarchy = build_hierarchy(vertices, triangles)
    ordered = vertices[hierarchy.order]
    sphere = _tetrahedron(hierarchy.levels[0].triangles)
    for level in hierarchy.levels:
        sphere = np.concatenate((sphere, np.empty((level.count - len(sphere), 3))))
        for stars in level.stars:
            sphere[stars.vertices] = place(stars, sphere)
        _check(level.triangles, sphere, "inserting vertices")
        sphere = relax(ordered[: level.count], level.triangles, sphere)
        _check(level.triangles, sphere, "relaxing")
    result = np.empty_like(sphere)
    result[hierarchy.order] = sphere
    return _aligned(result, vertices)


def place(stars: Stars, sphere: Float64Array) -> Float64Array:
    """Return for each star the point (m, 3) that lies deepest in the kernel of its rim on the sphere.

    The deepest point of a cone {p : n_j · p > 0} with unit normals is the direction of the point of their convex hull
    nearest to 0, which two or three of them determine: all pairs and triples are tried.
    """
    d = stars.rings.shape[1]
    pairs, triples = _subsets(d)
    size = max(1, _CHUNK // (d * (len(pairs) + len(triples))))
    points = np.empty((len(stars.vertices), 3))
    for start in range(0, len(points), size):
        ring = sphere[stars.rings[start : start + size]]
        normals = np.cross(ring, np.roll(ring, -1, axis=1) - ring)
        normals /= np.sqrt(np.einsum("mdx,mdx->md", normals, normals))[..., None] + 1e-300
        # The point equally far from three planes, on the side of its own normals; of two, their bisector.
        apex = triangle_normals(normals[:, triples])
        apex *= np.sign(np.einsum("mkx,mkx->mk", apex, normals[:, triples[:, 0]]))[..., None]
        candidates = np.concatenate((normals[:, pairs[:, 0]] + normals[:, pairs[:, 1]], apex), axis=1)
        candidates /= np.sqrt(np.einsum("mkx,mkx->mk", candidates, candidates))[..., None] + 1e-300
        depth = np.matmul(candidates, normals.transpose(0, 2, 1)).min(axis=2)
        deepest = depth.argmax(axis=1)
        points[start : start + size] = candidates[np.arange(len(ring)), deepest]
    return points


def _check(triangles: IntArray, sphere: Float64Array, action: str) -> None:
    det = orientations(sphere, triangles)
    if not (det > 0).all():
        count = int(np.count_nonzero(~(det > 0)))
        raise EmbeddingError(
            f"{action} turned over {count} of the {len(triangles)} triangles of a level, "
            f"the worst determinant being {det.min():.3g}"
        )


def _tetrahedron(triangles: IntArray) -> Float64Array:
    """Return the regular tetrahedron (4, 3) with the given triangles facing outwards."""
    corners = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) / np.sqrt(3)
    return np.asarray(corners if orientations(corners, triangles[:1])[0] > 0 else corners[[0, 1, 3, 2]])


@lru_cache
def _subsets(d: int) -> tuple[IntArray, IntArray]:
    """Return the pairs (k, 2) and triples (l, 3) of 0 … d − 1."""
    pairs = np.array(list(combinations(range(d), 2)), dtype=np.int64)
    return pairs, np.array(list(combinations(range(d), 3)), dtype=np.int64)


def _aligned(sphere: Float64Array, vertices: Float64Array) -> Float64Array:
    """Return the embedding rotated so that its points lie, on the whole, in the directions of the mesh's vertices."""
    centred = vertices - vertices.mean(axis=0)
    u, _, v = np.linalg.svd(sphere.T @ centred / (np.abs(centred).max() + 1e-300))
    rotation = u * (1.0, 1.0, np.sign(np.linalg.det(u @ v))) @ v
    turned = sphere @ rotation
    return np.asarray(turned / np.sqrt(np.einsum("ix,ix->i", turned, turned))[:, None])
