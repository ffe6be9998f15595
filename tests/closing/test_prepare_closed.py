"""Closed genus-0 surfaces of whole, broken and impossible meshes."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d import _validation
from fsh3d_o3d.closing.prepare_closed import prepare_closed
from fsh3d_o3d.errors import GeometryError, MemoryEstimateError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.geometry.surface_comparison import surface_error
from tests.geometry import mesh_shapes as shapes


def square() -> MeshArrays:
    return MeshArrays(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def klein_bottle(n=24) -> MeshArrays:
    """Closed, and with one side only (the figure-eight immersion)."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))

    def point(u, v):
        rho = 2 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
        height = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
        return np.column_stack((rho * np.cos(u), rho * np.sin(u), height))

    def at(a, b):
        b = np.where(a == n, -b, b)  # glued the other way round
        return (a % n) * n + b % n

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    triangles = np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    return MeshArrays(point(2 * np.pi * i / n, 2 * np.pi * j / n), triangles)


def flipped_soup(mesh: MeshArrays, rng) -> MeshArrays:
    triangles = mesh.triangles.copy()
    some = rng.random(len(triangles)) < 0.5
    triangles[some] = triangles[some][:, ::-1]
    return shapes.soup(MeshArrays(mesh.vertices, triangles[rng.permutation(len(triangles))]))


def require_closed(closing):
    measures = measure_mesh(closing.mesh)
    assert (measures.genus, measures.outward, measures.degenerate_triangles) == (0, True, 0)
    assert len(np.unique(closing.mesh.triangles)) == len(closing.mesh.vertices)
    return measures


def test_the_largest_part_is_kept_as_asked():
    specks = [shapes.sphere(3, 0.1, (2 + k, 0, 0)) for k in range(14)]
    scan = shapes.joined(shapes.sphere(8), *specks)
    closing = prepare_closed(scan, parts="largest")
    assert require_closed(closing).components == 1
    assert (closing.method, closing.changed) == ("repaired", ("kept the largest of 15 components",))
    assert closing.mesh.vertices[:, 0].max() < 1.01
    assert closing.hausdorff > 0.5  # the specks count as lost
    everything = prepare_closed(scan, cells_per_side=24)
    assert everything.method == "carved"
    assert everything.mesh.vertices[:, 0].max() > 14
    with pytest.raises(ValueError, match="parts must be one of"):
        prepare_closed(scan, parts="some")


def test_what_is_closed_comes_back_as_it_is():
    mesh = shapes.bumpy()
    closing = prepare_closed(mesh)
    assert closing.mesh is mesh
    assert (closing.method, closing.problems, closing.changed, closing.cells_per_side) == ("as given", (), (), None)
    assert (closing.rms, closing.rms_outer, closing.rms_back, closing.hausdorff, closing.hausdorff_back) == (0,) * 5


def test_only_vertices_and_winding_change_where_that_is_enough(rng):
    mesh = shapes.bumpy()
    closing = prepare_closed(flipped_soup(mesh, rng))
    measures = require_closed(closing)
    assert closing.method == "as given"
    assert len(closing.mesh.vertices) == len(mesh.vertices)
    assert measures.volume == pytest.approx(measure_mesh(mesh).volume)
    merged = 3 * len(mesh.triangles) - len(mesh.vertices)
    assert closing.changed == (f"merged {merged} repeated vertices", "turned triangles to face outward")


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_open3d_meshes_are_taken(kind):
    closing = prepare_closed(shapes.open3d_geometry(shapes.box(), kind))
    assert closing.method == "as given"
    assert measure_mesh(closing.mesh).volume == pytest.approx(1)


def test_holes_are_closed_and_debris_left_out():
    ball = shapes.sphere(24)
    removed = np.zeros(len(ball.triangles), dtype=bool)
    removed[[0, 7, 8, 500]] = True
    speck = shapes.sphere(2, radius=0.003, center=(1.5, 0, 0))
    closing = prepare_closed(shapes.joined(shapes.without(ball, removed), speck))
    measures = require_closed(closing)
    assert closing.method == "repaired"
    assert closing.problems[0] == "2 components"
    assert closing.changed[0] == "left out 1 small components"
    assert "holes" in closing.changed[1]
    # The caps are flat, over four of 11520 triangles.
    assert measures.volume == pytest.approx(measure_mesh(ball).volume, rel=1e-4)
    # The speck's distance is lost, as far as samples of its small area show; nothing was added elsewhere.
    assert closing.rms < 0.01
    assert closing.hausdorff_back < 0.005


def test_large_openings_belong_to_the_shape():
    ball = shapes.sphere(24)
    half = shapes.without(ball, ball.vertices[ball.triangles].mean(axis=1)[:, 2] > 0)
    closing = prepare_closed(half, cells_per_side=32)
    require_closed(closing)
    assert closing.method == "carved"
    # A bowl, not half a ball: π r² of a lid is missing.
    assert closing.hausdorff_back < 0.02


@pytest.mark.parametrize(
    ("mesh", "problem", "lost"),
    [
        (shapes.torus(), "genus 1", 0.002),
        (shapes.frame(), "genus 1", 0.005),
        (shapes.mobius(), "not orientable", 0.005),
        (klein_bottle(), "not orientable", 0.05),  # what is inside its tube is lost
        (shapes.waves(), "open: edges with one triangle", 0.005),
        (square(), "open: edges with one triangle", 0.005),
        (shapes.joined(shapes.sphere(), shapes.sphere(center=(3, 0, 0))), "2 components", 0.002),
        (shapes.joined(shapes.box(), shapes.box((0.3, 0.2, 4.0))), "2 components", 0.05),  # inside the box is lost
        (shapes.needle_soup(aspect=200.0, gap=1e-3), "300 components", 0.02),
        (MeshArrays(np.array([[0.0, 0, 0], [1, 0.2, 0], [1, 0.2, 1e-6]]), np.array([[0, 1, 2]])), "open", 0.005),
    ],
    ids=["torus", "frame", "moebius", "klein", "waves", "square", "two balls", "crossing", "needles", "wire"],
)
def test_everything_else_is_carved(mesh, problem, lost):
    closing = prepare_closed(mesh, cells_per_side=32)
    require_closed(closing)
    assert (closing.method, closing.cells_per_side) == ("carved", 32)
    assert any(text.startswith(problem) for text in closing.problems)
    assert closing.rms < lost
    assert closing.hausdorff < 0.2


def test_a_handle_becomes_a_membrane():
    torus = shapes.torus()
    closing = prepare_closed(torus)
    assert "put about 1 membranes across openings" in closing.changed
    # The middle of the membrane is as far from the torus as its axis is.
    diagonal = torus.diagonal
    assert closing.hausdorff_back == pytest.approx(1.5 / diagonal, abs=0.02)
    volume = 2 * np.pi**2 * 2 * 0.5**2
    # The membrane is a fraction of a cell (0.08) thick.
    assert volume < measure_mesh(closing.mesh).volume < volume + 0.08 * np.pi * 1.5**2


def test_parts_are_joined_by_threads():
    balls = [shapes.sphere(12, center=(x, 0, 0)) for x in (0.0, 3.0, 6.0)]
    closing = prepare_closed(shapes.joined(*balls), cells_per_side=48)
    require_closed(closing)
    assert "joined 3 parts by threads" in closing.changed
    assert measure_mesh(closing.mesh).volume == pytest.approx(3 * measure_mesh(balls[0]).volume, rel=0.02)


def test_what_is_inside_does_not_show():
    ball = shapes.sphere()
    closing = prepare_closed(shapes.joined(ball, shapes.sphere(radius=0.5)), cells_per_side=32)
    require_closed(closing)
    assert measure_mesh(closing.mesh).volume == pytest.approx(measure_mesh(ball).volume, rel=0.01)
    assert closing.hausdorff_back < 0.01
    assert closing.hausdorff == pytest.approx(0.5 / np.sqrt(12), abs=0.01)
    assert closing.hidden == pytest.approx(0.2, abs=0.01)  # 0.5² of 1 + 0.5²
    assert closing.rms_outer < 0.002


def test_a_soup_of_a_solid_is_solid(rng):
    """Cracks narrower than a cell: every triangle is shrunk towards its middle."""
    ball = shapes.sphere(8)
    corners = ball.vertices[ball.triangles]
    shrunk = corners.mean(axis=1, keepdims=True) + 0.9 * (corners - corners.mean(axis=1, keepdims=True))
    closing = prepare_closed(
        shapes.soup(MeshArrays(shrunk.reshape(-1, 3), np.arange(ball.triangles.size).reshape(-1, 3)))
    )
    measures = require_closed(closing)
    assert measures.volume == pytest.approx(measure_mesh(ball).volume, rel=0.05)  # dents of the cracks


@pytest.mark.parametrize("cells", [16, 32, 64])
def test_the_error_falls_with_the_cells(cells):
    torus = shapes.torus(n=160, m=96)
    closing = prepare_closed(torus, cells_per_side=cells)
    cell = 5 / cells / torus.diagonal
    # Curvature across a cell, and the rim of the membrane: less than a tenth of a cell.
    assert closing.rms < 0.1 * cell
    assert closing.hausdorff < 1.5 * cell


def test_the_errors_are_those_of_surface_error():
    torus = shapes.torus()
    closing = prepare_closed(torus)
    error = surface_error(torus, closing.mesh, samples=20_000).relative()
    # Other samples of the same surfaces.
    assert np.sqrt((closing.rms**2 + closing.rms_back**2) / 2) == pytest.approx(error.rmse, rel=0.03)
    assert max(closing.hausdorff, closing.hausdorff_back) == pytest.approx(error.maximum, rel=0.03)


@pytest.mark.parametrize(("scale", "offset"), [(1e-200, 0.0), (1e200, 0.0), (1.0, 1e6)])
def test_units_and_origin_do_not_matter(scale, offset):
    torus = shapes.torus()
    moved = shapes.moved(torus, scale=scale, offset=(offset, -offset, offset))
    closing, plain = prepare_closed(moved, cells_per_side=32), prepare_closed(torus, cells_per_side=32)
    require_closed(closing)
    assert closing.rms == pytest.approx(plain.rms, rel=0.1)
    assert len(closing.mesh.triangles) == pytest.approx(len(plain.mesh.triangles), rel=0.02)


def test_the_same_mesh_gives_the_same_bytes():
    first, second = (prepare_closed(shapes.mobius(), cells_per_side=24).mesh for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()


def test_repair_may_be_left_out():
    ball = shapes.sphere(24)
    removed = np.zeros(len(ball.triangles), dtype=bool)
    removed[3] = True
    closing = prepare_closed(shapes.without(ball, removed), repair=False, cells_per_side=32)
    require_closed(closing)
    assert closing.method == "carved"
    assert measure_mesh(closing.mesh).volume == pytest.approx(measure_mesh(ball).volume, rel=0.02)


def test_what_cannot_be_closed_is_an_error():
    line = MeshArrays(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), np.array([[0, 1, 2]]))
    with pytest.raises(GeometryError, match="no area"):
        prepare_closed(line)
    with pytest.raises(GeometryError, match="no area"):
        prepare_closed(MeshArrays(line.vertices, np.array([[0, 1, 1]])))
    with pytest.raises(TypeError, match="needs a mesh"):
        prepare_closed(PointArrays(line.vertices))
    with pytest.raises(ValueError, match="cells_per_side must be"):
        prepare_closed(shapes.torus(), cells_per_side=4)


def test_too_large_a_grid_is_refused(monkeypatch):
    monkeypatch.setattr(_validation, "_available_memory", lambda: 2.0**30)
    with pytest.raises(MemoryEstimateError, match="carving a grid of"):
        prepare_closed(shapes.torus(), cells_per_side=512)
