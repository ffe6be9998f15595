"""Shapes for the reports' tests."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays


def ball(rings=24, radius=1.0, center=(0.0, 0.0, 0.0)) -> MeshArrays:
    """A globe of (rings − 1) · 2 rings + 2 vertices, outward."""
    around = 2 * rings
    theta = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    belt = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    vertices = np.concatenate((belt.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]))
    k = np.arange(around)
    after = (k + 1) % around
    north, south = len(vertices) - 2, len(vertices) - 1
    last = (rings - 2) * around
    row = around * np.arange(rings - 2)[:, None]
    sides = np.concatenate(
        [
            np.stack(np.broadcast_arrays(row + k, row + around + k, row + after), -1).reshape(-1, 3),
            np.stack(np.broadcast_arrays(row + after, row + around + k, row + around + after), -1).reshape(-1, 3),
        ]
    )
    caps = [
        np.stack((np.full(around, north), k, after), -1),
        np.stack((last + after, last + k, np.full(around, south)), -1),
    ]
    return MeshArrays(vertices * radius + center, np.concatenate([sides, *caps]))


def ball_points(count, seed=0, **attributes) -> PointArrays:
    """Random points of the unit sphere."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return PointArrays(points / np.linalg.norm(points, axis=1, keepdims=True), **attributes)


def square(half=1.0) -> MeshArrays:
    """A square in the x-y plane, seen from +z counter-clockwise."""
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    return MeshArrays(corners, [[0, 1, 2], [0, 2, 3]])
