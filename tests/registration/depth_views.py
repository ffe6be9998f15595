"""Depth views of a mesh, as a depth camera around it would take them, each in a frame of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from scipy.spatial.transform import Rotation

from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays


@dataclass(frozen=True, eq=False)
class Views:
    """Views of one mesh, and where they belong."""

    clouds: list[PointArrays]
    """What each camera saw, in a frame of its own."""
    poses: np.ndarray
    """(n, 4, 4) from these frames to that of the mesh."""
    eyes: np.ndarray
    """(n, 3) where each camera stood, in its view's frame."""
    diagonal: float
    """Of the mesh."""


def depth_views(mesh: MeshArrays, directions: np.ndarray, *, seed: int = 0, pixels: int = 160) -> Views:
    """Views from twice the diagonal away with noise of 0.2 % of it along the rays; poses are drawn at random."""
    rng = np.random.default_rng(seed)
    lower, upper = mesh.used_vertices.min(axis=0), mesh.used_vertices.max(axis=0)
    middle, diagonal = (lower + upper) / 2, float(np.linalg.norm(upper - lower))
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles.astype(np.uint32))
    )
    clouds, poses, eyes = [], [], []
    for direction in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        eye = middle + 2 * diagonal * direction
        up = [0, 0, 1] if abs(direction[2]) < 0.9 else [0, 1, 0]
        rays = scene.create_rays_pinhole(
            fov_deg=30, center=list(middle), eye=list(eye), up=up, width_px=pixels, height_px=pixels
        )
        depth = scene.cast_rays(rays, nthreads=1)["t_hit"].numpy().ravel().astype(np.float64)
        along = rays.numpy().reshape(-1, 6)[:, 3:].astype(np.float64)
        seen = np.isfinite(depth)
        along, depth = along[seen], depth[seen]
        noise = 0.002 * diagonal * rng.standard_normal(len(depth)) / np.linalg.norm(along, axis=1)
        points = eye + along * (depth + noise)[:, None]
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        pose[:3, 3] = diagonal * rng.standard_normal(3)
        clouds.append(PointArrays((points - pose[:3, 3]) @ pose[:3, :3]))
        eyes.append((eye - pose[:3, 3]) @ pose[:3, :3])
        poses.append(pose)
    return Views(clouds, np.array(poses), np.array(eyes), diagonal)


def ring(count: int) -> np.ndarray:
    """Directions (count, 3) all around, a little up and down."""
    angle = 2 * np.pi * np.arange(count) / count
    height = 0.4 * np.sin(2 * angle)
    return np.stack([np.cos(angle), np.sin(angle), height], axis=1)


def errors(found: np.ndarray, true: np.ndarray, cloud: PointArrays) -> tuple[float, float]:
    """Degrees between two poses, and the mean distance between the cloud's points under both."""
    cosine = (np.trace(found[:3, :3] @ true[:3, :3].T) - 1) / 2
    moved = [cloud.points @ pose[:3, :3].T + pose[:3, 3] for pose in (found, true)]
    return (
        float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
        float(np.linalg.norm(moved[0] - moved[1], axis=1).mean()),
    )
