"""The tetrahedra of a cubic grid: which vertices are simple, and the surface between two labels."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsh3d_o3d.closing import kuhn_grid as grid
from fsh3d_o3d.geometry.measures import measure_mesh


def tetrahedra_at_origin():
    """The 24 tetrahedra around vertex 0, as offsets (24, 4, 3), from the definition: chains of growing corners."""
    chains = []
    for order in itertools.permutations(np.eye(3, dtype=int)):
        chain = np.concatenate((np.zeros((1, 3), dtype=int), np.cumsum(order, axis=0)))
        chains += [chain - corner for corner in chain]
    return np.array(chains)


def test_neighbors_are_those_of_the_tetrahedra():
    corners = {tuple(corner) for corner in tetrahedra_at_origin().reshape(-1, 3)}
    assert corners == {(0, 0, 0), *map(tuple, grid.NEIGHBORS.tolist())}
    assert np.array_equal(grid.structure(), grid.structure()[::-1, ::-1, ::-1])
    assert grid.structure().sum() == 15


def test_vertices_of_equal_parity_are_not_neighbors():
    assert (grid.NEIGHBORS % 2).any(axis=1).all()


def test_simple_vertices_agree_with_the_euler_number():
    """Part of a sphere is a disc if and only if it is connected and of Euler number 1; counted from the triangles."""
    number = {tuple(offset): k for k, offset in enumerate(grid.NEIGHBORS.tolist())}
    faces = [[number[tuple(c)] for c in t.tolist() if any(c)] for t in tetrahedra_at_origin()]
    edges = {tuple(sorted(pair)) for face in faces for pair in itertools.combinations(face, 2)}
    assert (len(faces), len(edges)) == (24, 36)  # with 14 vertices, a sphere: 14 − 36 + 24 = 2
    member = (np.arange(2**14)[:, None] >> np.arange(14) & 1).astype(bool)
    euler = (
        member.sum(axis=1)
        - sum(member[:, list(edge)].all(axis=1).astype(int) for edge in edges)
        + sum(member[:, face].all(axis=1).astype(int) for face in faces)
    )
    reached = member & (np.cumsum(member, axis=1) == 1)  # the first member, then what it reaches
    for _ in range(14):
        for a, b in edges:
            both = member[:, a] & member[:, b] & (reached[:, a] | reached[:, b])
            reached[:, a] |= both
            reached[:, b] |= both
    disc = (euler == 1) & (reached == member).all(axis=1)
    assert np.array_equal(grid.simple_vertices(), disc)
    assert np.array_equal(disc, disc[::-1])  # taking out and putting in are one question


@given(hnp.arrays(bool, (4, 5, 3)), st.integers(0, 2**32 - 1))
def test_any_labels_give_a_manifold(labels, seed):
    body = np.pad(labels, 1)
    body[2, 2, 2] = True
    values = np.random.default_rng(seed).random(body.shape)
    mesh, ends = grid.between(body, values, 0.1)
    measures = measure_mesh(mesh)
    assert measures.closed
    assert measures.vertex_manifold
    assert measures.consistently_oriented
    assert measures.volume > 0
    assert measures.degenerate_triangles == 0
    assert body.ravel()[ends[:, 0]].all()
    assert not body.ravel()[ends[:, 1]].any()


def test_one_vertex_is_surrounded_by_its_link():
    body = np.zeros((3, 3, 3), dtype=bool)
    body[1, 1, 1] = True
    mesh, _ = grid.between(body, np.ones(body.shape), 0.1)
    assert (len(mesh.vertices), len(mesh.triangles)) == (14, 24)
    assert np.allclose(np.sort(mesh.vertices - 1, axis=0), np.sort(grid.NEIGHBORS / 2, axis=0))


@pytest.mark.parametrize("size", [16, 32])
def test_a_ball_is_met_to_second_order(size):
    place = np.indices((size,) * 3) - (size - 1) / 2 + np.array([0.1, 0.2, 0.3])[:, None, None, None]
    radius = 0.35 * size
    field = np.linalg.norm(place, axis=0) - radius
    mesh, _ = grid.between(field < 0, np.abs(field), 1e-3)
    centered = mesh.vertices - (size - 1) / 2 + np.array([0.1, 0.2, 0.3])
    # Along an edge of length √3 the distance is off its chord by at most (√3)²/8r.
    assert np.abs(np.linalg.norm(centered, axis=1) - radius).max() < 3 / 8 / radius
    assert measure_mesh(mesh).genus == 0


def test_the_surface_keeps_clear_of_the_vertices():
    body = np.zeros((4, 4, 4), dtype=bool)
    body[1:3, 1:3, 1:3] = True
    mesh, ends = grid.between(body, np.where(body, 0.0, 1.0), 0.2)
    start, end = (np.stack(np.unravel_index(ends[:, k], body.shape), axis=1) for k in range(2))
    assert np.allclose(mesh.vertices, start + 0.2 * (end - start))
