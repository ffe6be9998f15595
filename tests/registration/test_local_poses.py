"""One pair of matched points is a whole pose."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fsh3d_o3d.descriptors import local_harmonics
from fsh3d_o3d.registration.fit import Poses
from fsh3d_o3d.registration.local_poses import local_poses
from fsh3d_o3d.registration.occupancy import Occupancy
from tests.descriptors.test_neighbourhoods import surface

TURN = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
SHIFT = np.array([3.0, -1.0, 2.0])


def test_the_same_point_in_another_pose_gives_the_pose() -> None:
    points = surface(20000)
    keys = points[:60]
    source = local_harmonics(points, 0.6, keypoints=keys)
    target = local_harmonics(points @ TURN.T + SHIFT, 0.6, keypoints=keys @ TURN.T + SHIFT)
    poses, scores = local_poses(source, target, nearest=1, most=30)
    error = np.linalg.norm(poses.apply(points[:200]) - (points[:200] @ TURN.T + SHIFT), axis=2).mean(axis=1)
    assert np.median(error) < 0.1  # about three degrees
    assert (np.diff(scores) <= 0).all()


def test_a_half_finds_its_place_on_the_whole() -> None:
    whole, again = surface(20000), surface(30000, seed=1)
    half = again[again @ [0.6, 0.0, 0.8] > 0] @ TURN.T + SHIFT
    source, target = (local_harmonics(points, 0.5, keypoints=300) for points in (half, whole))
    poses, _ = local_poses(source, target)
    occupied = Occupancy.of(whole, 0.05)
    best = poses.take([int(occupied.shares(poses, half[:200]).argmax())])
    error = np.linalg.norm(best.apply(half)[0] - (half - SHIFT) @ TURN, axis=1)
    assert error.mean() < 0.1


def test_probes_on_the_surface_count() -> None:
    plane = np.stack(np.meshgrid(np.linspace(0, 1, 50), np.linspace(0, 1, 50), [0.0]), axis=-1).reshape(-1, 3)
    occupied = Occupancy.of(plane, 0.05)
    lifted = np.array([[0.0, 0.0, height] for height in (0.0, 0.04, 0.2)])
    poses = Poses(np.eye(3)[None].repeat(3, axis=0), np.ones(3), lifted)
    shares = occupied.shares(poses, plane[::7])
    assert shares[0] == shares[1] == 1
    assert shares[2] < 0.1  # a table that is full by chance
