"""Meshes whose measures are known by heart."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.triangulation import icosphere


def voxels(occupied) -> MeshArrays:
    """The surface of unit cubes where ``occupied`` (3-D array of 0 and 1), outward, vertices shared."""
    solid = np.pad(np.asarray(occupied, dtype=int), 1)
    corners, quads = [], []
    for axis in range(3):
        step = np.diff(solid, axis=axis)
        for sign in (-1, 1):
            cells = np.argwhere(step == sign)
            u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
            base = cells + 0
            base[:, axis] += 1
            # np.diff +1: solid begins above the face, which then looks down the axis.
            ring = (base, base + v, base + u + v, base + u) if sign == 1 else (base, base + u, base + u + v, base + v)
            corners.append(np.stack(ring, axis=1))
    quads = np.concatenate(corners).reshape(-1, 3) - 1
    vertices, index = np.unique(quads, axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    return MeshArrays(vertices.astype(float), np.concatenate((index[:, (0, 1, 2)], index[:, (0, 2, 3)])))


def box(size=(1.0, 1.0, 1.0)) -> MeshArrays:
    """A box about the origin."""
    cube = voxels(np.ones((1, 1, 1)))
    return MeshArrays((cube.vertices - 0.5) * size, cube.triangles)


def ell() -> MeshArrays:
    """Three cubes in an L: volume 3, area 14, kernel [0, 1]³."""
    return voxels([[[1], [1]], [[1], [0]]])


def screw() -> MeshArrays:
    """Four cubes along x, y, then z: another shape than its mirror image."""
    return voxels([[[1, 0], [0, 0]], [[1, 0], [1, 1]]])


def u_shape() -> MeshArrays:
    """Five cubes in a U: volume 5, empty kernel."""
    return voxels([[[1], [1]], [[1], [0]], [[1], [1]]])


def frame() -> MeshArrays:
    """Eight cubes around a hole: genus 1."""
    solid = np.ones((3, 3, 1))
    solid[1, 1, 0] = 0
    return voxels(solid)


def sphere(frequency=16, radius=1.0, center=(0.0, 0.0, 0.0)) -> MeshArrays:
    directions, triangles = icosphere(frequency)
    return MeshArrays(directions * radius + center, triangles)


def ellipsoid(axes, frequency=16) -> MeshArrays:
    directions, triangles = icosphere(frequency)
    return MeshArrays(directions * axes, triangles)


def bumpy(frequency=16) -> MeshArrays:
    """A smooth star-shaped surface without symmetry."""
    directions, triangles = icosphere(frequency)
    x, y, z = directions.T
    radius = 1 + 0.15 * np.sin(3 * x + 1) + 0.1 * np.cos(4 * y - x) + 0.1 * z
    return MeshArrays(directions * radius[:, None], triangles)


def torus(ring=2.0, tube=0.5, n=40, m=24) -> MeshArrays:
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    u, v = 2 * np.pi * i / n, 2 * np.pi * j / m
    rho = ring + tube * np.cos(v)
    vertices = np.column_stack((rho * np.cos(u), rho * np.sin(u), tube * np.sin(v)))

    def at(a, b):
        return (a % n) * m + b % m

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return MeshArrays(vertices, np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d)))))


def mobius(n=24) -> MeshArrays:
    """A Möbius band: one side, one boundary."""
    i = np.arange(n)
    angle = 2 * np.pi * i / n
    rings = []
    for side in (-0.3, 0.3):
        rho = 1 + side * np.cos(angle / 2)
        rings.append(np.column_stack((rho * np.cos(angle), rho * np.sin(angle), side * np.sin(angle / 2))))
    vertices = np.stack(rings, axis=1).reshape(-1, 3)
    a, b = 2 * i, 2 * i + 1
    c, d = 2 * ((i + 1) % n), 2 * ((i + 1) % n) + 1
    c, d = np.where(i == n - 1, d, c), np.where(i == n - 1, c, d)
    return MeshArrays(vertices, np.concatenate((np.column_stack((a, c, b)), np.column_stack((b, c, d)))))


def joined(*meshes: MeshArrays) -> MeshArrays:
    """Several meshes as one."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return MeshArrays(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
    )


def soup(mesh: MeshArrays) -> MeshArrays:
    """The mesh with three vertices of its own for every triangle, as STL stores it."""
    return MeshArrays(mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(mesh.triangles.size).reshape(-1, 3))


def moved(mesh: MeshArrays, *, rotation=None, scale=1.0, offset=(0.0, 0.0, 0.0)) -> MeshArrays:
    rotation = np.eye(3) if rotation is None else rotation
    return MeshArrays(mesh.vertices @ rotation.T * scale + offset, mesh.triangles)


def without(mesh: MeshArrays, removed) -> MeshArrays:
    """The mesh without the triangles where ``removed`` (t,) is true."""
    return MeshArrays(mesh.vertices, mesh.triangles[~np.asarray(removed)])


def needles(n, height=20.0) -> MeshArrays:
    """A closed n-sided prism about the z axis, of radius 1 and from −height to height: thin triangles only."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack((np.cos(angle), np.sin(angle), np.full(n, -height)))
    vertices = np.vstack((ring, ring * (1, 1, -1), [[0, 0, -height], [0, 0, height]]))
    i, j, bottom, top = np.arange(n), (np.arange(n) + 1) % n, np.full(n, 2 * n), np.full(n, 2 * n + 1)
    corners = ((i, j, n + j), (i, n + j, n + i), (bottom, j, i), (top, n + i, n + j))
    return MeshArrays(vertices, np.concatenate([np.column_stack(columns) for columns in corners]))


def needle_soup(aspect, gap, n=150) -> MeshArrays:
    """Pairs of thin triangles of length 1 in all directions, one ``gap`` above the other."""
    rng = np.random.default_rng(2)
    start, along = rng.normal(size=(2, n, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.cross(along, rng.normal(size=(n, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    below = np.concatenate((start, start + along, start + 0.4 * along + across / aspect))
    above = below + gap * np.tile(np.cross(along, across), (3, 1))
    index = np.arange(3 * n).reshape(3, n).T
    return MeshArrays(np.concatenate((below, above)), np.concatenate((index, index + 3 * n)))


def waves(n=41) -> MeshArrays:
    """An open sheet of hills and valleys, seen whole only from far above."""
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(-1, 1, n)], indexing="ij"))
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return MeshArrays(
        np.column_stack((x, y, 0.3 * np.sin(5 * x + 0.3) * np.sin(4 * y))),
        np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d)))),
    )


def open3d_geometry(mesh: MeshArrays, kind: str):
    """The mesh as Open3D geometry, made here so that tests of arrays do not lean on the adapter that makes it."""
    o3d = open3d()
    vertices, triangles = np.array(mesh.vertices), np.array(mesh.triangles)
    if kind == "tensor":
        return o3d.t.geometry.TriangleMesh(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
