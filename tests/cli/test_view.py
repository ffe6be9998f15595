"""``fsh3d view``: a page of any file and of a shape."""

from __future__ import annotations

from pathlib import Path

import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main

SAMPLES = Path(__file__).parents[2] / "samples"


def test_a_page_is_written_beside_where_one_works(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["view", str(SAMPLES / "gem.stl")]) == 0
    assert capsys.readouterr().out == "wrote gem.stl.html\n"
    assert "94 triangles" in (tmp_path / "gem.stl.html").read_text(encoding="utf-8")
    fsh.RadialShape.from_geometry(SAMPLES / "gem.stl", 8).save("gem.npz")
    assert main(["view", "gem.npz", "-o", "shape.html", "--quiet"]) == 0
    assert "gem.npz" in (tmp_path / "shape.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.stl"], "No such file"),
        ([str(SAMPLES / "gem.stl"), "-o", "page.png"], "the page must end in .html"),
        ([str(SAMPLES / "broken" / "truncated.off")], "truncated.off"),
    ],
)
def test_nothing_is_written_where_something_is_wrong(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["view", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
