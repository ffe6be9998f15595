"""The page of a query: its structure, hostile names, and a click in headless Chromium."""

from __future__ import annotations

import dataclasses
import os
import re

import numpy as np
import pytest

from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.index.shape_index import Hit
from fsh3d_o3d.report import library_thumbnail
from fsh3d_o3d.report.search_page import SearchResult, write_search_page
from tests.report.pages import HOSTILE, read_page, unpack
from tests.report.shapes import ball, ball_points
from tests.report.test_page_in_browser import opened

NAME = HOSTILE.replace("/", "\N{DIVISION SLASH}").removesuffix(".ply") + "\udcff.ply"
"""The hostile text as a file name: without the one character that cannot be in it, with a byte that is no UTF-8."""

CLICK = """
<script>
setTimeout(() => document.querySelector("button[data-hit='1']").click(), 300);
</script>
</body>"""


@pytest.fixture
def result(tmp_path):
    """A query with three hits: a mesh of a hostile name, a cloud, and a file that is gone."""
    stretched = ball(8).vertices * (1, 2, 3)
    write_geometry(tmp_path / "first.off", MeshArrays(stretched, ball(8).triangles))
    (tmp_path / "first.off").rename(tmp_path / NAME.replace(".ply", ".off"))
    write_geometry(tmp_path / "cloud.xyz", ball_points(300))
    names = [NAME.replace(".ply", ".off"), "cloud.xyz", "gone.off"]
    onto = np.eye(4)
    onto[:3, :3] *= 2
    hits = [
        Hit(
            path=os.fspath(tmp_path / name),
            distance=0.25 * rank,
            rank=rank,
            rotation=np.eye(3),
            transformation=onto,
            feature_distance=0.2,
            vertices=300,
            triangles=0 if rank == 2 else 1234,
            watertight=rank == 1,
            thumbnail=library_thumbnail(ball(6)) if rank == 3 else b"",
        )
        for rank, name in enumerate(names, start=1)
    ]
    return SearchResult(NAME, MeshArrays(2 * stretched, ball(8).triangles), hits)


def test_structure(tmp_path, result, small_page):
    path = tmp_path / "page.html"
    write_search_page(path, [result])
    page = read_page(path)
    shown = NAME.replace("\udcff", r"\xff")
    assert page.text("title") == page.text("h1") == [shown]
    assert [attributes for _, attributes, _ in page.all("script")] == [
        {"type": "application/json", "id": "report-data"},
        {},
        {},
    ]
    for tag, attributes, _ in page.elements:
        assert not [name for name in attributes if name.startswith("on")], tag
        for name in ("src", "href", "srcset", "action"):
            assert attributes.get(name, "data:").startswith("data:"), tag
    assert len(page.all("img")) == 4
    buttons = [attributes for _, attributes, _ in page.all("button") if "data-hit" in attributes]
    assert [attributes["data-hit"] for attributes in buttons] == ["0", "1", "2"]
    assert ["disabled" in attributes for attributes in buttons] == [False, False, True]
    widths = [attributes["style"] for _, attributes, _ in page.all("span") if "width" in attributes.get("style", "")]
    assert widths == ["width:33.3%", "width:66.7%", "width:100.0%"]
    (data,) = page.data["results"]
    assert data["hits"][2] is None
    # The hit, twice as large, lies on the query.
    np.testing.assert_array_equal(unpack(data["hits"][0]["geometry"]["x"]), unpack(data["query"]["x"]))
    assert "not there any more" in path.read_text(encoding="utf-8")


def test_click_lays_the_hit_over_the_query(tmp_path, result):
    path = tmp_path / "page.html"
    write_search_page(path, [result])
    first = opened(path, tmp_path / "profile")
    text = path.read_text(encoding="utf-8")
    # Without the policy, which alone would stop a hostile script: escaping has to do it.
    text, removed = re.subn(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    assert removed == 1
    path.write_text(CLICK.join(text.rsplit("</body>", 1)), encoding="utf-8")
    second = opened(path, tmp_path / "profile")
    if first is not None and second is not None:
        assert first[0] == {"rendered": "true"}
        attributes, document = second
        assert attributes == {"rendered": "true", "shown": "0-1"}
        assert re.search(r'<h2 id="viewer-title">cloud.xyz</h2>', document)
        assert "<canvas" in document


def test_nothing_found(tmp_path, result, small_page):
    path = tmp_path / "page.html"
    write_search_page(path, [dataclasses.replace(result, hits=())])
    assert "the index is empty" in path.read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="at least one"):
        write_search_page(path, [])
