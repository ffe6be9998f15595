"""``fsh3d merge``: scans become one cloud, those that fit nowhere are named, nothing is half-written."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fsh3d_o3d.cli import main
from fsh3d_o3d.files.reading import read_geometry_arrays
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry import PointArrays
from tests.registration.depth_views import depth_views, ring
from tests.registration.test_scans import SAMPLES, lump, sample

VIEWS = depth_views(lump(), ring(8)[:2])


@pytest.fixture
def scans(tmp_path):
    paths = []
    for number, cloud in enumerate(VIEWS.clouds):
        colors = np.tile([0.2, 0.4, 0.6 + 0.2 * number], (len(cloud.points), 1))
        paths.append(tmp_path / f"scan{number}.ply")
        write_geometry(paths[-1], PointArrays(cloud.points, None, colors))
    return paths


def run(*arguments) -> int:
    return main(["merge", *map(str, arguments)])


def test_scans_become_one_cloud(tmp_path, capsys, scans):
    out, picture = tmp_path / "merged.ply", tmp_path / "merged.png"
    assert run(*scans, "-o", out, "--picture", picture) == 0
    printed = capsys.readouterr().out
    assert "2 of 2 scans" in printed
    assert f"wrote {out}" in printed and f"wrote {picture}" in printed
    merged = read_geometry_arrays(out)
    assert isinstance(merged, PointArrays)
    assert len(merged.points) == sum(len(cloud.points) for cloud in VIEWS.clouds)
    assert len(np.unique(merged.colors[:, 2])) == 2
    np.testing.assert_allclose(merged.points[: len(VIEWS.clouds[0].points)], VIEWS.clouds[0].points, atol=1e-12)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in tmp_path.iterdir()} == {"merged.ply", "merged.png", "scan0.ply", "scan1.ply"}


def test_a_stranger_is_named_and_left_out(tmp_path, capsys, scans):
    stranger, out = tmp_path / "stranger.pcd", tmp_path / "merged.ply"
    points = depth_views(sample("horn.off"), ring(1)).clouds[0].points
    header = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points) + 3}\nHEIGHT 1\n"
    rows = "\n".join(" ".join(map(str, row)) for row in [*points.tolist(), *[["nan"] * 3] * 3])
    stranger.write_text(f"{header}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points) + 3}\nDATA ascii\n{rows}\n")
    assert run(*scans, stranger, "-o", out, "--json", "--voxel", 0.1) == 1
    printed, error = capsys.readouterr()
    figures = json.loads(printed)
    assert figures["unplaced"] == [2]
    assert figures["groups"] == [[0, 1], [2]]
    assert np.array(figures["poses"]).shape == (3, 4, 4)
    assert {"source", "target", "confidence", "overlap", "used", "reason"} <= figures["pairs"][0].keys()
    assert figures["points"] == len(read_geometry_arrays(out).points) < len(VIEWS.clouds[0].points)
    assert f"{stranger}: could not be placed (" in error
    assert "3 of" in error and "NaN" in error  # unseen points are counted
    assert "NaN" in figures["notes"][0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "out.obj"], "the output must end in"),
        (["-o", "out.ply", "--voxel", "0"], "--voxel must be > 0"),
        (["-o", "out.ply", "--viewpoint", "camera"], "--viewpoint must be three numbers"),
        (["-o", "out.ply", "--picture", "p.jpg"], "--picture must end in .png"),
        (["-o", "gem.stl"], "the output"),
        (["missing.ply", "-o", "out.ply"], "missing.ply"),
        (["point.xyz", "-o", "out.ply"], "point.xyz: it has no extent"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_usage_is_refused(tmp_path, monkeypatch, capsys, arguments, message):
    (tmp_path / "gem.stl").write_bytes((SAMPLES / "gem.stl").read_bytes())
    (tmp_path / "point.xyz").write_text("1 2 3\n1 2 3\n")
    monkeypatch.chdir(tmp_path)
    assert run("gem.stl", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert len(err.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"gem.stl", "point.xyz"}
