"""Many scans in one frame: known poses of synthetic depth views, strangers, wrong pairs, groups, hard input."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_point_cloud
from fsh3d_o3d.geometry.even_thinning import evenly_thinned, voxel_averaged
from fsh3d_o3d.registration.scan_fit import ScanSamples, fitted, measured_contact
from fsh3d_o3d.registration.scan_graph import Group, optimised
from fsh3d_o3d.registration.scan_loops import PairPose, believed, loop_gap
from fsh3d_o3d.registration.scan_pairs import chosen_pairs
from tests.registration.depth_views import Views, depth_views, errors, ring

SAMPLES = Path(__file__).parents[2] / "samples"


def sample(name: str) -> MeshArrays:
    geometry = read_geometry_arrays(SAMPLES / name, isolated=False)
    assert isinstance(geometry, MeshArrays)
    return geometry


def lump(seed: int = 3) -> MeshArrays:
    """A body with a dozen dents and bumps of its own, which looks like itself in no other pose."""
    directions, triangles = fsh.icosphere(40)
    rng = np.random.default_rng(seed)
    middles = rng.standard_normal((14, 3))
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    heights = rng.uniform(-0.3, 0.45, 14)
    near = np.exp((directions @ middles.T - 1) / 0.06)
    return MeshArrays(directions * (1 + near @ heights)[:, None] * [1.3, 1.0, 0.8], triangles)


@cache
def views() -> Views:
    """Eight views all around, of which the last lies beside the first: a loop."""
    return depth_views(lump(), ring(8))


@cache
def registered() -> fsh.ScanRegistrationResult:
    return fsh.register_scans(views().clouds, viewpoints=views().eyes)


def assert_right(result: fsh.ScanRegistrationResult, known: Views, group: int = 0, first: int = 0) -> None:
    """All scans of a group lie where they should, to 1 degree and 1 % of the diagonal; ``first``: of the views."""
    members = result.groups[group]
    base = np.linalg.inv(known.poses[members[0] - first])
    for scan in members:
        degrees, distance = errors(result.poses[scan], base @ known.poses[scan - first], known.clouds[scan - first])
        assert degrees < 1
        assert distance < 0.01 * known.diagonal


def test_views_around_a_body_close_their_loop():
    result = registered()
    assert result.unplaced == ()
    assert result.placed.all()
    assert_right(result, views())
    np.testing.assert_array_equal(result.poses[0], np.eye(4))
    used = {(pair.target, pair.source) for pair in result.pairs if pair.used}
    assert {(scan, scan + 1) for scan in range(7)} | {(0, 7)} <= used  # the ring is closed
    assert result.loop_error[1] <= result.loop_error[0]
    assert result.loop_error[1] < 0.005 * views().diagonal
    assert repr(result).startswith("ScanRegistrationResult(8 of 8 scans placed, ")


def test_pairs_tell_what_became_of_them():
    for pair in registered().pairs:
        assert pair.used == (pair.reason == "")
        assert 0 <= pair.confidence <= 1
        known = np.linalg.inv(views().poses[pair.target]) @ views().poses[pair.source]
        if pair.used:
            degrees, distance = errors(pair.transformation, known, views().clouds[pair.source])
            assert degrees < 2  # one pair alone: some touch by a tenth of themselves
            assert distance < 0.01 * views().diagonal
            assert min(pair.overlap) > 0.02
            assert 0 < pair.inlier_rmse < 0.01 * views().diagonal


def test_a_stranger_is_left_out_and_named():
    stranger = depth_views(sample("horn.off"), ring(1), seed=5)
    clouds = [*views().clouds[:3], PointArrays(stranger.clouds[0].points * 2)]
    result = fsh.register_scans([clouds[3], *clouds[:3]])
    assert result.unplaced == (0,)
    assert result.groups == ((1, 2, 3), (0,))
    assert_right(result, views(), first=1)
    assert all(pair.reason for pair in result.pairs if 0 in (pair.source, pair.target))
    np.testing.assert_array_equal(result.poses[0], np.eye(4))


def test_two_bodies_become_two_groups():
    other = depth_views(lump(11), ring(8)[:2], seed=7)
    result = fsh.register_scans([*views().clouds[:3], *other.clouds])
    assert result.groups == ((0, 1, 2), (3, 4))
    assert result.unplaced == (3, 4)
    assert_right(result, views())
    assert_right(result, other, group=1, first=3)
    assert len(result.merged(group=1).points) == sum(len(cloud.points) for cloud in other.clouds)


def _true_samples() -> tuple[list[ScanSamples], list[np.ndarray]]:
    """Views about their centres, as they are registered, and where they belong."""
    samples, poses = [], []
    for cloud, eye, pose in zip(views().clouds, views().eyes, views().poses, strict=True):
        center = cloud.points.mean(axis=0)
        samples.append(ScanSamples.of(PointArrays(cloud.points - center), eye - center))
        shift = np.eye(4)
        shift[:3, 3] = center
        poses.append(pose @ shift)
    return samples, poses


def test_one_wrong_pair_is_dropped_by_its_loops():
    samples, poses = _true_samples()
    touching = measured_contact(samples[1], samples[0], np.linalg.inv(poses[0]) @ poses[1])
    pairs = [
        PairPose(source, target, np.linalg.inv(poses[target]) @ poses[source], 0.9, touching)
        for target, source in ((0, 1), (1, 2), (0, 2), (2, 3), (1, 3), (0, 3))
    ]
    belief, closing = believed(pairs)
    assert belief.min() > 0.99
    assert set(closing) == {2}
    turn = np.eye(4)
    turn[:3, :3] = o3d.geometry.get_rotation_matrix_from_xyz((0.0, 0.0, 0.9))
    pairs[2] = PairPose(2, 0, pairs[2].pose @ turn, 0.9, touching)  # which touches as well as the right ones
    belief, closing = believed(pairs)
    assert belief[2] < 0.5  # not trusted
    assert np.delete(belief, 2).min() > 0.9
    assert closing.tolist() == [1, 1, 0, 1, 2, 1]


def test_the_optimisation_gives_up_a_pair_that_contradicts_the_others():
    samples, poses = _true_samples()
    links = []
    for target, source in ((0, 1), (1, 2), (2, 3)):
        pose = np.linalg.inv(poses[target]) @ poses[source]
        links.append(PairPose(source, target, pose, 0.9, measured_contact(samples[source], samples[target], pose)))
    shifted = np.linalg.inv(poses[0]) @ poses[7]
    shifted[:3, 3] += 0.5
    links.append(PairPose(7, 0, shifted, 0.9, links[0].contact))
    known = {scan: np.linalg.inv(poses[0]) @ poses[scan] for scan in (0, 1, 2, 3, 7)}
    better, used, given_up, _ = optimised(samples, Group(known, tuple(links)), lambda: None)
    assert (7, 0) not in [(pair.source, pair.target) for pair in given_up]  # what touches there was fitted instead
    for scan, pose in better.items():
        assert loop_gap(np.linalg.inv(known[scan]) @ pose) < 0.02
    assert len(used) >= 4


def test_one_scan_and_the_same_scan_twice():
    cloud = views().clouds[0]
    alone = fsh.register_scans([cloud])
    assert alone.groups == ((0,),)
    assert alone.pairs == ()
    np.testing.assert_array_equal(alone.poses, np.eye(4)[None])
    twice = fsh.register_scans([cloud, cloud])
    assert twice.groups == ((0, 1),)
    np.testing.assert_allclose(twice.poses[1], np.eye(4), atol=1e-6)


def test_points_that_were_not_seen_are_dropped_and_counted():
    one, other = views().clouds[:2]
    holes = np.full((50, 3), np.nan)
    legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate((holes, one.points))))
    tensor = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.concatenate((other.points, holes[:7]))))
    result = fsh.register_scans([legacy, tensor])
    np.testing.assert_array_equal(result.dropped_points, [50, 7])
    assert result.groups == ((0, 1),)
    assert_right(result, views())
    assert isinstance(result.merged(), o3d.geometry.PointCloud)
    assert isinstance(result.merged(kind="tensor"), o3d.t.geometry.PointCloud)
    plain = fsh.register_scans([np.concatenate((one.points, holes)), other])
    np.testing.assert_array_equal(plain.dropped_points, [50, 0])
    np.testing.assert_array_equal(plain.poses, result.poses)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(scale):
    pair = [PointArrays(cloud.points * scale) for cloud in views().clouds[:2]]
    found, plain = fsh.register_scans(pair), fsh.register_scans(views().clouds[:2])
    assert found.groups == plain.groups == ((0, 1),)
    np.testing.assert_allclose(found.poses[1][:3, :3], plain.poses[1][:3, :3], atol=1e-3)
    np.testing.assert_allclose(found.poses[1][:3, 3] / scale, plain.poses[1][:3, 3], atol=3e-3)


def test_merged_cloud_keeps_colours_and_normals():
    clouds = []
    for number, cloud in enumerate(views().clouds[:2]):
        colors = np.tile([0.25 + 0.5 * number, 0.5, 0.75], (len(cloud.points), 1))
        towards = views().eyes[number] - cloud.points
        normals = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        clouds.append(open3d_point_cloud(PointArrays(cloud.points, normals, colors), "tensor"))
    result = fsh.register_scans(clouds)
    merged = result.merged(kind="legacy")
    assert len(merged.points) == sum(len(cloud.points) for cloud in views().clouds[:2])
    assert set(np.asarray(merged.colors)[:, 0]) == {0.25, 0.75}
    first = len(views().clouds[0].points)
    expected = clouds[1].point.normals.numpy() @ result.poses[1][:3, :3].T
    np.testing.assert_allclose(np.asarray(merged.normals)[first:], expected, atol=1e-12)
    coarse = result.merged(voxel=0.1, kind="legacy")
    assert len(coarse.points) < len(merged.points) / 3
    np.testing.assert_allclose(np.linalg.norm(np.asarray(coarse.normals), axis=1), 1, atol=1e-12)
    mixed = fsh.register_scans([clouds[0], views().clouds[1]]).merged(kind="legacy")
    assert not mixed.has_colors() and not mixed.has_normals()


def test_meshes_are_scans_too():
    mesh = lump()
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    parts = [
        MeshArrays(mesh.vertices, mesh.triangles[middles[:, 0] > -0.5]),
        MeshArrays(mesh.vertices @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], mesh.triangles[middles[:, 0] < 0.5]),
    ]
    result = fsh.register_scans(parts)
    assert result.groups == ((0, 1),)
    np.testing.assert_allclose(result.poses[1][:3, :3] @ [0, 1, 0], [1, 0, 0], atol=0.01)
    merged = result.merged()
    assert merged.has_normals()


_PROGRAM = """
import sys, pickle, hashlib
import fsh3d_o3d as fsh
clouds, eyes = pickle.load(open(sys.argv[1], "rb"))
result = fsh.register_scans(clouds, viewpoints=eyes)
print(hashlib.sha256(result.poses.tobytes() + repr(result.pairs).encode()).hexdigest())
print(hashlib.sha256(b"".join(pair.transformation.tobytes() for pair in result.pairs)).hexdigest())
"""


def test_equal_bytes_whatever_the_number_of_threads(tmp_path):
    path = tmp_path / "scans.pickle"
    path.write_bytes(pickle.dumps((views().clouds[:4], views().eyes[:4])))
    printed = set()
    for threads in ("1", "4"):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-c", _PROGRAM, str(path)], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        printed.add(done.stdout)
    assert len(printed) == 1


def test_of_many_scans_not_all_pairs_are_aligned():
    rng = np.random.default_rng(0)
    scans = [PointArrays(rng.standard_normal((60, 3)) * [1, 1 + k % 5, 1]) for k in range(20)]
    assert len(chosen_pairs(scans[:6], 12, 3)) == 15
    chosen = chosen_pairs(scans, 12, 3)
    assert {(k, k + 1) for k in range(19)} <= set(chosen)
    assert len(chosen) <= 20 * (3 + 2)
    assert all(first < second for first, second in chosen)


@pytest.mark.parametrize(
    ("clouds", "options", "error", "message"),
    [
        ([], {}, ValueError, "at least one scan"),
        ("scans", {}, TypeError, "must be a list of scans"),
        ([PointArrays(np.zeros((5, 3)))], {}, GeometryError, "scan 0: it has no extent"),
        ([PointArrays(np.eye(3)), 7], {}, TypeError, "scan 1: geometry must be"),
        ([o3d.geometry.PointCloud()], {}, GeometryError, "scan 0: there are no points"),
        ([PointArrays(np.eye(3))], {"option": 3}, TypeError, "option must be"),
        ([PointArrays(np.eye(3))], {"viewpoints": np.zeros((2, 3))}, ValueError, "viewpoints must have shape"),
    ],
)
def test_bad_input_is_refused(clouds, options, error, message):
    with pytest.raises(error, match=message):
        fsh.register_scans(clouds, **options)


def test_a_scan_of_nothing_but_unseen_points_is_named():
    blind = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.full((9, 3), np.nan)))
    with pytest.raises(GeometryError, match="scan 1: there are no points"):
        fsh.register_scans([views().clouds[0], blind])


def test_a_wall_slides_and_is_not_placed():
    rng = np.random.default_rng(4)
    walls = [PointArrays(rng.uniform(-1, 1, (3000, 3)) * [1, 1, 0.002]) for _ in range(2)]
    result = fsh.register_scans(walls)
    assert result.unplaced == (1,)
    assert [pair.reason for pair in result.pairs] == ["slides"]


def test_fit_of_what_is_in_contact(rng):
    samples, poses = _true_samples()
    true = np.linalg.inv(poses[0]) @ poses[1]
    off = true.copy()
    off[:3, :3] = o3d.geometry.get_rotation_matrix_from_xyz((0.03, -0.04, 0.02)) @ off[:3, :3]
    found = fitted(samples[1], samples[0], off)
    degrees, distance = errors(found, true, PointArrays(samples[1].points))
    assert degrees < 0.3
    assert distance < 0.003 * views().diagonal
    right, wrong = (measured_contact(samples[1], samples[0], pose) for pose in (true, off))
    assert right.agreement > 0.9 > wrong.agreement
    assert right.overlap[0] > 0.4
    assert right.hidden is not None and right.hidden < 0.05


def test_thinning_spreads_evenly_and_averages(rng):
    dense = rng.uniform(0, 1, (40_000, 2)) ** 3  # far denser in a corner
    cloud = PointArrays(np.column_stack((dense, np.zeros(len(dense)))), np.tile([0, 0, 2.0], (len(dense), 1)), None)
    thin = evenly_thinned(cloud, 1000)
    assert 600 < len(thin.points) <= 1000
    assert np.mean(thin.points[:, 0] < 0.5) == pytest.approx(0.5, abs=0.1)
    np.testing.assert_array_equal(thin.normals, np.tile([0, 0, 1.0], (len(thin.points), 1)))
    few = PointArrays(
        np.array([[0, 0, 0], [0.2, 0, 0], [5, 0, 0.0]]), None, np.array([[0, 0, 0], [1, 1, 1], [0, 1, 0.0]])
    )
    means = voxel_averaged(few, 1.0)
    np.testing.assert_allclose(means.points, [[0.1, 0, 0], [5, 0, 0]])
    np.testing.assert_allclose(means.colors, [[0.5, 0.5, 0.5], [0, 1, 0]])
    assert evenly_thinned(few, 10) is few
    assert len(evenly_thinned(PointArrays(np.ones((9, 3))), 2).points) == 1
