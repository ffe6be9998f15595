"""The method that suits a geometry is found by trying, and whatever can be read comes back as a surface."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError, ReconstructionWarning
from fsh3d_o3d.geometry import MeshArrays, PointArrays, area_samples, geometry_arrays, measure_mesh
from fsh3d_o3d.reconstruction import choose
from tests.geometry import mesh_shapes as shapes


def sphere(level=4, center=(0.0, 0.0, 0.0), radius=1.0):
    directions, triangles = fsh.icosphere(level)
    return MeshArrays(radius * directions + np.array(center), triangles)


SHEET = MeshArrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("name", "way", "genus"),
    [
        ("gem.stl", "radial", 0),
        ("horn.off", "conformal", 0),
        ("double_torus.off", "shells", 2),
        ("bowl.off", "conformal, carved", 0),
    ],
)
def test_samples_get_the_method_that_suits_them(name, way, genus):
    result = choose(fsh.read_geometry(f"samples/{name}"), bandwidth=32)
    measures = measure_mesh(result.mesh)
    assert (result.way, measures.closed, measures.genus) == (way, True, genus)
    assert result.error.relative().rmse < 0.003  # the bowl by shells: 4.4 %
    assert result.coefficients == result.shape.coefficients.size
    assert result.summary().startswith(way)


@pytest.mark.parametrize(
    "mesh",
    [
        SHEET,
        shapes.mobius(),
        shapes.soup(sphere(2)),
        shapes.joined(sphere(3), sphere(3, (2.5, 0, 0))),
        MeshArrays(sphere(3).vertices, np.vstack((sphere(3).triangles[:-3], [[0, 5, 9]]))),
    ],
    ids=["sheet", "Möbius band", "soup", "two spheres", "not manifold"],
)
def test_whatever_has_area_comes_back_closed(mesh):
    measures = measure_mesh(choose(mesh, bandwidth=12).mesh)
    assert measures.closed
    assert measures.edge_manifold
    assert measures.vertex_manifold


def test_what_leaves_least_error_is_taken():
    """A flat star-shaped plate: rays from its middle graze the faces."""
    plate = shapes.box((8.0, 6.0, 0.2))
    result = choose(plate, bandwidth=24)
    tried = {trial.way: trial.rmse for trial in result.trials}
    assert set(tried) >= {"radial", "conformal"}
    known = [rmse for rmse in tried.values() if rmse is not None]
    assert result.error.relative().rmse == pytest.approx(min(known))
    assert "leaves" in result.reason or "fails" in result.reason


def test_an_open_surface_that_became_closed_is_warned_of():
    with pytest.warns(ReconstructionWarning, match="is open and has become closed"):
        result = fsh.reconstruct(SHEET, bandwidth=8)
    assert any("closed" in text for text in result.warnings)


def test_other_parts_and_handles_are_warned_of():
    near = shapes.joined(sphere(3), sphere(3, (2.02, 0, 0)))  # 0.02 apart: eight degrees cannot tell
    result = choose(near, bandwidth=8)
    assert measure_mesh(result.mesh).components == 1
    assert any("2 parts with 0 handles became 1 part" in text for text in result.warnings)


def test_a_large_error_is_warned_of_with_what_would_help():
    result = choose(fsh.read_geometry("samples/hand.ply"), bandwidth=3)
    assert any("larger bandwidth than 3" in text for text in result.warnings)


def test_specks_are_left_out_as_asked():
    specks = [sphere(1, (1.5 + 0.1 * k, 0, 0), 0.03) for k in range(14)]
    scan = shapes.joined(sphere(4), *specks)
    result = choose(scan, bandwidth=12, parts="largest")
    assert result.mesh.vertices[:, 0].max() < 1.1
    assert "kept the largest of 15 components" in result.notes
    assert measure_mesh(result.mesh).genus == 0


def test_a_scan_of_one_side_is_open_and_the_unseen_part_is_marked():
    directions = fsh.fibonacci_grid(6000).directions
    half = PointArrays(directions[directions[:, 2] > 0] * (3.0, 2.0, 1.5))
    result = choose(half, bandwidth=16)
    assert result.unseen is not None
    seen = geometry_arrays(result.to_triangle_mesh())[0]
    assert not measure_mesh(seen).closed
    assert seen.vertices[:, 2].min() > -0.5
    assert np.abs(np.linalg.norm(seen.vertices / (3.0, 2.0, 1.5), axis=1) - 1).max() < 0.15
    whole = result.to_triangle_mesh(unseen=True)
    assert measure_mesh(geometry_arrays(whole)[0]).closed
    assert len(np.unique(np.asarray(whole.vertex_colors), axis=0)) == 2
    assert any("not seen" in text for text in result.warnings)


def test_a_cloud_all_around_is_closed_also_with_outliers(rng):
    directions = fsh.fibonacci_grid(4000).directions
    points = directions * (1.0, 1.2, 0.9)
    points[::50] *= rng.uniform(1.5, 3, (80, 1))
    result = choose(PointArrays(points), bandwidth=12)
    assert (result.way, result.unseen) == ("radial", None)
    assert "98 % on one radius" in result.reason
    assert not result.warnings


def test_a_cloud_of_a_ring_has_a_hole_without_normals():
    torus = shapes.torus()
    result = choose(PointArrays(area_samples(torus, 6000)[0]), bandwidth=32)
    assert result.way == "shells, Poisson"
    assert measure_mesh(result.mesh).genus == 1
    assert "estimated normals, and turned them alike" in result.notes


def test_tensor_in_tensor_out():
    mesh = fsh.read_geometry("samples/gem.stl", kind="tensor")
    result = choose(mesh, bandwidth=16)
    assert (result.kind, result.shape.kind) == ("tensor", "tensor")
    assert "t.geometry" in type(result.to_triangle_mesh()).__module__


@pytest.mark.parametrize(
    "geometry",
    [
        MeshArrays([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]]),
        PointArrays(np.ones((50, 3))),
        PointArrays([[0, 0, 0], [1, 1, 1]]),
    ],
    ids=["no area", "one place", "two points"],
)
def test_what_has_no_surface_is_refused(geometry):
    with pytest.raises(GeometryError):
        choose(geometry, bandwidth=8)


def test_options_are_checked():
    for options in ({"bandwidth": 0}, {"parts": "some"}, {"threads": 0}):
        with pytest.raises(ValueError, match="must be"):
            choose(SHEET, **options)
