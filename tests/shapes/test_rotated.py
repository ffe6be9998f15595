"""Rotated shapes, and canonical poses of shapes."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_mesh
from fsh3d_o3d.geometry.surface_comparison import surface_error
from tests.geometry.mesh_shapes import box, sphere, torus

CENTER = np.array([3.0, -1.0, 2.0])


def lump(count: int = 24) -> MeshArrays:
    """A star-shaped surface without symmetry, about a centre away from the origin."""
    ball = sphere(count)
    directions = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    bumps = np.array([[1, 0.2, 0.1], [-0.3, 1, 0.2], [0.1, -0.4, 1], [-0.7, -0.6, 0.2]])
    radius = 1 + np.exp(3 * (directions @ bumps.T - 1)) @ [0.9, 0.5, 0.3, 0.2]
    return MeshArrays(CENTER + radius[:, None] * directions, ball.triangles)


def turned(mesh: MeshArrays, rotation: np.ndarray, center: np.ndarray) -> MeshArrays:
    return MeshArrays(center + (mesh.vertices - center) @ rotation.T, mesh.triangles)


@functools.cache
def shapes() -> dict[str, fsh.RadialShape | fsh.ShellShape]:
    return {
        "radial": fsh.RadialShape.from_geometry(lump(), 16),
        "shells": fsh.ShellShape.from_geometry(lump(), 12, 24, "signed_distance"),
    }


@pytest.fixture(scope="module", params=["radial", "shells"])
def shape(request: pytest.FixtureRequest) -> fsh.RadialShape | fsh.ShellShape:
    return shapes()[request.param]


def test_decodes_to_the_rotated_surface(shape: fsh.RadialShape | fsh.ShellShape, random_rotation: np.ndarray) -> None:
    resolution = 4000 if isinstance(shape, fsh.RadialShape) else 48
    expected = turned(shape.mesh_arrays(resolution)[0], random_rotation, shape.center)
    found = shape.rotated(random_rotation).mesh_arrays(resolution)[0]
    # The same surface cut into other triangles: facets lie up to (edge length)² / 8 apart.
    limit = 5e-4 if isinstance(shape, fsh.RadialShape) else 3e-3
    assert surface_error(expected, found, samples=4000).relative().maximum < limit


def test_is_the_shape_of_the_rotated_mesh(random_rotation: np.ndarray) -> None:
    shape = fsh.RadialShape.from_geometry(lump(), 16, center=CENTER)
    rotated = fsh.RadialShape.from_geometry(turned(lump(), random_rotation, CENTER), 16, center=CENTER)
    # Facets have degrees beyond 16, which alias as the grid lies.
    scale = np.linalg.norm(shape.coefficients)
    assert np.linalg.norm(shape.rotated(random_rotation).coefficients - rotated.coefficients) < 2e-3 * scale
    shells = fsh.ShellShape.from_geometry(lump(), 12, 16, "signed_distance", center=CENTER)
    again = fsh.ShellShape.from_geometry(
        turned(lump(), random_rotation, CENTER), 12, 16, "signed_distance", center=CENTER
    )
    scale = np.linalg.norm(shells.coefficients)
    assert np.linalg.norm(shells.rotated(random_rotation).coefficients - again.coefficients) < 5e-3 * scale


def test_radial_function_turns(random_rotation: np.ndarray) -> None:
    shape = shapes()["radial"]
    assert isinstance(shape, fsh.RadialShape)
    directions = fsh.fibonacci_grid(100).directions
    rotated = shape.rotated(random_rotation)
    assert rotated.evaluate(directions @ random_rotation.T) == pytest.approx(shape.evaluate(directions), rel=1e-12)
    # Colours or labels sampled by direction follow by the same map of directions.
    assert rotated.volume == pytest.approx(shape.volume, rel=1e-12)


def test_field_turns_about_the_centre(random_rotation: np.ndarray, rng: np.random.Generator) -> None:
    shape = shapes()["shells"]
    assert isinstance(shape, fsh.ShellShape)
    offsets = rng.uniform(-0.5, 0.5, (200, 3))
    rotated = shape.rotated(random_rotation).evaluate(shape.center + offsets @ random_rotation.T)
    assert rotated == pytest.approx(shape.evaluate(shape.center + offsets), abs=2e-5)  # float32


def test_frame_and_kind_stay(shape: fsh.RadialShape | fsh.ShellShape, random_rotation: np.ndarray) -> None:
    rotated = shape.rotated(random_rotation)
    assert type(rotated) is type(shape)
    for name in ("center", "kind", "field", "scale", "width", "radii"):
        if hasattr(shape, name):
            assert np.array_equal(getattr(rotated, name), getattr(shape, name))
    assert not rotated.coefficients.flags.writeable
    before, after = shape.compute_feature().data, rotated.compute_feature().data
    assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()


def test_composes_and_goes_back(shape: fsh.RadialShape | fsh.ShellShape, rng: np.random.Generator) -> None:
    one, two = Rotation.random(2, rng=rng).as_matrix()
    scale = np.abs(shape.coefficients).max()
    twice, once = shape.rotated(one).rotated(two), shape.rotated(two @ one)
    assert np.abs(twice.coefficients - once.coefficients).max() < 1e-12 * scale
    back = shape.rotated(one).rotated(one.T)
    assert np.abs(back.coefficients - shape.coefficients).max() < 1e-12 * scale


def test_files(shape: fsh.RadialShape | fsh.ShellShape, random_rotation: np.ndarray, tmp_path) -> None:
    rotated = shape.rotated(random_rotation)
    rotated.save(tmp_path / "shape.npz")
    again = fsh.load_shape(tmp_path / "shape.npz")
    assert type(again) is type(shape)
    assert again.coefficients.tobytes() == rotated.coefficients.tobytes()


@pytest.mark.parametrize("rotation", [np.eye(2), -np.eye(3), 2 * np.eye(3), np.full((3, 3), np.nan)])
def test_what_is_no_rotation_is_refused(shape: fsh.RadialShape | fsh.ShellShape, rotation: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rotation must"):
        shape.rotated(rotation)


def test_canonical_pose_is_the_same_from_any_rotation(rng: np.random.Generator) -> None:
    for make in (
        lambda mesh: fsh.RadialShape.from_geometry(mesh, 12),
        lambda mesh: fsh.ShellShape.from_geometry(mesh, 12, 16),
    ):
        mesh = lump(16)
        pose = fsh.canonical_rotation(make(mesh))
        assert pose.margin > 0.01
        assert not pose.symmetries.is_symmetric
        for rotation in Rotation.random(2, rng=rng).as_matrix():
            other = fsh.canonical_rotation(make(turned(mesh, rotation, np.zeros(3))))
            between = Rotation.from_matrix(other.rotation @ rotation @ pose.rotation.T)
            assert np.degrees(between.magnitude()) < 1.0  # what the contract allows; sampling leaves about 0.1


def test_canonical_pose_of_coefficients_shapes_and_geometry() -> None:
    shape = shapes()["radial"]
    pose = fsh.canonical_rotation(shape)
    assert np.array_equal(fsh.canonical_rotation(shape.coefficients).rotation, pose.rotation)
    assert np.array_equal(shape.rotated(pose).coefficients, shape.rotated(pose.rotation).coefficients)


def test_symmetric_shapes_are_reported() -> None:
    ring = fsh.canonical_rotation(fsh.ShellShape.from_geometry(torus(), 12, 16))
    assert ring.symmetries.of_revolution
    assert abs(ring.symmetries.axes[0].direction[2]) > 0.9999
    brick = fsh.canonical_rotation(fsh.ShellShape.from_geometry(box((1.0, 1.4, 0.8)), 12, 16))
    assert sorted(axis.order for axis in brick.symmetries.axes) == [2, 2, 2]
    assert brick.margin < 0.01


def test_spheres_have_no_pose() -> None:
    with pytest.raises(ValueError, match="constant on the sphere"):
        fsh.canonical_rotation(fsh.RadialShape(np.array([2.0, 0, 0, 0]), np.zeros(3)))


@pytest.mark.parametrize("thing", ["bunny", None, open3d_mesh(sphere(3), "legacy"), PointArrays(np.eye(3))])
def test_other_things_have_none_either(thing: object) -> None:
    with pytest.raises(TypeError, match="RadialShape, ShellShape or coefficients"):
        fsh.canonical_rotation(thing)
