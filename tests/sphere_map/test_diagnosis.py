import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.sphere_map.conformal_map import conformal_map
from fsh3d_o3d.sphere_map.diagnosis import closed_surface, mapping_obstacles
from tests.geometry import mesh_shapes as shapes


def klein_bottle(n=24, m=12):
    """The figure-eight immersion: closed, manifold as indexed, one-sided."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    u, v = 2 * np.pi * i / n, 2 * np.pi * (j + 0.25) / m
    rho = 3 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    height = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    vertices = np.column_stack((rho * np.cos(u), rho * np.sin(u), height))

    def at(a, b):
        # Once round the bottle the eight comes back turned by half a turn: v → −v.
        return (a % n) * m + np.where(a == n, -1 - b, b) % m

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return MeshArrays(vertices, np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d)))))


def pinched():
    """A sphere with two far vertices at one place: genus 0 as indexed, not manifold once welded."""
    mesh = shapes.bumpy(6)
    vertices = mesh.vertices.copy()
    far = int(np.argmin(vertices @ vertices[0]))
    vertices[far] = vertices[0]
    return MeshArrays(vertices, mesh.triangles)


def touching():
    """Two cubes that share one corner."""
    return shapes.joined(shapes.box(), shapes.moved(shapes.box(), offset=(1, 1, 1)))


def fan_of_three():
    """A box with a third triangle at one edge, and its twin behind it."""
    box = shapes.box()
    return MeshArrays(np.vstack((box.vertices, [[3, 3, 3]])), np.vstack((box.triangles, [[0, 1, 8], [1, 0, 8]])))


@pytest.mark.parametrize(
    ("mesh", "phrases"),
    [
        (shapes.without(shapes.box(), np.arange(12) < 1), ["open: 3 edges"]),
        (shapes.joined(shapes.box(), shapes.moved(shapes.box(), offset=(5, 0, 0))), ["2 components"]),
        (shapes.torus(), ["genus 1: 1 handle"]),
        (shapes.mobius(), ["open", "one-sided"]),
        (klein_bottle(), ["one-sided"]),
        (
            touching(),
            [
                "touches itself at vertices, 1 of which",
            ],
        ),
        (
            shapes.joined(shapes.box(), shapes.without(shapes.box(), np.arange(12) > 0)),
            ["3 edges with more", "1 triangle given"],
        ),
        (fan_of_three(), ["1 edge with more than two"]),
    ],
    ids=["open", "parts", "torus", "mobius", "klein", "touching", "duplicate", "fan"],
)
def test_what_is_wrong_is_counted_and_the_remedy_named(mesh, phrases):
    text = "; ".join(mapping_obstacles(mesh))
    for phrase in phrases:
        assert phrase in text
    with pytest.raises(GeometryError, match="prepare_closed"):
        conformal_map(mesh)


def test_the_klein_bottle_is_closed_and_manifold():
    measures = measure_mesh(klein_bottle())
    assert measures.closed and measures.vertex_manifold and not measures.orientable


@pytest.mark.parametrize(
    "mesh",
    [shapes.box(), shapes.soup(shapes.u_shape()), pinched(), shapes.moved(shapes.bumpy(4), scale=1e-120)],
    ids=["box", "soup", "pinched", "tiny"],
)
def test_nothing_stands_in_the_way_of_closed_surfaces_of_genus_0(mesh):
    assert mapping_obstacles(mesh) == ()
    surface = closed_surface(mesh)
    measures = measure_mesh(surface.mesh)
    assert measures.genus == 0 and measures.outward
    assert len(np.unique(surface.mesh.triangles)) == len(surface.mesh.vertices)
    np.testing.assert_array_equal(mesh.vertices[surface.source_vertices], surface.mesh.vertices)


def test_sources_are_the_first_of_equal_vertices():
    soup = shapes.soup(shapes.box())
    surface = closed_surface(soup)
    first = [int(np.flatnonzero((soup.vertices == v).all(axis=1))[0]) for v in surface.mesh.vertices]
    np.testing.assert_array_equal(surface.source_vertices, first)


def test_unused_vertices_are_left_out():
    box = shapes.box()
    mesh = MeshArrays(np.vstack(([[9, 9, 9]], box.vertices, [[7, 7, 7]])), box.triangles + 1)
    np.testing.assert_array_equal(closed_surface(mesh).source_vertices, np.arange(1, 9))


def test_collapsed_triangles_go_and_their_vertices_with_them():
    box = shapes.box()
    mesh = MeshArrays(np.vstack((box.vertices, box.vertices[:1])), np.vstack((box.triangles, [[0, 8, 3], [0, 0, 8]])))
    surface = closed_surface(mesh)
    assert len(surface.mesh.triangles) == 12
    np.testing.assert_array_equal(surface.source_vertices, np.arange(8))


def test_inside_out_is_turned():
    box = shapes.box()
    inward = MeshArrays(box.vertices, box.triangles[:, ::-1])
    assert measure_mesh(closed_surface(inward).mesh).volume == pytest.approx(1)


def test_no_area_is_said():
    line = MeshArrays(
        np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3.0, 0, 0]]), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    )
    with pytest.raises(GeometryError, match="no area"):
        mapping_obstacles(line)
