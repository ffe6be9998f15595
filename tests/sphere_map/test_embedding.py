"""The coarse-to-fine embedding is valid on every level of every mesh; placements are the deepest points of kernels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh, weld
from fsh3d_o3d.sphere_map import embedding as _embedding
from fsh3d_o3d.sphere_map import relaxation
from fsh3d_o3d.sphere_map.embedding import EmbeddingError, embed, place
from fsh3d_o3d.sphere_map.hierarchy import Stars
from fsh3d_o3d.sphere_map.validity import degree, distortion, is_valid, orientations, solid_angles
from tests.geometry import mesh_shapes
from tests.sphere_map import closed_surfaces as surfaces


def meshes(rng):
    return {
        "tetrahedron": surfaces.tetrahedron(),
        "inside out": (surfaces.tetrahedron()[0], surfaces.tetrahedron()[1][:, ::-1]),
        "ball": surfaces.ball(),
        "rod": surfaces.rod(),
        "comb": surfaces.comb(),
        "needle": surfaces.needle(),
        "prism": surfaces.prism(),
        "bipyramid of 3": surfaces.bipyramid(3),
        "bipyramid": surfaces.bipyramid(),
        "stacked": surfaces.stacked(rng),
        "nested": surfaces.stacked(rng, nested=True),
        "point": surfaces.point(),
        "scrambled": surfaces.scrambled(rng),
    }


@pytest.mark.parametrize("name", sorted(meshes(np.random.default_rng(0))))
def test_every_level_is_valid(rng, name):
    vertices, triangles = meshes(rng)[name]
    counts = []

    def checked(level_vertices, level_triangles, sphere):
        assert len(level_vertices) == len(sphere)
        assert is_valid(sphere, level_triangles)
        relaxed = relaxation.relax(level_vertices, level_triangles, sphere)
        # Far from what float64 can hold: the smallest triangle of 1000 would be 1e-10 of the sphere.
        assert orientations(relaxed, level_triangles).min() * len(level_triangles) > 1e-7
        assert degree(relaxed, level_triangles) == 1
        counts.append(len(sphere))
        return relaxed

    sphere = embed(vertices, triangles, relax=checked)
    assert counts[0] == 4 and counts[-1] == len(vertices)
    assert is_valid(sphere, triangles)
    assert np.abs(np.linalg.norm(sphere, axis=1) - 1).max() < 1e-15 * 2  # the rounding of one division
    assert np.array_equal(sphere, embed(vertices, triangles))


@pytest.mark.parametrize("name", ["horn.off", "gem.stl"])
def test_samples_are_valid(name):
    _assert_embedded(read_geometry_arrays(Path(__file__).parents[2] / "samples" / name))


@pytest.mark.parametrize("shape", ["box", "ell", "u_shape", "screw", "waisted", "hull", "soup"])
def test_designed_and_simplified_shapes_are_valid(shape):
    """What libraries hold: few and large faces beside each other, arms, waists, slivers, vertices of their own."""
    made = {
        "waisted": lambda: _waisted(mesh_shapes.ellipsoid((1, 1, 4), 12)),
        "hull": lambda: _hull(np.random.default_rng(3).standard_normal((400, 3)) * (1, 3, 0.3)),
        "soup": lambda: mesh_shapes.soup(mesh_shapes.bumpy(10)),
    }
    _assert_embedded(made.get(shape, getattr(mesh_shapes, shape, None))())


def test_limbs_get_their_share():
    vertices, triangles = surfaces.comb(teeth=4, length=12)
    sphere = embed(vertices, triangles)
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    fingertips = (corners[:, :, 2] > 9).any(axis=1)
    share = solid_angles(sphere, triangles)[fingertips].sum() / (4 * np.pi)
    # A conformal map shrinks a finger, a tube 4 around, by e^(2π/4) a unit: the upper third of 12 to some 1e-10.
    assert share > area[fingertips].sum() / area.sum() / 10


def test_a_ball_stays_even():
    vertices, triangles = surfaces.ball(16)
    measured = distortion(vertices, triangles, embed(vertices, triangles))
    # Exact would be 1 and 0; the order of decimation leaves a trace of a few percent.
    assert measured.mean < 1.2
    assert measured.area < 0.25


def test_the_embedding_follows_the_pose(random_rotation):
    mesh = mesh_shapes.bumpy(12)
    vertices, triangles = np.array(mesh.vertices), np.array(mesh.triangles)
    sphere = embed(vertices, triangles)
    # Exact in floating point: a quarter turn about z and a shift by whole numbers of rounding units.
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = embed(vertices @ quarter.T, triangles)
    # Rounding of sums in another order may choose other collapses among equals; on the whole the directions agree.
    assert np.einsum("ij,ij->i", turned, sphere @ quarter.T).mean() > 0.99
    assert np.einsum("ij,ij->i", sphere, vertices / np.linalg.norm(vertices, axis=1)[:, None]).mean() > 0.95


def test_unrelaxed_embedding_is_valid_while_float64_lasts():
    vertices, triangles = surfaces.ball(8)
    assert is_valid(embed(vertices, triangles, relax=lambda vertices, triangles, sphere: sphere), triangles)


def test_no_room_is_an_error():
    def crowded(vertices, triangles, sphere):
        """The map drawn towards the north pole, which keeps triangles valid until differences have no digit left."""
        x, y, z = sphere.T
        x, y, z = x / 30, y / 30, ((1 + z) - (1 - z) / 900) / 2
        moved = np.column_stack((x, y, z))  # of length (1 + z + (1 − z) / 900) / 2: stereographic coordinates over 30
        return moved / np.linalg.norm(moved, axis=1)[:, None]

    vertices, triangles = surfaces.ball(8)
    with pytest.raises(EmbeddingError, match=r"turned over .* worst determinant"):
        embed(vertices, triangles, relax=crowded)


@pytest.mark.parametrize("broken", [lambda sphere: -sphere, lambda sphere: sphere * np.nan])
def test_a_relaxation_that_breaks_the_map_is_an_error(broken):
    vertices, triangles = surfaces.ball(4)
    with pytest.raises(EmbeddingError, match="relaxing turned over"):
        embed(vertices, triangles, relax=lambda vertices, triangles, sphere: broken(sphere))


@pytest.mark.parametrize("d", [3, 4, 6, 9])
def test_place_finds_the_deepest_point(rng, d):
    angle = np.sort(rng.random(d) + np.arange(d)) * 2 * np.pi / d
    radius = 0.1 + 0.5 * rng.random(d)
    ring = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.ones(d)))
    ring /= np.linalg.norm(ring, axis=1)[:, None]
    found = place(Stars(np.array([d]), np.arange(d)[None]), ring)[0]
    normals = np.cross(ring, np.roll(ring, -1, axis=0))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert np.linalg.norm(found) == pytest.approx(1, abs=1e-15)  # the rounding of one division
    # The oracle: the shortest x with n · x >= 1, a convex problem, for which SLSQP stops at about 1e-8.
    oracle = minimize(
        lambda x: x @ x / 2,
        np.array([0.0, 0.0, 1.0]) / (normals[:, 2].min() / 2),
        jac=lambda x: x,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: normals @ x - 1, "jac": lambda x: normals},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert (normals @ found).min() == pytest.approx(1 / np.linalg.norm(oracle.x), rel=1e-6)


def test_place_works_in_chunks(monkeypatch):
    vertices, triangles = surfaces.ball(6)
    whole = embed(vertices, triangles)
    monkeypatch.setattr(_embedding, "_CHUNK", 1000)
    assert np.array_equal(embed(vertices, triangles), whole)


def _assert_embedded(geometry):
    mesh = weld(geometry)
    measured = measure_mesh(mesh)
    assert measured.outward and measured.genus == 0, "no shape that the embedding is for"
    triangles = np.array(mesh.triangles)
    assert is_valid(embed(np.array(mesh.vertices), triangles), triangles)


def _waisted(mesh):
    """Drawn in to a tenth halfway along z, where the narrowest ring of triangles is."""
    height = mesh.vertices[:, 2:] / np.abs(mesh.vertices[:, 2]).max()
    return MeshArrays(mesh.vertices * np.where([True, True, False], 0.1 + 0.9 * height**2, 1), mesh.triangles)


def _hull(points):
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return MeshArrays(points, np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices))
