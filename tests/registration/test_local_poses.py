"""One pair of matched points is a whole pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.descriptors import local_harmonics
from fsh3d_o3d.geometry import thinned_surface
from fsh3d_o3d.registration.fit import Poses
from fsh3d_o3d.registration.lattice import SurfaceLattice, distinct
from fsh3d_o3d.registration.local_poses import local_poses
from fsh3d_o3d.registration.settling import Ground
from tests.descriptors.test_neighbourhoods import SHIFT, TURN, surface


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
    target = thinned_surface(whole, 0.05)
    best = Ground.of(target.points, target.normals, 0.05).best(poses, half[:200])[0].take([0])
    error = np.linalg.norm(best.apply(half)[0] - (half - SHIFT) @ TURN, axis=1)
    assert error.mean() < 0.1


@pytest.mark.parametrize(
    "points",
    [surface(50), np.linspace(0, 1, 300)[:, None] * [1.0, 2.0, 3.0], surface(3), surface(1000) * [1.0, 1.0, 0.0]],
    ids=["fifty points", "on a line", "three points", "flat"],
)
def test_poor_clouds_give_finite_poses_or_none(points: np.ndarray) -> None:
    whole = surface(5000)
    for source, target in ((points, whole), (whole, points), (points, points)):
        sides = [thinned_surface(side, 0.08) for side in (source, target)]
        poses, scores = local_poses(*(local_harmonics(side, 0.5, keypoints=100) for side in sides))
        assert len(poses) == len(scores)
        assert np.isfinite(poses.rotations).all()
        found, scores, origin = Ground.of(sides[1].points, sides[1].normals, 0.08).best(poses, sides[0].points[:250])
        assert len(found) == len(scores) == len(origin) <= 12
        assert np.isfinite(found.shifts).all()


def test_rough_poses_settle_on_the_surface() -> None:
    target = thinned_surface(surface(20000), 0.05)
    probes = surface(120, seed=1)
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(20, 3)) * 0.04).as_matrix()
    rough = Poses(turns, np.ones(20), np.full((20, 3), 0.02))
    lattice = SurfaceLattice.of(target.points, target.normals, 0.1)
    settled = lattice.settled(rough, probes, steps=4, reach=0.12)
    before, after = (np.linalg.norm(poses.apply(probes) - probes, axis=2).mean(axis=1) for poses in (rough, settled))
    assert np.median(before) > 0.04
    assert np.median(after) < 0.01
    assert lattice.shares(settled, probes, 0.02).min() > 0.9


def test_of_poses_that_are_the_same_the_first_is_kept() -> None:
    poses = Poses(
        np.eye(3)[None].repeat(4, axis=0), np.ones(4), np.array([[0, 0, 0], [0, 0, 0.1], [1, 0, 0], [1, 0, 0.0]])
    )
    assert distinct(poses, surface(10), 0.3, 9).tolist() == [0, 2]
    assert distinct(poses, surface(10), 0.05, 2).tolist() == [0, 1]


def test_the_best_of_many_poses_lie_on_the_target() -> None:
    whole, again = surface(20000), surface(30000, seed=1)
    half = again[again @ [0.6, 0.0, 0.8] > 0] @ TURN.T + SHIFT
    target = thinned_surface(whole, 0.08)
    source = thinned_surface(half, 0.08)
    poses, _ = local_poses(*(local_harmonics(side, 0.5, keypoints=200) for side in (source, target)))
    found, scores, origin = Ground.of(target.points, target.normals, target.spacing).best(poses, half[:250], most=5)
    error = np.linalg.norm(found.apply(half)[0] - (half - SHIFT) @ TURN, axis=1)
    assert error.mean() < 0.03
    assert len(scores) == len(origin) == len(found) <= 5
    assert (np.diff(scores) <= 0).all()
