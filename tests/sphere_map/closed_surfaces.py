"""Closed genus-0 surfaces that are hard to map: long, branched, thin, or with vertices of every degree."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d.geometry.triangulation import icosphere
from tests.geometry import mesh_shapes


def arrays(mesh):
    return np.array(mesh.vertices), np.array(mesh.triangles)


def tetrahedron():
    corners = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
    return corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def ball(frequency=12):
    directions, triangles = icosphere(frequency)
    return np.array(directions), np.array(triangles)


def rod(rings=400, around=6, radius=0.5):
    """A tube with a ring of vertices at each unit of its length, closed by a point at either end."""
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.column_stack((np.zeros(around), radius * np.cos(angle), radius * np.sin(angle)))
    vertices = (np.arange(rings)[:, None, None] * [1.0, 0, 0] + circle).reshape(-1, 3)
    i, j = (np.arange(rings - 1) * around)[:, None], np.arange(around)
    k = (j + 1) % around
    side = [(i + j, i + around + k, i + k), (i + j, i + around + j, i + around + k)]
    first, last, end = rings * around, rings * around + 1, (rings - 1) * around
    caps = [(np.full(around, first), j, k), (np.full(around, last), end + k, end + j)]
    triangles = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in (*side, *caps)])
    return np.vstack((vertices, [[-radius, 0, 0], [rings - 1 + radius, 0, 0]])), triangles


def comb(teeth=8, length=25):
    solid = np.ones((2 * teeth + 1, 1, length + 1))
    solid[1::2, :, 1:] = 0
    return arrays(mesh_shapes.voxels(solid))


def needle(aspect=1e6):
    """An ellipsoid of thin triangles."""
    directions, triangles = ball()
    return directions * (aspect, 1, 1), triangles


def prism():
    """Two vertices of degree 2000, and walls 10⁵ times as high as wide."""
    return arrays(mesh_shapes.needles(2000, height=150.0))


def bipyramid(around=300):
    i = np.arange(around)
    j, angle = (i + 1) % around, 2 * np.pi * i / around
    ring = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(around)))
    top, bottom = np.full(around, around), np.full(around, around + 1)
    return np.vstack((ring, [[0, 0, 1], [0, 0, -1]])), np.vstack(
        (np.stack((i, j, top), 1), np.stack((j, i, bottom), 1))
    )


def stacked(rng, n=300, *, nested=False):
    """A tetrahedron whose triangles are cut in three again and again, at random or always the newest: all degrees."""
    corners, first = tetrahedron()
    vertices, triangles = list(corners), [tuple(row) for row in first]
    for k in range(n):
        chosen = len(triangles) - 1 - k % 2 if nested else int(rng.integers(len(triangles)))
        a, b, c = triangles[chosen]
        vertices.append((vertices[a] + vertices[b] + vertices[c]) / 3)
        new = len(vertices) - 1
        triangles[chosen] = (a, b, new)
        triangles += [(b, c, new), (c, a, new)]
    return np.array(vertices), np.array(triangles)


def point(frequency=6):
    """All vertices in one place."""
    directions, triangles = ball(frequency)
    return directions * 0.0, triangles


def scrambled(rng, frequency=10):
    """Positions that have nothing to do with the triangles."""
    directions, triangles = ball(frequency)
    return rng.permutation(directions), triangles
