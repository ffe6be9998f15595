"""Distances of aligned shapes, and rankings by them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsh3d_o3d.descriptors.library import SHDDescriptor
from fsh3d_o3d.descriptors.shd import SHDOption, compute_signature, shd_descriptor
from fsh3d_o3d.descriptors.signature_distance import fits_only_mirrored, mixed_distances, signature_distances
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.rotation.rotation import rotate_coefficients
from tests.geometry.mesh_shapes import bumpy, ell, screw, torus, u_shape

ROTATIONS = Rotation.random(5, random_state=1).as_matrix()
OPTION = SHDOption(bandwidth=8, shells=8, widths=(0.3,), voxels=32)


def functions(count, seed=0, rows=3, bandwidth=5):
    degree = degrees_and_orders(bandwidth)[0]
    values = np.random.default_rng(seed).standard_normal((count, rows, bandwidth**2)) / (1 + degree)
    return values / np.linalg.norm(values, axis=(1, 2), keepdims=True)


def turned(mesh, rotation, scale=1.0):
    return MeshArrays(scale * mesh.vertices @ rotation.T + 3, mesh.triangles)


def test_rotated_copies_are_at_zero_and_their_rotations_are_found():
    (shape,) = functions(1)
    copies = np.stack([rotate_coefficients(shape, rotation) for rotation in ROTATIONS])
    distances, rotations = signature_distances(shape, copies)
    # A root of coefficients magnifies what three Newton steps leave of the angle.
    assert distances.max() < 1e-3
    np.testing.assert_allclose(rotations @ ROTATIONS, np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-4)


def test_distances_are_symmetric_and_bounded():
    shapes = functions(12, seed=1)
    table = np.stack([signature_distances(shape, shapes)[0] for shape in shapes])
    np.testing.assert_allclose(table, table.T, atol=1e-9)  # both sides climb to the same maximum
    assert np.diag(table).max() < 1e-6
    assert (table + 3 * np.eye(12) > 0.1).all()
    assert table.max() <= 2


def test_threads_give_the_same_bytes():
    shapes = functions(150, seed=2)
    one, two = (signature_distances(shapes[0], shapes, threads=threads) for threads in (1, 2))
    assert one[0].tobytes() == two[0].tobytes()
    assert one[1].tobytes() == two[1].tobytes()


def test_zero_coefficients_are_far_from_everything_else():
    shapes = functions(3)
    shapes[1] = 0
    distances, rotations = signature_distances(shapes[0], shapes)
    assert distances[1] == pytest.approx(2)
    assert np.isfinite(rotations).all()


@pytest.mark.parametrize(
    ("query", "candidates", "message"),
    [
        (np.ones(25), np.ones((2, 3, 25)), "must have shape"),
        (np.ones((3, 25)), np.ones((3, 25)), "must have shape"),
        (np.ones((3, 25)), np.ones((2, 4, 25)), "must have shape"),
        (np.ones((3, 25)), np.full((2, 3, 25), np.inf), "finite"),
    ],
)
def test_wrong_shapes_are_refused(query, candidates, message):
    with pytest.raises(ValueError, match=message):
        signature_distances(query, candidates)


def test_signature_holds_the_feature_and_a_frame_that_follows_the_shape():
    mesh, rotation = bumpy(), ROTATIONS[0]
    one, other = compute_signature(mesh, OPTION, bandwidth=6), compute_signature(turned(mesh, rotation, 2.0), OPTION)
    np.testing.assert_array_equal(one.feature, shd_descriptor(mesh, OPTION))
    assert one.coefficients.shape == (8, 36)
    assert other.coefficients.shape == (8, 64)
    assert np.linalg.norm(one.coefficients) == pytest.approx(1, rel=1e-6)  # float32
    assert np.linalg.det(one.axes) == pytest.approx(1)
    assert other.rms_radius == pytest.approx(2 * one.rms_radius, rel=1e-9)
    np.testing.assert_allclose(other.centroid, 2 * one.centroid @ rotation.T + 3, rtol=1e-9)
    # The same axes in space, up to signs.
    turn = other.axes @ rotation @ one.axes.T
    np.testing.assert_allclose(np.abs(turn), np.eye(3), atol=1e-6)
    # And the same coefficients up to those half turns; the rest is voxels.
    back = rotate_coefficients(one.coefficients, np.round(turn))
    assert np.linalg.norm(back - other.coefficients[:, :36]) < 0.03


def test_reranking_keeps_the_rest_behind_and_finds_rotated_copies():
    meshes = [bumpy(), ell(), u_shape(), torus()]
    shapes = [*meshes, *(turned(mesh, rotation) for mesh, rotation in zip(meshes, ROTATIONS, strict=False))]
    plain, again = SHDDescriptor(OPTION), SHDDescriptor(OPTION, rerank=3)
    assert plain.fingerprint != again.fingerprint
    features = np.stack([plain.describe(shape) for shape in shapes])
    vectors = np.stack([again.describe(shape) for shape in shapes])
    np.testing.assert_array_equal(vectors[:, : features.shape[1]], features)
    before, after = plain.distances(features, features), again.distances(vectors, vectors)
    for row in range(8):
        near = set(np.argsort(before[row], kind="stable")[:4])  # itself and three
        assert set(np.argsort(after[row], kind="stable")[:4]) == near
        assert np.argsort(after[row])[1] == (row + 4) % 8
    # One set against itself takes each pair once and leaves out the shape itself; against a copy, neither.
    both = SHDDescriptor(OPTION, rerank=4).distances(vectors, vectors.copy())
    np.testing.assert_allclose(both[:4, 4:], after[:4, 4:], atol=1e-6)


def test_everything_may_be_reranked_and_the_mix_is_even():
    vectors = np.stack([SHDDescriptor(OPTION, rerank=9).describe(mesh) for mesh in (bumpy(), ell(), torus())])
    table = SHDDescriptor(OPTION, rerank=9).distances(vectors, vectors)
    np.testing.assert_allclose(table, table.T, atol=1e-12)
    assert table.max() <= 2
    np.testing.assert_allclose(mixed_distances(np.array([1.0]), np.array([0.5])), [0.75])


@pytest.mark.parametrize("rerank", [0, -1, 2.5, True])
def test_wrong_numbers_of_candidates_are_refused(rerank):
    with pytest.raises((TypeError, ValueError), match="rerank"):
        SHDDescriptor(OPTION, rerank=rerank)


def mirrored(mesh):
    return MeshArrays(mesh.vertices * [1, 1, -1], mesh.triangles[:, ::-1])


def coefficients(mesh):
    return compute_signature(mesh, OPTION, bandwidth=8).coefficients


def test_left_and_right_are_told_from_copies():
    copies = [turned(screw(), rotation, 1.7) for rotation in ROTATIONS]
    others = [turned(mirrored(screw()), rotation, 0.6) for rotation in ROTATIONS]
    for own, expected in ((screw(), [False] * 5 + [True] * 5), (mirrored(screw()), [True] * 5 + [False] * 5)):
        found = fits_only_mirrored(coefficients(own), np.stack([coefficients(mesh) for mesh in (*copies, *others)]))
        assert found.tolist() == expected


@pytest.mark.parametrize("symmetric", [ell, torus, u_shape])
def test_symmetric_shapes_are_not_mirror_images(symmetric):
    copies = [turned(mirrored(symmetric()), rotation) for rotation in ROTATIONS]
    found = fits_only_mirrored(coefficients(symmetric()), np.stack([coefficients(mesh) for mesh in copies]))
    assert not found.any()


def test_what_does_not_depend_on_direction_is_not_mirrored():
    assert not fits_only_mirrored(np.zeros((2, 16)), np.zeros((3, 2, 16))).any()
    with pytest.raises(ValueError, match="candidates must have shape"):
        fits_only_mirrored(np.zeros((2, 16)), np.zeros((3, 2, 9)))
