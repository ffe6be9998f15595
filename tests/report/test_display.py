import numpy as np
import pytest
from scipy.spatial import KDTree

from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.rays import UnitCube
from fsh3d_o3d.report import display as _display
from fsh3d_o3d.report.display import displayed, geometry_json, packed
from tests.report.pages import read_page, unpack, write_page
from tests.report.shapes import ball, ball_points

pytestmark = pytest.mark.usefixtures("small_page")

UNIT = UnitCube(origin=np.zeros(3), scale=1.0)


def areas(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize("quadric_from", [10**6, 1000])
def test_large_mesh_is_decimated_to_the_limit_and_keeps_its_shape(monkeypatch, quadric_from):
    monkeypatch.setattr(_display, "_QUADRIC_FROM", quadric_from)
    mesh = ball(48)
    shown = displayed(mesh, UNIT, most=800)
    assert 200 < shown.shown <= 800
    assert shown.total == len(mesh.triangles)
    assert shown.note() == f"shown with {shown.shown} of {len(mesh.triangles):,} triangles"
    # A sphere of some hundred triangles or more has lost a few per cent of its area and radius, not more.
    assert areas(shown.points, shown.triangles).sum() == pytest.approx(4 * np.pi, rel=0.06)
    assert np.abs(np.linalg.norm(shown.points, axis=1) - 1).max() < 0.05
    distance, nearest = KDTree(mesh.vertices).query(shown.points)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices[shown.source] - shown.points, axis=1), distance)
    assert nearest.max() < len(mesh.vertices)


def test_soup_is_decimated_too():
    mesh = ball(24)
    soup = MeshArrays(mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(3 * len(mesh.triangles)).reshape(-1, 3))
    shown = displayed(soup, UNIT, most=500)
    assert 100 < shown.shown <= 500
    assert areas(shown.points, shown.triangles).sum() == pytest.approx(4 * np.pi, rel=0.1)


def test_loose_triangles_are_left_out_in_turn():
    corners = np.random.default_rng(0).normal(size=(2_000, 1, 3)) + 1e-4 * np.eye(3)
    loose = MeshArrays(corners.reshape(-1, 3), np.arange(6_000).reshape(-1, 3))
    shown = displayed(loose, UNIT, most=300)
    assert 0 < shown.shown <= 300
    assert shown.triangles.max() < len(shown.points) == len(shown.source)


def test_unused_vertices_are_not_shown():
    mesh = MeshArrays([[9.0, 9, 9], [0, 0, 0], [8, 8, 8], [1, 0, 0], [0, 1, 0]], [[1, 3, 4]])
    shown = displayed(mesh, UNIT)
    np.testing.assert_array_equal(shown.source, [1, 3, 4])
    np.testing.assert_array_equal(shown.points[shown.triangles], mesh.vertices[mesh.triangles])


def test_large_cloud_is_thinned():
    cloud = ball_points(5_000)
    shown = displayed(cloud, UNIT, most=700)
    assert shown.shown == len(np.unique(shown.source)) == 700
    np.testing.assert_array_equal(shown.points, cloud.points[shown.source])
    assert shown.note() == "shown with 700 of 5,000 points"


def test_page_tells_what_is_left_out_and_keeps_the_errors(tmp_path, monkeypatch):
    monkeypatch.setattr(_display, "MOST_TRIANGLES", 300)
    mesh = ball(24)
    errors = np.maximum(mesh.vertices[:, 2], 0)  # one at the north pole, nothing in the south
    path = write_page(tmp_path / "page.html", original=mesh, reconstruction=mesh, errors=errors)
    assert f"of {len(mesh.triangles):,} triangles" in path.read_text(encoding="utf-8")
    data = read_page(path).data
    shown = data["geometries"]["reconstruction"]
    percent, z = unpack(data["errors"]["percent"]), unpack(shown["z"])
    assert len(percent) == len(z)
    # The cube's unit is a power of two, here the next after the diameter's.
    expected = 100 * np.maximum(z / np.abs(z).max(), 0) / mesh.diagonal
    # Each vertex takes the error of its nearest original, at most half an edge (0.13) away.
    assert np.abs(percent - expected).max() < 100 * 0.1 / mesh.diagonal


def test_page_of_a_large_mesh_stays_small(tmp_path):
    mesh = ball(160)
    assert len(mesh.triangles) > _display.MOST_TRIANGLES
    shown = displayed(mesh, UNIT)
    size = sum(len(array["bdata"]) for array in geometry_json(shown, None).values())
    assert size < 3e6  # two of these, errors and pictures: well below 10 MB


def test_packed_arrays_are_little_endian():
    assert packed([1, 2], "u2") == {"dtype": "u2", "bdata": "AQACAA=="}
    np.testing.assert_array_equal(unpack(packed(np.array([1.5, -2.0]), "f4")), [1.5, -2.0])


def test_palette_gives_back_the_colours():
    colors = np.random.default_rng(0).random((500, 3))
    data = geometry_json(displayed(ball_points(500), UNIT), colors)
    given = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in data["palette"]])[unpack(data["color"])] / 255
    # Thirty-two levels: half a level, and half a level of 255.
    assert np.abs(given - colors).max() <= 0.5 / 31 + 0.5 / 255 + 1e-12


def test_points_at_one_place_are_shown():
    cloud = PointArrays(np.repeat([[0.0, 0, 0], [1, 1, 1]], 20, axis=0))
    shown = displayed(cloud, UNIT)
    colors = _display.shaded_points(shown, cloud, (0.5, 0.5, 0.5), np.array([0.0, 0, 1]))
    assert np.isfinite(colors).all()
