"""Shapes seen in part, and input that is hard for their alignment: what is found, how far it is trusted, what is said.

Bodies are drawn or cast from the samples; equal input must give equal bytes.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import area_samples
from tests.registration.depth_views import depth_views, errors

SAMPLES = Path(__file__).parents[2] / "samples"
RIGID = fsh.SphericalRegistrationOption(with_scaling=False)
TURN = Rotation.from_rotvec([0.7, -1.1, 1.9]).as_matrix()


def sample(name: str) -> MeshArrays:
    geometry = read_geometry_arrays(SAMPLES / name, isolated=False)
    assert isinstance(geometry, MeshArrays)
    return geometry


HAND = sample("hand.ply")
VIEWS = depth_views(HAND, np.array([[1, 0.3, 0.5], [0.5, 1, 0.2]]), pixels=80)


def cloud(mesh: MeshArrays, count: int, seed: int = 0) -> np.ndarray:
    return area_samples(mesh, count, seed=seed)[0]


def right(result, truth, source, *, degrees=2.0, share=0.01) -> bool:
    turned, apart = errors(result.transformation, truth, source)
    return bool(turned < degrees and apart < share * VIEWS.diagonal)


@pytest.mark.parametrize("option", [None, RIGID], ids=["any scale", "same units"])
def test_a_depth_view_finds_its_place_on_the_whole_mesh(option):
    result = fsh.registration_spherical(VIEWS.clouds[0], HAND, option)
    assert right(result, VIEWS.poses[0], VIEWS.clouds[0])
    assert result.confidence >= 0.5
    assert result.overlap[0] > 0.9
    assert 0.2 < result.overlap[1] < 0.6  # no more than half is seen, and little of it is hidden
    assert result.scale == pytest.approx(1)
    assert result.ambiguity == "none"
    assert result.ambiguous_axis is None


def test_two_views_meet_in_what_both_saw():
    result = fsh.registration_spherical(VIEWS.clouds[0], VIEWS.clouds[1])
    assert right(result, np.linalg.inv(VIEWS.poses[1]) @ VIEWS.poses[0], VIEWS.clouds[0])
    assert max(result.overlap) < 0.9


@pytest.mark.parametrize(
    ("first", "second"), [("hand.ply", "double_torus.off"), ("horn.off", "starfish.ply"), ("gem.stl", "hand.ply")]
)
def test_what_shares_nothing_has_a_result_without_confidence(first, second):
    halves = []
    for axis, name in enumerate((first, second)):
        points = cloud(sample(name), 3000)
        points = points / np.ptp(points, axis=0).max()
        halves.append(PointArrays(points[points[:, axis] > np.median(points[:, axis])]))
    result = fsh.registration_spherical(*halves)
    assert np.isfinite(result.transformation).all()
    assert result.confidence <= 0.2


def flat(rng, count, low, high, rough=0.0):
    return np.c_[rng.uniform(low, high, (count, 2)), rough * rng.standard_normal(count)]


@pytest.mark.parametrize("rough", [0.0, 0.003])
def test_walls_slide_in_their_plane(rng, rough):
    wall = PointArrays(flat(rng, 3000, (-1, -0.6), (1, 0.6), rough) @ TURN.T)
    result = fsh.registration_spherical(wall, PointArrays(flat(rng, 8000, (-1.5, -1), (2, 1.4), rough)), RIGID)
    assert result.ambiguity == "sliding"
    assert np.linalg.norm(result.ambiguous_axis) == pytest.approx(1)
    assert abs(result.ambiguous_axis[2]) < 0.02


def test_a_fold_slides_along_its_edge(rng):
    def fold(count, length):
        u, v = rng.uniform(0, length, 2 * count), rng.uniform(0, 1, 2 * count)
        first = np.arange(2 * count) < count
        return np.stack([u, np.where(first, v, 0), np.where(first, 0, v)], axis=1)

    result = fsh.registration_spherical(PointArrays(fold(2000, 2) @ TURN.T), PointArrays(fold(4000, 5)), RIGID)
    assert result.ambiguity == "sliding"
    assert abs(result.ambiguous_axis[0]) > 0.999


def test_a_piece_of_a_rod_slides_along_it_and_a_whole_rod_turns(rng):
    def rod(count, length):
        angle = rng.uniform(0, 2 * np.pi, count)
        return np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), rng.uniform(0, length, count)], axis=1)

    long = PointArrays(rod(6000, 4))
    for length, kind in ((2, "sliding"), (4, "continuous")):
        result = fsh.registration_spherical(PointArrays(rod(3000, length) @ TURN.T), long, RIGID)
        assert result.ambiguity == kind
        assert abs(result.ambiguous_axis[2]) > 0.999


def test_a_view_of_a_vase_turns_about_its_axis():
    # The axis is beside what was seen: a turn that left along the tangent would lift the view off the vase.
    vase = sample("vase_quads.obj")
    view = depth_views(vase, np.array([[1, 0.2, 0.3]]), pixels=80).clouds[0]
    result = fsh.registration_spherical(view, vase)
    assert result.ambiguity == "continuous"
    assert abs(result.ambiguous_axis[2]) > 0.999
    assert result.overlap[0] > 0.9


@pytest.mark.parametrize("count", [2, 3, 8, 50])
def test_few_points_have_a_result(count):
    few = PointArrays(cloud(HAND, count))
    for source, target in ((few, HAND), (HAND, few)):
        result = fsh.registration_spherical(source, target)
        assert np.isfinite(result.transformation).all()
        assert result.confidence < 0.5


@pytest.mark.parametrize("option", [None, RIGID], ids=["any scale", "same units"])
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_a_speck_beside_the_other_is_not_trusted(option, factor):
    speck = PointArrays(VIEWS.clouds[0].points * factor)
    result = fsh.registration_spherical(speck, HAND, option)
    assert np.isfinite(result.transformation).all()
    assert result.confidence <= 0.2


def test_points_on_a_line_have_a_result(rng):
    line = PointArrays(rng.uniform(0, 1, (500, 1)) * [1, 2, 2])
    for source, target in ((line, HAND), (HAND, line)):
        result = fsh.registration_spherical(source, target)
        assert np.isfinite(result.transformation).all()
        assert result.confidence <= 0.2


def holed() -> np.ndarray:
    points = VIEWS.clouds[0].points
    holes = np.full((300, 3), np.nan)
    holes[:7] = [np.inf, 0, 0]
    return np.concatenate([points[:100], holes, points[100:]])


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_points_that_are_not_finite_are_dropped_and_counted(kind):
    legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(holed()))
    given = legacy if kind == "legacy" else o3d.t.geometry.PointCloud(o3d.core.Tensor(holed()))
    result = fsh.registration_spherical(given, HAND)
    assert result.dropped == (300, 0)
    assert fsh.registration_spherical(HAND, given).dropped == (0, 300)
    expected = fsh.registration_spherical(VIEWS.clouds[0], HAND)
    np.testing.assert_array_equal(result.transformation, expected.transformation)
    np.testing.assert_array_equal(result.source_points, VIEWS.clouds[0].points)


def test_points_that_occur_several_times_change_nothing():
    points = VIEWS.clouds[0].points
    result = fsh.registration_spherical(PointArrays(np.concatenate([points, points, points[:400]])), HAND)
    assert right(result, VIEWS.poses[0], VIEWS.clouds[0])
    assert result.confidence >= 0.5


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_any_unit_gives_the_same_pose(factor):
    expected = fsh.registration_spherical(VIEWS.clouds[0], HAND)
    result = fsh.registration_spherical(
        PointArrays(VIEWS.clouds[0].points * factor), MeshArrays(HAND.vertices * factor, HAND.triangles)
    )
    np.testing.assert_allclose(result.transformation[:3, :3], expected.transformation[:3, :3], atol=1e-6)
    np.testing.assert_allclose(result.transformation[:3, 3] / factor, expected.transformation[:3, 3], atol=1e-6)
    assert result.confidence == pytest.approx(expected.confidence)


def test_a_target_inside_out_is_the_same_surface():
    result = fsh.registration_spherical(VIEWS.clouds[0], MeshArrays(HAND.vertices, HAND.triangles[:, ::-1]))
    assert right(result, VIEWS.poses[0], VIEWS.clouds[0])
    assert result.confidence >= 0.5


def test_an_object_is_found_in_a_much_larger_scene(rng):
    size = float(np.ptp(HAND.vertices, axis=0).max())
    torus = cloud(sample("double_torus.off"), 20000)
    torus *= 4 * size / np.ptp(torus, axis=0).max()
    floor = np.c_[rng.uniform(-5 * size, 5 * size, (20000, 2)), np.full(20000, -1.5 * size)]
    shift = np.array([3 * size, 0, 0])
    scene = PointArrays(np.concatenate([cloud(HAND, 4000) @ TURN.T + shift, torus, floor]))
    truth = np.eye(4)
    truth[:3, :3], truth[:3, 3] = TURN, shift
    result = fsh.registration_spherical(HAND, scene)
    assert right(result, truth, PointArrays(HAND.vertices))
    assert result.overlap[0] > 0.85
    assert result.overlap[1] < 0.1


def test_a_prepared_target_gives_the_same_bytes_again_and_again():
    target = fsh.SphericalRegistrationTarget(HAND)
    again = pickle.loads(pickle.dumps(target))
    for view in VIEWS.clouds:
        expected = fsh.registration_spherical(view, HAND)
        for prepared in (target, target, again, pickle.loads(pickle.dumps(target))):
            result = fsh.registration_spherical(view, prepared)
            assert result.transformation.tobytes() == expected.transformation.tobytes()
            assert result.confidence == expected.confidence


def test_a_prepared_target_refuses_another_number_of_samples():
    target = fsh.SphericalRegistrationTarget(HAND, samples=1024)
    with pytest.raises(ValueError, match="1024 samples, the option has 4096"):
        fsh.registration_spherical(VIEWS.clouds[0], target)


_CHILD = """
import hashlib, sys
from fsh3d_o3d import registration_spherical
from tests.registration.test_parts import HAND, VIEWS
for target in (HAND, VIEWS.clouds[1]):
    result = registration_spherical(VIEWS.clouds[0], target)
    print(hashlib.sha256(result.transformation.tobytes()).hexdigest(), result.confidence.hex())
"""


def test_equal_bytes_with_any_number_of_threads():
    said = [
        subprocess.run(
            [sys.executable, "-c", _CHILD],
            env={**os.environ, "OMP_NUM_THREADS": threads},
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "4", "4")
    ]
    assert len(set(said)) == 1
    assert len(said[0].split()) == 4
