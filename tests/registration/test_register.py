"""Registration against known similarities, Open3D's own measure, and shapes that have no unique answer."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_mesh, open3d_point_cloud
from fsh3d_o3d.geometry.measures import area_samples
from fsh3d_o3d.registration.fit import Poses, Side, refine, weakest_axis
from fsh3d_o3d.registration.prepared import Prepared, alike
from fsh3d_o3d.registration.surface import plain_surface, shell_coefficients
from fsh3d_o3d.registration.surface import resolved_surface as resolved

SAMPLES = Path(__file__).parents[2] / "samples"


def sample(name: str) -> MeshArrays:
    geometry = read_geometry_arrays(SAMPLES / name, isolated=False)
    assert isinstance(geometry, MeshArrays)
    return geometry


HORN = sample("horn.off")


def resolved_surface(geometry, samples):
    return resolved(plain_surface(geometry, samples))


def similarity(rotation: np.ndarray, scale: float = 1.0, shift: tuple[float, ...] = (0, 0, 0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * rotation, shift
    return matrix


def moved(geometry, matrix):
    points = geometry.vertices if isinstance(geometry, MeshArrays) else geometry.points
    points = points @ matrix[:3, :3].T + matrix[:3, 3]
    return MeshArrays(points, geometry.triangles) if isinstance(geometry, MeshArrays) else PointArrays(points)


def shuffled(mesh: MeshArrays, rng: np.random.Generator) -> MeshArrays:
    """The same surface with triangles in another order, so that samples of it are others."""
    return MeshArrays(mesh.vertices, rng.permutation(mesh.triangles))


def angle(found: np.ndarray, expected: np.ndarray) -> float:
    """Degrees between the rotations of two (4, 4) similarities."""
    first, second = (matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3])) for matrix in (found, expected))
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(first - second) / np.sqrt(8)))))


def farthest(found: np.ndarray, expected: np.ndarray, mesh: MeshArrays) -> float:
    """Largest distance between vertices under two transformations, over the diagonal after the second."""
    first, second = (moved(mesh, matrix).vertices for matrix in (found, expected))
    return float(np.linalg.norm(first - second, axis=1).max() / moved(mesh, expected).diagonal)


@settings(max_examples=10)
@given(
    quaternion=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    scale=st.floats(1e-3, 1e3),
    shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    seed=st.integers(0, 99),
)
def test_finds_any_similarity(quaternion, scale, shift, seed):
    truth = similarity(Rotation.from_quat(quaternion).as_matrix(), scale, shift)
    result = fsh.registration_spherical(HORN, moved(shuffled(HORN, np.random.default_rng(seed)), truth))
    # Two samplings of 4096 points each, some 1 % of the diagonal apart; planes through them do far better than that.
    assert angle(result.transformation, truth) < 0.3
    assert farthest(result.transformation, truth, HORN) < 3e-3
    assert result.scale == pytest.approx(scale, rel=2e-3)
    assert result.confidence > 0.95
    assert result.ambiguity == "none"
    assert not result.reflected
    assert result.fitness == 1


def test_same_samples_are_laid_on_each_other_exactly(random_rotation):
    truth = similarity(random_rotation, 2.5, (1, 2, 3))
    result = fsh.registration_spherical(HORN, moved(HORN, truth))
    np.testing.assert_allclose(result.transformation, truth, atol=1e-6)  # the iteration ends at steps of 1e-5
    assert result.inlier_rmse < 1e-6


@pytest.mark.parametrize("source_kind", ["legacy mesh", "tensor mesh", "legacy cloud", "tensor cloud"])
@pytest.mark.parametrize("target_kind", ["legacy mesh", "tensor cloud"])
def test_takes_meshes_and_clouds_in_any_mix(source_kind, target_kind, rng, random_rotation):
    def made(kind: str, mesh: MeshArrays, seed: int):
        own, what = kind.split()
        if what == "mesh":
            return open3d_mesh(mesh, own)
        return open3d_point_cloud(PointArrays(area_samples(mesh, 5000, seed=seed)[0]), own)

    truth = similarity(random_rotation, 0.7, (5, 0, 0))
    target = moved(shuffled(HORN, rng), truth)
    result = fsh.registration_spherical(made(source_kind, HORN, 1), made(target_kind, target, 2))
    # Normals of clouds are those of sixteen neighbours, as far apart as the horn's ribs.
    assert angle(result.transformation, truth) < 1
    assert farthest(result.transformation, truth, HORN) < 0.01
    assert result.confidence > 0.9


def test_other_meshing_of_the_same_body():
    """samples/README.md: turned by 50° about (1, 2, 3), coarser, boulders missing."""
    axis = np.array([1.0, 2.0, 3.0])
    truth = similarity(Rotation.from_rotvec(np.radians(50) * axis / np.linalg.norm(axis)).as_matrix())
    forward = fsh.registration_spherical(sample("bennu_like.ply"), sample("bennu_like_low.ply"))
    back = fsh.registration_spherical(sample("bennu_like_low.ply"), sample("bennu_like.ply"))
    assert angle(forward.transformation, truth) < 0.5  # the bodies themselves differ by 1 % of the radius
    assert angle(back.transformation, np.linalg.inv(truth)) < 0.5
    assert forward.confidence > 0.9


def test_cloud_of_uneven_density():
    cloud = read_geometry_arrays(SAMPLES / "stone_cloud.xyzn", isolated=False)
    result = fsh.registration_spherical(cloud, sample("stone_degree8.ply"))
    # Twenty times denser on one side; 2000 points, a tenth of the radius apart on the other.
    assert angle(result.transformation, np.eye(4)) < 1
    assert result.confidence > 0.9


def test_outliers_and_a_hole_do_not_pull():
    cloud = read_geometry_arrays(SAMPLES / "bennu_cloud.ply", isolated=False)
    result = fsh.registration_spherical(cloud, sample("bennu_like.ply"))
    assert angle(result.transformation, np.eye(4)) < 1
    assert result.fitness > 0.9  # 5 % are outliers


def test_fitness_is_open3ds(rng, random_rotation):
    target = moved(shuffled(HORN, rng), similarity(random_rotation, 1.3))
    option = fsh.SphericalRegistrationOption(max_correspondence_distance=0.02, polish=False)
    result = fsh.registration_spherical(HORN, target, option)
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for points in (result.source_points, result.target_points)
    ]
    theirs = o3d.pipelines.registration.evaluate_registration(*clouds, 0.02, result.transformation)
    assert 0.1 < result.fitness < 0.99  # the distance is below the spacing of the samples
    # One of 4096 points may lie on the limit, where rounding decides.
    assert result.fitness == pytest.approx(theirs.fitness, abs=1 / 4096)
    assert result.inlier_rmse == pytest.approx(theirs.inlier_rmse, rel=1e-3)
    pairs = {tuple(pair) for pair in result.correspondence_set.tolist()}
    same = pairs & {tuple(pair) for pair in np.asarray(theirs.correspondence_set).tolist()}
    assert len(same) >= len(pairs) - 2
    assert result.correspondence_set.dtype == np.int32


def test_clouds_keep_their_points_and_order(rng):
    points = area_samples(HORN, 6000)[0][rng.permutation(6000)]
    result = fsh.registration_spherical(PointArrays(points), HORN)
    np.testing.assert_array_equal(result.source_points, points)
    assert result.correspondence_set[:, 0].max() > 4096  # all of them are measured, not only those looked at


def test_result_goes_into_open3d(random_rotation):
    source = open3d_mesh(HORN)
    result = fsh.registration_spherical(source, moved(HORN, similarity(random_rotation)))
    turned = np.asarray(source.transform(result.transformation).vertices)
    np.testing.assert_allclose(turned, HORN.vertices @ result.transformation[:3, :3].T + result.transformation[:3, 3])
    assert len(o3d.utility.Vector3dVector(result.source_points)) == len(result.source_points)
    assert len(o3d.utility.Vector2iVector(result.correspondence_set)) == len(result.correspondence_set)


def test_without_scaling_the_result_is_rigid(rng, random_rotation):
    truth = similarity(random_rotation, 1.0, (0, 4, 0))
    option = fsh.SphericalRegistrationOption(with_scaling=False)
    result = fsh.registration_spherical(HORN, moved(shuffled(HORN, rng), truth), option)
    assert result.scale == pytest.approx(1, abs=1e-12)
    linear = result.transformation[:3, :3]
    np.testing.assert_allclose(linear @ linear.T, np.eye(3), atol=1e-12)
    assert angle(result.transformation, truth) < 0.3
    wrong = fsh.registration_spherical(HORN, moved(HORN, similarity(random_rotation, 1.5)), option)
    assert wrong.scale == pytest.approx(1, abs=1e-12)
    assert wrong.confidence < 0.5


def test_reflections_only_where_asked_for_and_needed(rng, random_rotation):
    truth = similarity(random_rotation @ np.diag([1.0, 1.0, -1.0]), 1.5, (1, 0, 0))
    target = moved(shuffled(HORN, rng), truth)
    allowed = fsh.SphericalRegistrationOption(reflections=True)
    mirrored = fsh.registration_spherical(HORN, target, allowed)
    assert mirrored.reflected
    assert angle(mirrored.transformation, truth) < 0.3
    assert mirrored.confidence > 0.9
    turned = fsh.registration_spherical(HORN, target)
    assert not turned.reflected
    assert np.linalg.det(turned.transformation[:3, :3]) > 0
    assert turned.confidence < 0.3
    # A shape that is its own mirror image is turned, not mirrored.
    plain = fsh.registration_spherical(sample("starfish.ply"), sample("starfish.ply"), allowed)
    assert not plain.reflected


def test_polish_brings_surfaces_closer(rng, random_rotation):
    target = moved(shuffled(HORN, rng), similarity(random_rotation))
    rough, fine = (
        fsh.registration_spherical(HORN, target, fsh.SphericalRegistrationOption(polish=polish, samples=1024))
        for polish in (False, True)
    )
    assert fine.inlier_rmse < rough.inlier_rmse
    np.testing.assert_allclose(rough.correlation, fine.correlation)


def cuboid(a: float, b: float, c: float) -> MeshArrays:
    box = o3d.geometry.TriangleMesh.create_box(a, b, c).subdivide_midpoint(4)
    return MeshArrays(np.asarray(box.vertices), np.asarray(box.triangles))


def test_two_fold_symmetry_is_reported(rng, random_rotation):
    box = cuboid(1.0, 0.7, 0.5)  # half turns about three axes: four equal answers
    truth = similarity(random_rotation, 2.0)
    result = fsh.registration_spherical(box, moved(shuffled(box, rng), truth))
    assert result.ambiguity == "discrete"
    assert result.confidence < 0.3
    assert result.fitness == 1
    best = [result.transformation, *(other.transformation for other in result.candidates[:3])]
    turns = [similarity(np.diag(signs)) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    errors = np.array([[angle(found, truth @ turn) for turn in turns] for found in best])
    assert sorted(errors.argmin(axis=1)) == [0, 1, 2, 3]
    assert errors.min(axis=1).max() < 3  # runners-up take a few coarse steps only
    assert all(other.fitness == pytest.approx(1, abs=0.02) for other in result.candidates[:3])


@pytest.mark.parametrize("name", ["vase_quads.obj", "bowl.off"])
def test_axis_of_revolution_is_reported(name, rng, random_rotation):
    truth = similarity(random_rotation)
    result = fsh.registration_spherical(sample(name), moved(shuffled(sample(name), rng), truth))
    assert result.ambiguity == "continuous"
    assert result.confidence < 0.3
    axis = np.array([0.0, 0.0, 1.0])
    assert (result.transformation[:3, :3] @ axis) @ (truth[:3, :3] @ axis) > np.cos(np.radians(1.0)) * result.scale
    assert result.fitness == 1


def test_spheres_are_centred_and_scaled():
    sphere = o3d.geometry.TriangleMesh.create_sphere(1.0, 40)
    larger = o3d.geometry.TriangleMesh.create_sphere(3.0, 33).translate((1, 2, 3))
    result = fsh.registration_spherical(sphere, larger)
    assert result.ambiguity == "continuous"
    assert result.confidence < 0.1
    assert result.correlation == 0
    assert result.candidates == ()
    assert result.scale == pytest.approx(3, rel=5e-3)  # facets of different fineness
    np.testing.assert_allclose(result.transformation[:3, 3], (1, 2, 3), atol=0.02)


def test_different_shapes_have_low_confidence():
    assert fsh.registration_spherical(HORN, sample("starfish.ply")).confidence < 0.1


def test_a_half_finds_its_place(random_rotation):
    middles = HORN.vertices[HORN.triangles].mean(axis=1)[:, 0]
    half = MeshArrays(HORN.vertices, HORN.triangles[middles > np.median(middles)])
    truth = similarity(random_rotation, 1.0, (3, 1, 2))
    result = fsh.registration_spherical(moved(half, truth), HORN)
    assert angle(result.transformation, np.linalg.inv(truth)) < 2
    assert result.confidence > 0.9
    assert result.overlap[0] > 0.9
    assert 0.4 < result.overlap[1] < 0.6


def test_flat_sheets_work(random_rotation):
    corners = np.array([[0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 2, 0]], dtype=float)
    sheet = MeshArrays(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    other = MeshArrays(corners, np.array([[1, 2, 3], [1, 3, 0]]))
    truth = similarity(random_rotation, 0.5, (1, 1, 1))
    result = fsh.registration_spherical(sheet, moved(other, truth))
    # Nothing but its rim holds a sheet in its plane, and samples know that to their spacing.
    assert farthest(result.transformation, truth, sheet) < 0.01


def test_points_on_a_line_turn_freely_about_it():
    line = np.linspace(0, 1, 50)[:, None]
    result = fsh.registration_spherical(PointArrays(line * [1, 2, 2]), PointArrays(line * [0, 0, 6.0]))
    assert result.ambiguity == "continuous"
    assert result.scale == pytest.approx(2, rel=0.02)  # a few fiftieths of the line
    assert abs(result.transformation[2, :3] @ [1, 2, 2]) / 3 == pytest.approx(result.scale, rel=1e-3)


@pytest.mark.parametrize("factor", [1e-100, 1e100])
def test_any_unit_will_do(factor):
    result = fsh.registration_spherical(MeshArrays(HORN.vertices * factor, HORN.triangles), HORN)
    np.testing.assert_allclose(result.transformation[:3, :3] * factor, np.eye(3), atol=1e-5)


def test_same_input_same_bytes(rng, random_rotation):
    target = moved(shuffled(HORN, rng), similarity(random_rotation))
    results = [fsh.registration_spherical(HORN, target) for _ in range(3)]
    assert len({result.transformation.tobytes() for result in results}) == 1
    assert len({result.confidence for result in results}) == 1


GOOD = HORN
ONE_POINT = PointArrays(np.zeros((4, 3)))
NO_AREA = MeshArrays(np.arange(9.0).reshape(3, 3), np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    ("bad", "error", "message"),
    [
        (None, TypeError, "geometry must be"),
        (np.zeros((5, 3)), fsh.GeometryError, "no extent"),
        (o3d.geometry.PointCloud(), fsh.GeometryError, "empty"),
        (o3d.t.geometry.TriangleMesh(), fsh.GeometryError, "empty"),
        (o3d.geometry.PointCloud(o3d.utility.Vector3dVector([[0, 0, np.nan]])), fsh.GeometryError, "finite"),
        (ONE_POINT, fsh.GeometryError, "no extent"),
        (NO_AREA, fsh.GeometryError, "no area"),
    ],
    ids=["none", "array", "empty cloud", "empty mesh", "nan", "one point", "no area"],
)
def test_bad_geometry_is_named(bad, error, message):
    with pytest.raises(error, match=f"source: .*{message}"):
        fsh.registration_spherical(bad, GOOD)
    with pytest.raises(error, match=f"target: .*{message}"):
        fsh.registration_spherical(GOOD, bad)


@pytest.mark.parametrize(
    ("field", "value", "error"),
    [
        ("with_scaling", 1, TypeError),
        ("reflections", "yes", TypeError),
        ("polish", None, TypeError),
        ("max_correspondence_distance", 0.0, ValueError),
        ("max_correspondence_distance", np.nan, ValueError),
        ("candidates", 0, ValueError),
        ("candidates", 2.5, TypeError),
        ("bandwidth", 3, ValueError),
        ("bandwidth", 33, ValueError),
        ("samples", 10, ValueError),
    ],
)
def test_bad_options_are_refused(field, value, error):
    with pytest.raises(error, match=field):
        fsh.SphericalRegistrationOption(**{field: value})


def test_options_are_frozen_and_checked():
    with pytest.raises(dataclasses.FrozenInstanceError):
        fsh.SphericalRegistrationOption().polish = False  # type: ignore[misc]
    with pytest.raises(TypeError, match="SphericalRegistrationOption"):
        fsh.registration_spherical(HORN, HORN, {"polish": False})  # type: ignore[arg-type]


def test_walls_twice_as_thick_do_not_move_the_frame():
    """Area doubled on one side shifts the centroid of the area, but not that of what can be seen."""
    far = HORN.vertices[HORN.triangles].mean(axis=1)[:, 0] > 0
    doubled = MeshArrays(HORN.vertices, np.concatenate((HORN.triangles, HORN.triangles[far])))
    plain, other = resolved_surface(HORN, 4096), resolved_surface(doubled, 4096)
    area = HORN.vertices[HORN.triangles]
    weight = np.linalg.norm(np.cross(area[:, 1] - area[:, 0], area[:, 2] - area[:, 0]), axis=1)
    middle = area.mean(axis=1)
    shift = np.linalg.norm(
        np.average(middle, axis=0, weights=weight * (1 + far)) - np.average(middle, axis=0, weights=weight)
    )
    # At the seam between one wall and two the density is in between.
    assert np.linalg.norm(other.centroid - plain.centroid) < 0.15 * shift
    assert other.rms_radius == pytest.approx(plain.rms_radius, rel=0.02)


def test_strays_are_left_out(rng):
    points = area_samples(HORN, 3000)[0]
    strays = rng.uniform(-4, 4, (60, 3))
    clean, dirty = (resolved_surface(PointArrays(cloud), 4096) for cloud in (points, np.concatenate((points, strays))))
    assert np.linalg.norm(clean.centroid - dirty.centroid) < 0.03 * clean.rms_radius
    assert dirty.rms_radius == pytest.approx(clean.rms_radius, rel=0.05)


def test_large_clouds_are_thinned_whatever_their_order(rng):
    points = area_samples(HORN, 9000)[0]
    first, second = (resolved_surface(PointArrays(cloud), 2048) for cloud in (points, rng.permutation(points)))
    assert len(first.points) <= 2048
    np.testing.assert_array_equal(first.points, second.points)


def test_coefficients_turn_with_the_surface(rng, random_rotation):
    turned = moved(shuffled(HORN, rng), similarity(random_rotation))
    one, other = (shell_coefficients(resolved_surface(mesh, 4096), 8) for mesh in (HORN, turned))
    difference = fsh.rotate_coefficients(one, random_rotation) - other
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(other)  # voxels of a tenth of the RMS radius


def test_poses_and_their_inverses(rng):
    poses = Poses(Rotation.random(3, rng=rng).as_matrix(), np.array([0.5, 1.0, 2.0]), rng.standard_normal((3, 3)))
    points = rng.standard_normal((7, 3))
    expected = [s * points @ r.T + t for r, s, t in zip(poses.rotations, poses.scales, poses.shifts, strict=True)]
    np.testing.assert_allclose(poses.apply(points), expected, atol=1e-14)
    there = poses.apply(points)
    for k in range(3):
        np.testing.assert_allclose(poses.undo(there[k])[k], points, atol=1e-14)


def test_refining_climbs_from_nearby_poses(rng):
    surface = resolved_surface(HORN, 4096)
    side = Side.of(surface, 512)
    offsets = Rotation.from_rotvec(np.radians([[5, 0, 0], [0, -6, 0], [3, 3, 3]])).as_matrix()
    start = Poses(offsets, np.array([1.04, 0.97, 1.0]), 0.05 * rng.standard_normal((3, 3)))
    found = refine(side, side, start, probes=512, steps=30, scaling=True)
    np.testing.assert_allclose(found.rotations, np.broadcast_to(np.eye(3), (3, 3, 3)), atol=1e-4)
    np.testing.assert_allclose(found.scales, 1, atol=1e-4)
    np.testing.assert_allclose(found.shifts, 0, atol=1e-4)
    rigid = refine(side, side, start, probes=512, steps=5, scaling=False)
    np.testing.assert_array_equal(rigid.scales, start.scales)


def test_weakest_axis_is_that_of_revolution():
    side = Side.of(resolved_surface(sample("vase_quads.obj"), 4096), 512)
    axis = weakest_axis(side, side, Poses.centred(np.eye(3)[None], 1.0), probes=512)
    assert abs(axis[2]) > 0.999  # 36 flat sides around the axis hold it a little


@pytest.mark.parametrize("name", ["horn.off", "hand.ply", "starfish_posed.ply", "trefoil_knot.ply"])
def test_a_cloud_is_as_large_as_the_mesh_it_was_taken_from(name):
    mesh = sample(name)
    points = area_samples(mesh, 10000)[0]
    turned = PointArrays(points @ Rotation.from_euler("xyz", [0.3, 1.0, -2.0]).as_matrix().T)
    result = fsh.registration_spherical(turned, mesh)
    assert result.scale == pytest.approx(1, abs=0.01)


def test_wires_that_a_cloud_hardly_shows_do_not_hide_its_size(random_rotation):
    parts = [MeshArrays(*fsh.icosphere(3))]
    for axis, length in enumerate((2.0, 3.0, 4.0)):
        box = o3d.geometry.TriangleMesh.create_box(length, 0.005, 0.005)
        vertices = np.roll(np.asarray(box.vertices), axis, axis=1)
        parts.append(MeshArrays(vertices, np.asarray(box.triangles)))
    first = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    triangles = [part.triangles + start for part, start in zip(parts, first, strict=True)]
    mesh = MeshArrays(np.concatenate([part.vertices for part in parts]), np.concatenate(triangles))
    truth = similarity(random_rotation, 1.8, (3, -2, 1))
    cloud = moved(PointArrays(area_samples(mesh, 2000, seed=1)[0]), truth)
    assert not alike(Prepared.of(mesh, 4096, "source"), Prepared.of(cloud, 4096, "target"), scaling=True)
    result = fsh.registration_spherical(mesh, cloud)
    assert result.scale == pytest.approx(1.8, rel=0.01)
    assert angle(result.transformation, truth) < 1
