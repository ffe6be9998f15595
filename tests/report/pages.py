"""A page for the tests, and what an HTML parser finds in one."""

from __future__ import annotations

import base64
import json
from html.parser import HTMLParser

import numpy as np

from fsh3d_o3d.report.page import write_reconstruction_page
from tests.report.shapes import ball

HOSTILE = (
    "</script></title><script>document.documentElement.dataset.hacked='yes'</script>"
    "<img src=x onerror=\"document.documentElement.dataset.hacked='yes'\">'\"&amp;<script>alert(1)</script>.ply"
)
"""A file name that marks the page if any of it is taken for HTML."""

FIGURES = {"rmse": 0.00125, "mae": 0.001, "max": 0.0042, "volume_error": None, "closed": True, "genus": 0}


def write_page(path, **changes):
    """Write a page about a ball and a slightly larger one."""
    mesh = ball(12)
    arguments = {
        "title": "ball.ply",
        "original": mesh,
        "reconstruction": ball(12, radius=1.01),
        "errors": np.linspace(0, 0.01, len(mesh.vertices)),
        "energies": 0.5 ** np.arange(10),
        "figures": FIGURES,
        "options": {"method": "radial", "bandwidth": 10},
    }
    write_reconstruction_page(path, **(arguments | changes))
    return path


class Page(HTMLParser):
    """The elements of a page, each closed as it was opened."""

    VOID = frozenset({"meta", "img", "br", "hr", "link", "input"})

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.elements = []  # (tag, attributes, text)
        self.texts = []
        self.feed(text)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs), f"attribute twice in {tag}"
        element = [tag, dict(attrs), ""]
        self.elements.append(element)
        if tag not in self.VOID:
            self.open.append(element)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> without a start"
        assert self.open[-1][0] == tag, f"</{tag}> closes <{self.open[-1][0]}>"
        self.open.pop()

    def handle_data(self, data):
        for element in self.open:
            element[2] += data

    def all(self, tag):
        return [element for element in self.elements if element[0] == tag]

    def text(self, tag):
        return [text for _, _, text in self.all(tag)]

    @property
    def data(self):
        (block,) = [text for _, attributes, text in self.all("script") if attributes.get("id") == "report-data"]
        return json.loads(block)


def read_page(path):
    """Return the parsed page."""
    return Page(path.read_text(encoding="utf-8"))


def unpack(array):
    """Return a typed array of plotly.js."""
    return np.frombuffer(base64.b64decode(array["bdata"]), dtype="<" + array["dtype"])


def check_structure(path, title):
    """What holds for every page."""
    page = read_page(path)
    assert page.text("title") == [title]
    assert page.text("h1") == [title]
    scripts = page.all("script")
    assert [attributes for _, attributes, _ in scripts] == [{"type": "application/json", "id": "report-data"}, {}, {}]
    for tag, attributes, _ in page.elements:
        assert not [name for name in attributes if name.startswith("on")], tag
        for name in ("src", "href", "srcset", "action", "data"):
            assert attributes.get(name, "data:").startswith("data:"), tag
    assert not page.all("link")
    assert not page.all("iframe")
    (style,) = page.text("style")
    assert "url(" not in style
    assert "@import" not in style
    images = page.all("img")
    assert len(images) == 3
    assert all(attributes["alt"].strip() for _, attributes, _ in images)
    plots = {attributes.get("id") for _, attributes, _ in page.all("div")}
    assert {view["id"] for view in page.data["views"]} | {"plot-energies"} <= plots
    return page
