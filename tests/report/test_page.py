import base64
import hashlib
import io
import re
from pathlib import Path

import jinja2
import numpy as np
import pytest
from PIL import Image

from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.report import html
from fsh3d_o3d.report.html import write_page as write_template
from fsh3d_o3d.report.page import reconstruction_picture
from tests.report.pages import FIGURES, HOSTILE, check_structure, read_page, unpack, write_page
from tests.report.shapes import ball, ball_points

COLORS = ["#000000", "#ffffff"]
TEMPLATES = sorted((Path(html.__file__).parent / "templates").iterdir())

pytestmark = pytest.mark.usefixtures("small_page")


@pytest.mark.parametrize("title", ["ball.ply", "<script>alert(1)</script>.ply", HOSTILE, "Größe – 大きさ 🪨"])
def test_structure_with_any_title(tmp_path, title):
    check_structure(write_page(tmp_path / "page.html", title=title), title)


def test_hostile_text_in_tables_stays_text(tmp_path):
    figures = {HOSTILE: HOSTILE, "plain": 1}
    page = check_structure(write_page(tmp_path / "page.html", figures=figures, options={"x": HOSTILE}), "ball.ply")
    assert page.text("td") == [HOSTILE, "1", HOSTILE]


def test_what_is_hidden_in_a_title_is_escaped(tmp_path):
    path = write_page(tmp_path / "page.html", title="a\0b\x1bc\udc80d\u202ee")
    assert read_page(path).text("h1") == [r"a\x00b\x1bc\x80d\u202ee"]


def test_json_cannot_close_its_script(tmp_path):
    path = tmp_path / "page.html"
    value = {"<!--": "</script><script>&amp;\u2028", "list": [1, None, True]}
    write_template(path, "search.html", data={"colors": COLORS, "value": value}, title="", results=[])
    assert read_page(path).data["value"] == value
    block = path.read_text(encoding="utf-8").split('id="report-data">')[1].split("</script>")[0]
    assert not set("<>&") & set(block)
    with pytest.raises(ValueError):
        write_template(path, "search.html", data={"colors": COLORS, "value": float("nan")}, title="", results=[])


def test_a_name_that_a_template_lacks_is_an_error(tmp_path):
    with pytest.raises(jinja2.UndefinedError, match="title"):
        write_template(tmp_path / "page.html", "search.html", data={"colors": COLORS}, results=[])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.name)
def test_no_template_turns_escaping_off(template):
    text = template.read_text(encoding="utf-8")
    assert not re.search(r"\|\s*safe\b|\bautoescape\b|\bMarkup\b", text)
    assert not re.search(r"""=\s*\{\{""", text)  # an attribute without quotes


def test_policy_lets_exactly_the_page_s_scripts_run(tmp_path):
    page = read_page(write_page(tmp_path / "page.html"))
    (policy,) = [a["content"] for _, a, _ in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.split(maxsplit=1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert "'unsafe-inline'" not in rules["script-src"]
    assert not re.search(r"https?:|\*", policy)
    code = [text for _, attributes, text in page.all("script") if not attributes]
    hashes = [f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in code]
    assert rules["script-src"].split() == [*hashes, "'unsafe-eval'"]
    assert "\r" not in "".join(code)  # a parser would read it as a line feed, and the hash would not fit


def test_geometry_is_all_there(tmp_path):
    original = ball(12, radius=3e5, center=(1e6, 0, -1e6))
    larger = ball(12, radius=3.1e5, center=(1e6, 0, -1e6))
    errors = np.linspace(0, 1e4, len(larger.vertices))
    path = write_page(tmp_path / "page.html", original=original, reconstruction=larger, errors=errors)
    data = read_page(path).data
    for name, mesh in (("original", original), ("reconstruction", larger)):
        shown = data["geometries"][name]
        triangles = np.stack([unpack(shown[axis]) for axis in "ijk"], axis=1)
        np.testing.assert_array_equal(triangles, mesh.triangles)
        points = np.stack([unpack(shown[axis]) for axis in "xyz"], axis=1)
        assert points.dtype == np.float32
        assert np.abs(points).max() <= data["reach"] * (1 + 1e-6)
        # One frame for both: sizes compare as in the file, to float32 in numbers of order one.
        factor = np.linalg.norm(points[0] - points[1]) / np.linalg.norm(mesh.vertices[0] - mesh.vertices[1])
        expected = (mesh.vertices - (1e6, 0, -1e6)) * factor
        np.testing.assert_allclose(points, expected, atol=1e-6)
    percent = unpack(data["errors"]["percent"])
    np.testing.assert_allclose(percent, 100 * errors / original.diagonal, rtol=1e-6)  # float32
    assert data["errors"]["maximum"] == pytest.approx(np.quantile(percent, 0.99), rel=1e-6)
    assert "triangles" in path.read_text(encoding="utf-8")
    assert "shown with" not in path.read_text(encoding="utf-8")


def test_cloud_is_shown_as_points_with_its_colours(tmp_path):
    colors = np.tile([1.0, 0.0, 0.0], (300, 1))
    cloud = ball_points(300, colors=colors)
    data = read_page(write_page(tmp_path / "page.html", original=cloud)).data
    shown = data["geometries"]["original"]
    assert "i" not in shown
    assert len(unpack(shown["x"])) == 300
    index = unpack(shown["color"])
    assert len(index) == 300
    assert index.max() < len(shown["palette"])
    assert all(re.fullmatch("#[0-9a-f]{2}0000", color) for color in shown["palette"])  # shades of red


def test_cloud_is_bright_where_it_faces_the_light(tmp_path):
    points = ball_points(2_000)
    for cloud in (points, PointArrays(points.points, 5 * points.points)):
        data = read_page(write_page(tmp_path / "page.html", original=cloud)).data
        shown = data["geometries"]["original"]
        brightness = np.array([int(color[1:3], 16) for color in shown["palette"]])[unpack(shown["color"])]
        light = np.array([data["views"][0]["light"][axis] for axis in "xyz"])
        # Brightness is linear in the cosine; estimated normals and 32 levels blur it a little.
        assert np.corrcoef(brightness, points.points @ light)[0, 1] > 0.98


def test_tables_tell_figures_units_and_meanings(tmp_path):
    page = read_page(write_page(tmp_path / "page.html", figures=FIGURES | {"wall time": 1.5, "nodes": np.int64(6144)}))
    assert page.text("caption") == ["Figures", "Method and options"]
    values = page.text("td")
    percent = "\u202f%"
    assert values == [
        *(f"{text}{percent}" for text in ("0.125", "0.1", "0.42")),
        *("not defined", "yes", "0", "1.5", "6144", "radial", "10"),
    ]
    headers = [text for _, attributes, text in page.all("th") if attributes["scope"] == "row"]
    assert headers[0].startswith("RMSE")
    assert "bounding-box diagonal" in headers[0]
    assert headers[6] == "Wall time"


def test_energies_are_drawn_without_zeros(tmp_path):
    energies = np.array([2.0, 0.0, 1e-9])
    data = read_page(write_page(tmp_path / "page.html", energies=energies)).data
    assert data["energies"]["values"] == [2.0, None, 1e-9]  # a logarithmic axis has no place for zero
    for harmless in (np.zeros(4), [1e300], [1e-300, 0.0]):
        write_page(tmp_path / "page.html", energies=harmless)


def test_still_pictures_are_three_different_ones(tmp_path):
    page = read_page(write_page(tmp_path / "page.html"))
    sources = [attributes["src"] for _, attributes, _ in page.all("img")]
    images = [Image.open(io.BytesIO(base64.b64decode(source.split(",", 1)[1]))) for source in sources]
    assert [(image.mode, image.size) for image in images] == [("RGBA", (40, 40))] * 3
    assert len(set(sources)) == 3


def test_same_input_gives_the_same_bytes(tmp_path):
    first, second = (write_page(tmp_path / name).read_bytes() for name in ("a.html", "b.html"))
    assert first == second


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"title": b"ball"}, TypeError),
        ({"errors": [0.0]}, ValueError),
        ({"errors": np.full(len(ball(12).vertices), -1.0)}, ValueError),
        ({"errors": np.full(len(ball(12).vertices), np.nan)}, ValueError),
        ({"energies": []}, ValueError),
        ({"energies": [[1.0]]}, ValueError),
        ({"energies": [-1.0]}, ValueError),
        ({"reconstruction": ball_points(5)}, TypeError),
        (
            {"original": PointArrays([[0.0, 0, 0]]), "reconstruction": MeshArrays(np.zeros((3, 3)), [[0, 1, 2]])},
            ValueError,
        ),
        ({"original": PointArrays([[0.0, 0, 0]])}, GeometryError),
        ({"figures": {"rmse": [1]}}, TypeError),
        ({"figures": {3: 1}}, TypeError),
    ],
)
def test_bad_arguments_leave_no_file(tmp_path, change, error):
    with pytest.raises(error):
        write_page(tmp_path / "page.html", **change)
    assert list(tmp_path.iterdir()) == []


def test_picture_has_three_panels_of_one_scale():
    mesh = ball(12)
    errors = np.linspace(0, 1, len(mesh.vertices))
    half = MeshArrays(mesh.vertices / 2, mesh.triangles)
    picture = reconstruction_picture(mesh, half, errors, size=100)
    panels = [picture[:100, left : left + 100] for left in (0, 112, 224)]
    assert picture.shape[1] == 324
    covered = [(panel != 255).any(axis=2).sum() for panel in panels]
    # A ball of half the radius covers a quarter; the rim is a few per cent of a hundred pixels' disc.
    assert covered[1] == pytest.approx(covered[0] / 4, rel=0.1)
    assert covered[2] == covered[1]
    assert np.ptp(panels[2].astype(int), axis=2).max() > np.ptp(panels[1].astype(int), axis=2).max() + 40
