"""Triangulations the samples are made of: spheres, sweeps and level sets, all closed by construction."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from _writers import Array, IndexArray

Field = Callable[[Array], Array]
"""A function of points (n, 3) with values (n,)."""


class Mesh(NamedTuple):
    """An indexed triangle mesh, triangles anticlockwise seen from outside."""

    points: Array
    """Vertices (v, 3)."""
    triangles: IndexArray
    """Vertex indices (t, 3)."""


def unit(vectors: Array) -> Array:
    """Vectors (…, 3) over their lengths."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rotation(axis: tuple[float, float, float], degrees: float) -> Array:
    """Rotation matrix (3, 3) about `axis`, anticlockwise (Rodrigues' formula)."""
    x, y, z = unit(np.array(axis))
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def welded(corners: Array) -> tuple[Array, IndexArray]:
    """Corner positions (faces, k, 3) as points (v, 3) and faces (faces, k); what agrees to 1e-9 becomes one vertex."""
    positions = corners.reshape(-1, 3)
    _, first, inverse = np.unique(np.round(positions, 9) + 0.0, axis=0, return_index=True, return_inverse=True)
    return positions[first], inverse.reshape(corners.shape[:2])


def icosphere(frequency: int) -> Mesh:
    """Unit sphere of 20 `frequency`² triangles: every icosahedron face is cut into `frequency`² and pushed out."""
    golden = (1.0 + 5.0**0.5) / 2.0
    edge = np.array([[s, t * golden] for s in (-1, 1) for t in (-1, 1)])
    zero = np.zeros((4, 1))
    vertices = np.vstack(
        [np.hstack([zero, edge]), np.hstack([edge, zero]), np.hstack([edge[:, 1:], zero, edge[:, :1]])]
    )
    i, j, k = np.array(np.meshgrid(*[range(12)] * 3, indexing="ij")).reshape(3, -1)
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 2.1  # the icosahedron's edge is 2
    volume = np.einsum("ij,ij->i", vertices[i], np.cross(vertices[j], vertices[k]))
    face = near[i, j] & near[j, k] & near[k, i] & (i < j) & (i < k) & (volume > 0.0)  # i first: each face once
    a, b, c = vertices[i[face]], vertices[j[face]], vertices[k[face]]

    u, v = np.array([(u, v) for u in range(frequency) for v in range(frequency - u)]).T
    upright = np.stack([np.stack([u, v], 1), np.stack([u + 1, v], 1), np.stack([u, v + 1], 1)], axis=1)
    inner = u + v < frequency - 1
    turned = np.stack([np.stack([u + 1, v], 1), np.stack([u + 1, v + 1], 1), np.stack([u, v + 1], 1)], axis=1)[inner]
    uv = np.concatenate([upright, turned])[None, ..., None] / frequency
    a, b, c = a[:, None, None], b[:, None, None], c[:, None, None]
    return Mesh(*welded(unit(a + uv[..., 0, :] * (b - a) + uv[..., 1, :] * (c - a)).reshape(-1, 3, 3)))


def cube_sphere(divisions: int) -> tuple[Array, IndexArray]:
    """Unit sphere of 6 `divisions`² quads: points (v, 3) and quads (q, 4), by the equal-angle cube map."""
    i, j = np.array(np.meshgrid(range(divisions), range(divisions), indexing="ij")).reshape(2, -1)
    corners = np.stack([np.stack([i + p, j + q], axis=1) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    plane = np.tan(np.pi / 4.0 * (2.0 * corners / divisions - 1.0))
    top = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=2)
    thirds = [np.roll(top, shift, axis=2) for shift in range(3)]  # cyclic: orientation stays
    opposite = [-face[:, ::-1] for face in thirds]  # a point reflection turns the faces inside out, [::-1] turns back
    return welded(unit(np.concatenate(thirds + opposite)))


def halves(quads: IndexArray) -> IndexArray:
    """Quads (q, 4) as triangles (2 q, 3), cut along the first diagonal."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def radial(directions: Mesh, radius: Field) -> Mesh:
    """The surface r(ω) over a triangulated unit sphere: star-shaped as seen from the origin where `radius` > 0."""
    return directions._replace(points=directions.points * radius(directions.points)[:, None])


def tube_triangles(rings: int, sides: int, *, closed: bool) -> IndexArray:
    """Triangles between consecutive rings of a sweep; vertex k of ring r is r · `sides` + k.

    Rings turn anticlockwise about the direction of travel. `closed` joins the last ring with the first; otherwise
    both ends are left open.
    """
    r, k = np.array(np.meshgrid(range(rings if closed else rings - 1), range(sides), indexing="ij")).reshape(2, -1)
    following, right = (r + 1) % rings, (k + 1) % sides
    quads = [r * sides + k, r * sides + right, following * sides + right, following * sides + k]
    return halves(np.stack(quads, axis=1))


def swept(centres: Array, tangents: Array, reference: Array, radii: Array, *, closed: bool) -> Mesh:
    """A tube about the curve `centres` (n, 3) with `radii` (n, sides), closed in a ring or by a vertex at each end.

    `reference` (n, 3) is a vector field along the curve, nowhere parallel to it; angles are counted from it.
    Without `closed`, the first and last rows are the end vertices, and their radii are not used.
    """
    tangent = unit(tangents)
    normal = unit(reference - np.sum(reference * tangent, axis=1, keepdims=True) * tangent)
    binormal = np.cross(tangent, normal)
    sides = radii.shape[1]
    angle = 2.0 * np.pi * np.arange(sides) / sides
    spokes = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * binormal[:, None]
    points = centres[:, None] + radii[..., None] * spokes
    if closed:
        return Mesh(points.reshape(-1, 3), tube_triangles(len(centres), sides, closed=True))
    rings = len(centres) - 2
    k = np.arange(sides)
    first, last = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    caps = [np.stack([first, (k + 1) % sides, k], axis=1)]
    caps += [np.stack([last, (rings - 1) * sides + k, (rings - 1) * sides + (k + 1) % sides], axis=1)]
    return Mesh(
        np.vstack([points[1:-1].reshape(-1, 3), centres[[0, -1]]]),
        np.concatenate([tube_triangles(rings, sides, closed=False), *caps]),
    )


def level_set(field: Field, low: tuple[float, float, float], high: tuple[float, float, float], step: float) -> Mesh:
    """The surface `field` = 0 inside the box, oriented towards positive values, by marching tetrahedra.

    The tetrahedra are those of the body-centred cubic lattice, which are nearly regular: four around every edge that
    joins the centres of two neighbouring cells. Two sign patterns in a tetrahedron decide its triangles, so the result
    is a closed manifold wherever the surface keeps away from the box. Smoothing along the surface, with Newton steps
    back onto it, then evens out the triangles.
    """
    # An irrational share of a step keeps lattice points off planes of symmetry, where the sign of a value would hang
    # on its last bit.
    origin = np.array(low) - step / np.array([2.0**0.5, 3.0**0.5, 5.0**0.5])
    cells = np.ceil((np.array(high) - origin) / step).astype(int)
    lattice = np.stack(np.meshgrid(*[np.arange(2 * n + 1) for n in cells], indexing="ij"), axis=-1)
    shape = np.array(lattice.shape[:3])
    values = field((origin + step / 2.0 * lattice).reshape(-1, 3))

    centres = lattice[1:-1:2, 1:-1:2, 1:-1:2].reshape(-1, 3)  # odd triples; even triples are the cells' corners
    tetrahedra = []
    for axis in range(3):
        along, side, up = np.roll(np.eye(3, dtype=int), axis, axis=0)
        near = centres[centres @ along < shape @ along - 2]
        ring = [near + along + s * side + t * up for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        tetrahedra += [np.stack([near, near + 2 * along, ring[k], ring[k - 1]], axis=1) for k in range(4)]
    corners = np.ravel_multi_index(np.moveaxis(np.concatenate(tetrahedra), -1, 0), tuple(shape))

    inside = values[corners] < 0.0
    order = np.argsort(~inside, axis=1, kind="stable")  # inner corners first
    corners, count = np.take_along_axis(corners, order, axis=1), inside.sum(axis=1)
    cut = {
        1: [[(0, 1), (0, 2), (0, 3)]],
        2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
        3: [[(0, 3), (1, 3), (2, 3)]],
    }
    edges, outward = [], []
    for inner, triangles in cut.items():
        tetrahedron = corners[count == inner]
        position = lattice.reshape(-1, 3)[tetrahedron]
        direction = position[:, inner:].mean(axis=1) - position[:, :inner].mean(axis=1)
        for triangle in triangles:
            edges.append(tetrahedron[:, triangle])
            outward.append(direction)
    edge, triangles = np.unique(np.concatenate(edges).reshape(-1, 2), axis=0, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    start, end = values[edge].T
    share = np.clip(start / (start - end), 0.2, 0.8)[:, None]  # vertices near a lattice point would make slivers
    ends = origin + step / 2.0 * lattice.reshape(-1, 3)[edge]
    points = (1.0 - share) * ends[:, 0] + share * ends[:, 1]

    a, b, c = (points[triangles[:, k]] for k in range(3))
    wrong = np.einsum("ij,ij->i", np.cross(b - a, c - a), np.concatenate(outward)) < 0.0
    triangles[wrong] = triangles[wrong, ::-1]
    return Mesh(_relaxed(points, triangles, field, step), triangles)


def _relaxed(points: Array, triangles: IndexArray, field: Field, step: float) -> Array:
    """Points moved towards the mean of their neighbours and back onto the surface, ten times."""
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()  # every edge once in each direction
    degree = np.bincount(tail, minlength=len(points))
    offsets = 1e-4 * np.eye(3)
    for _ in range(10):
        mean = np.stack([np.bincount(tail, points[head, k], len(points)) for k in range(3)], axis=1) / degree[:, None]
        points = points + 0.5 * (mean - points)
        for _ in range(2):
            gradient = np.stack([(field(points + h) - field(points - h)) / 2e-4 for h in offsets], axis=1)
            newton = (field(points) / np.sum(gradient**2, axis=1))[:, None] * gradient
            length = np.linalg.norm(newton, axis=1, keepdims=True)
            points = points - newton * np.minimum(1.0, 0.5 * step / np.maximum(length, 1e-12))
    return points


def revolved(profile: Array, sides: int) -> tuple[Array, IndexArray]:
    """Quads of a surface of revolution about z: points (rings · sides, 3) and quads (q, 4).

    `profile` (rings, 2) holds radius and height from the bottom up; the outer side is the side away from the axis.
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    flat = profile[:, None, :1] * ring
    points = np.concatenate([flat, np.broadcast_to(profile[:, None, 1:], (*flat.shape[:2], 1))], axis=2).reshape(-1, 3)
    r, k = np.array(np.meshgrid(range(len(profile) - 1), range(sides), indexing="ij")).reshape(2, -1)
    right = (k + 1) % sides
    return points, np.stack([r * sides + k, r * sides + right, (r + 1) * sides + right, (r + 1) * sides + k], axis=1)
