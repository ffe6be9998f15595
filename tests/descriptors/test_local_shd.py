"""Features of points: in Open3D's pipelines where FPFH stands, the same in every pose and unit, and for bad input."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from tests.descriptors.test_neighbourhoods import SHIFT, TURN, surface

registration = o3d.pipelines.registration


def cloud(points: np.ndarray) -> o3d.geometry.PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def moved(points: np.ndarray) -> np.ndarray:
    return points @ TURN.T + SHIFT


def half_and_whole() -> tuple[o3d.geometry.PointCloud, o3d.geometry.PointCloud]:
    """A few hundred points of a moved half and of the whole, of which all features are asked for."""
    again = surface(6000, seed=1)
    return cloud(moved(again[again @ [0.6, 0.0, 0.8] > 0])), cloud(surface(6000))


def features(*clouds: o3d.geometry.PointCloud) -> list[registration.Feature]:
    option = fsh.LocalSHDOption(radius=0.5)
    return [fsh.compute_local_shd_feature(cloud, option) for cloud in clouds]


def error(transformation: np.ndarray) -> float:
    """Mean distance of the moved shape, taken back, from where it was."""
    back = moved(surface(500)) @ transformation[:3, :3].T + transformation[:3, 3]
    return float(np.linalg.norm(back - surface(500), axis=1).mean())


def test_ransac_takes_it_for_fpfh() -> None:
    source, target = half_and_whole()
    o3d.utility.random.seed(0)
    found = registration.registration_ransac_based_on_feature_matching(
        source,
        target,
        *features(source, target),
        True,
        0.1,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [registration.CorrespondenceCheckerBasedOnDistance(0.1)],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )
    assert error(found.transformation) < 0.1


def test_fast_global_registration_takes_it_for_fpfh() -> None:
    source, target = half_and_whole()
    o3d.utility.random.seed(0)
    limit = registration.FastGlobalRegistrationOption(maximum_correspondence_distance=0.05)
    found = registration.registration_fgr_based_on_feature_matching(source, target, *features(source, target), limit)
    assert error(found.transformation) < 0.1


def test_correspondences_are_found_by_it() -> None:
    source, target = half_and_whole()
    pairs = np.asarray(registration.correspondences_from_features(*features(source, target), mutual_filter=True))
    apart = np.asarray(source.points)[pairs[:, 0]] - moved(np.asarray(target.points)[pairs[:, 1]])
    assert np.mean(np.linalg.norm(apart, axis=1) < 0.15) > 0.3  # near the cut none can be right


def test_every_kind_of_geometry_has_a_column_a_point() -> None:
    points = surface(2000)
    plain = fsh.compute_local_shd_feature(cloud(points)).data
    tensor = fsh.compute_local_shd_feature(o3d.t.geometry.PointCloud.from_legacy(cloud(points), o3d.core.float64)).data
    inside_out = cloud(points)
    inside_out.normals = o3d.utility.Vector3dVector(-points)
    assert plain.shape == (63, 2000)
    assert plain.dtype == np.float64
    assert np.array_equal(plain, tensor)
    assert np.array_equal(plain, fsh.compute_local_shd_feature(inside_out).data)
    np.testing.assert_allclose(np.linalg.norm(plain, axis=0), 1)


def test_a_mesh_and_a_cloud_of_it_have_like_features() -> None:
    mesh = fsh.read_geometry("samples/hand.ply")
    scan = mesh.sample_points_uniformly(20000)
    option = fsh.LocalSHDOption.common(mesh, scan)
    chosen = np.arange(0, len(mesh.vertices), max(1, len(mesh.vertices) // 100))
    of_mesh = fsh.compute_local_shd_feature(mesh, option, chosen).data
    of_scan = fsh.compute_local_shd_feature(scan, option, np.asarray(mesh.vertices)[chosen]).data
    assert of_mesh.shape == (63, len(chosen))
    own = np.einsum("di,di->i", of_mesh, of_scan)
    assert np.median(own) > 0.98
    assert np.mean((of_mesh.T @ of_scan).argmax(axis=1) == np.arange(len(chosen))) > 0.5  # vertices lie close together


def test_noise_changes_little() -> None:
    points = surface(20000)
    noisy = points + 0.01 * np.random.default_rng(3).normal(size=points.shape)
    chosen = np.arange(100)
    option = fsh.LocalSHDOption(radius=0.5)
    here, there = (fsh.compute_local_shd_feature(cloud(given), option, chosen).data for given in (points, noisy))
    assert np.mean((here.T @ there).argmax(axis=1) == np.arange(100)) > 0.8


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_default_radius_follows_the_unit(scale: float) -> None:
    points = surface(3000)
    here, there = (fsh.compute_local_shd_feature(cloud(given)).data for given in (points, points * scale))
    np.testing.assert_allclose(there, here, atol=1e-4)


def test_points_that_are_not_finite_have_columns_of_zeros() -> None:
    points = surface(3000)
    holes = points.copy()
    holes[::10] = np.nan
    data = fsh.compute_local_shd_feature(cloud(holes)).data
    assert np.count_nonzero(~data.any(axis=0)) == 300
    kept = np.arange(3000) % 10 > 0
    assert np.array_equal(data[:, kept], fsh.compute_local_shd_feature(cloud(points[kept])).data)


def test_duplicates_change_nothing_that_counts() -> None:
    points = surface(3000)
    option = fsh.LocalSHDOption(radius=0.5)
    once = fsh.compute_local_shd_feature(cloud(points), option, np.arange(50)).data
    twice = fsh.compute_local_shd_feature(cloud(np.concatenate((points, points))), option, np.arange(50)).data
    np.testing.assert_allclose(twice, once, atol=1e-5)


@pytest.mark.parametrize(
    "points",
    [
        surface(50),
        np.linspace(0, 1, 300)[:, None] * [1.0, 2.0, 3.0],
        np.concatenate((surface(1000), [[1e6, 0, 0]])),
        surface(1000) * [1, 1, 0],
    ],
    ids=["fifty points", "on a line", "one far away", "flat"],
)
def test_poor_clouds_have_finite_features(points: np.ndarray) -> None:
    data = fsh.compute_local_shd_feature(cloud(points)).data
    assert data.shape == (63, len(points))
    assert np.isfinite(data).all()
    assert data.any()


def test_a_lone_point_has_a_column_of_zeros() -> None:
    data = fsh.compute_local_shd_feature(cloud(np.concatenate((surface(1000), [[50.0, 0, 0]])))).data
    assert not data[:, -1].any()
    assert data[:, :-1].any(axis=0).all()


def test_what_cannot_be_described_is_refused() -> None:
    points = cloud(surface(100))
    with pytest.raises(fsh.GeometryError, match="all points lie in one place"):
        fsh.compute_local_shd_feature(cloud(np.ones((20, 3))))
    with pytest.raises(fsh.GeometryError, match="none of the 5 points is finite"):
        fsh.compute_local_shd_feature(cloud(np.full((5, 3), np.nan)))
    with pytest.raises(fsh.GeometryError, match="no points"):
        fsh.compute_local_shd_feature(o3d.geometry.PointCloud())
    with pytest.raises(ValueError, match="indices 0 … 99 of points, got 0 … 100"):
        fsh.compute_local_shd_feature(points, keypoints=[0, 100])
    with pytest.raises(TypeError, match="integers"):
        fsh.compute_local_shd_feature(points, keypoints=[0.5])
    with pytest.raises(ValueError, match="shape"):
        fsh.compute_local_shd_feature(points, keypoints=np.zeros((4, 2)))
    with pytest.raises(TypeError, match="LocalSHDOption"):
        fsh.compute_local_shd_feature(points, fsh.SHDOption())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="got none"):
        fsh.LocalSHDOption.common()


def test_the_common_radius_is_that_of_the_smallest() -> None:
    small, large = cloud(surface(500)), cloud(3 * surface(500))
    own = fsh.LocalSHDOption.common(small)
    assert fsh.LocalSHDOption.common(large, small) == own
    assert np.array_equal(fsh.compute_local_shd_feature(small, own).data, fsh.compute_local_shd_feature(small).data)


def test_every_run_has_the_same_bytes() -> None:
    points = cloud(surface(2000) @ Rotation.from_euler("x", 0.3).as_matrix())
    assert fsh.compute_local_shd_feature(points).data.tobytes() == fsh.compute_local_shd_feature(points).data.tobytes()
