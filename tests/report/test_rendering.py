"""Pictures for anyone, the page of one shape, and what notebooks show of values."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys

import numpy as np
import open3d as o3d
import pytest
from PIL import Image

import fsh3d_o3d as fsh
from fsh3d_o3d.report import render_thumbnail, write_view_page
from tests.report.shapes import ball_points
from tests.report.test_page_in_browser import opened

VERTICES, TRIANGLES = fsh.icosphere(6)
RED = np.tile([1.0, 0, 0], (len(VERTICES), 1))


def test_a_picture_has_the_size_and_the_colours_asked_for():
    legacy = fsh.to_open3d(fsh.MeshArrays(VERTICES, TRIANGLES, None, RED))
    assert isinstance(legacy, o3d.geometry.TriangleMesh)
    for geometry in (legacy, fsh.to_open3d(legacy, kind="tensor"), fsh.PointArrays(VERTICES, None, RED)):
        picture = fsh.render(geometry, width=60, height=40)
        assert (picture.shape, picture.dtype) == ((40, 60, 3), np.uint8)
        middle = picture[20, 30].astype(int)
        assert middle[0] > middle[1] + 50 and middle[0] > middle[2] + 50
        np.testing.assert_array_equal(picture[0, 0], 255)
    np.testing.assert_array_equal(
        fsh.render((VERTICES, TRIANGLES), width=60, height=40, background=None),
        render_thumbnail((VERTICES, TRIANGLES), width=60, height=40, background=None),
    )
    blue = fsh.render((VERTICES, TRIANGLES), width=40, height=40, color=(0, 0, 1))[20, 20].astype(int)
    assert blue[2] > blue[0] + 50
    with pytest.raises(TypeError, match="geometry must be"):
        fsh.render(object())


def shown(value):
    """The picture in what a notebook shows of a value, and the text beside it."""
    text = value._repr_html_()
    data = re.search(r'src="data:image/png;base64,([^"]+)"', text)[1]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))), re.search(r"<code>(.*)</code>", text)[1]


EGG = fsh.MeshArrays(VERTICES * (1.0, 1.1, 1.3), TRIANGLES, None, RED)
MADE = {
    "MeshArrays": lambda: EGG,
    "PointArrays": lambda: fsh.PointArrays(VERTICES, None, RED),
    "RadialShape": lambda: fsh.RadialShape.from_geometry(EGG, 6),
    "ShellShape": lambda: fsh.ShellShape.from_geometry(EGG, 6, 12),
    "ConformalShape": lambda: fsh.ConformalShape.from_geometry(EGG, 6),
    "Closing": lambda: fsh.prepare_closed(EGG),
    "Repair": lambda: fsh.repair_mesh(EGG),
    "SphericalMap": lambda: fsh.conformal_map(EGG),
    "SphericalRegistrationResult": lambda: fsh.registration_spherical(EGG, EGG),
}


@pytest.mark.parametrize("name", MADE)
def test_notebooks_show_a_picture_and_one_line(name):
    value = MADE[name]()
    picture, line = shown(value)
    assert picture.shape == (160, 160, 4)
    assert picture[60:100, 60:100, 3].any()
    assert "\n" not in line and line.startswith(name)
    assert "\n" not in repr(value) and len(repr(value)) < 600


def test_hits_show_what_was_indexed(tmp_path):
    fsh.write_geometry(tmp_path / "<b>.ply", (VERTICES, TRIANGLES))
    index = fsh.ShapeIndex.open(tmp_path / "index", create=True)
    index.add_files([tmp_path / "<b>.ply"])
    assert repr(index) == f"ShapeIndex({str(tmp_path / 'index')!r})"
    (hit,) = index.query((VERTICES, TRIANGLES))
    assert hit._repr_html_() is None  # nothing was drawn
    again = fsh.Hit(**{**vars(hit), "thumbnail": fsh.report.encode_png(np.zeros((9, 9, 3), dtype=np.uint8))})
    picture, line = shown(again)
    assert picture.shape == (9, 9, 3)
    assert line.startswith("Hit(path=")
    named = fsh.Hit(**{**vars(again), "path": "<b>.ply"})
    assert "&lt;b&gt;.ply" in shown(named)[1] and "<b>" not in named._repr_html_()


def test_what_has_no_form_is_its_line_alone():
    assert fsh.SHDOption.best()._repr_html_() is None
    spike = fsh.RadialShape(np.array([1.0, 0, 0, -9.0]), np.zeros(3))  # a radius that is not positive everywhere
    assert spike._repr_html_() is None


def test_importing_the_package_loads_nothing_that_draws():
    code = "import sys, fsh3d_o3d; print([name for name in ('PIL', 'jinja2', 'plotly') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "geometry",
    [fsh.MeshArrays(VERTICES, TRIANGLES, None, RED, None, {"height": VERTICES[:, 2]}), ball_points(400)],
    ids=["mesh", "cloud"],
)
def test_the_page_draws_one_view(geometry, tmp_path):
    title = "<i>a</i>.ply"
    write_view_page(tmp_path / "a.html", geometry, title=title)
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert title not in text and "&lt;i&gt;a" in text
    assert "default-src 'none'" in text
    if isinstance(geometry, fsh.MeshArrays):
        assert '"palette":["#ff0000"]' in text
        assert "362 vertices, 720 triangles; " in text and "with colours, height" in text
    result = opened(tmp_path / "a.html", tmp_path / "profile")
    if result is not None:
        assert result[0] == {"rendered": "true"}
        assert 'class="stage live"' in result[1]


def test_the_same_geometry_gives_the_same_page(tmp_path):
    for name in ("a.html", "b.html"):
        write_view_page(tmp_path / name, (VERTICES, TRIANGLES), title="ball")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    with pytest.raises(TypeError, match="title must be text"):
        write_view_page(tmp_path / "c.html", (VERTICES, TRIANGLES), title=1)
