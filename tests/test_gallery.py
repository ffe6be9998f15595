"""The scripts of the gallery run on the samples, draw their picture, and are shown on its page."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image, ImageStat

from tests.scripts import run_script

ROOT = Path(__file__).parents[1]
GALLERY = ROOT / "pipelines" / "gallery"
PICTURES = ROOT / "docs" / "images" / "gallery"


def check_poses(printed):
    asymmetric = next(line for line in printed.splitlines() if line.startswith("bennu_like.ply"))
    # Copies differ by rounding where the pose is unique; the script's exit code looks after the others.
    assert float(asymmetric.partition("differ by ")[2].partition(";")[0]) < 1e-9


def check_starfish(printed):
    assert "0 triangles flipped" in printed
    errors = [float(line.partition("RMSE ")[2].partition(" %")[0]) for line in printed.splitlines()[1:]]
    # More numbers, less error; the finest is near what a map of this mesh allows.
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.1


def check_matches(printed):
    shares = {line.split(":")[0]: float(line.split(": ")[1].split(" %")[0]) for line in printed.splitlines()[:2]}
    assert shares["local harmonics"] > shares["FPFH"] + 10


def check_hits(printed):
    assert all(f"{query} aligned: {twin} " in " ".join(printed.split()) for query, twin in TWINS.items())


def check_alignment(printed):
    # Noise is 0.2 % of the diagonal: the median deviation must be of that order, not of the alignment's.
    assert float(printed.partition("median ")[2].partition(" %")[0]) < 0.3
    # One point in twenty is an outlier, and nearly all of those are far off.
    assert 3 < float(printed.partition("more than 2 %: ")[2].partition(" %")[0]) < 7


def check_smoothing(printed):
    rows = {line.partition(" roughness")[0].strip(): line.replace("%", "").split() for line in printed.splitlines()}
    loss = {name: abs(float(words[-1])) for name, words in rows.items()}
    rough = {name: float(words[words.index("roughness") + 1]) for name, words in rows.items()}
    # As smooth as 15 averages, for less than a tenth of the lost volume.
    assert rough["t = 0.01"] <= rough["15 averages"]
    assert loss["t = 0.01"] < 0.1 * loss["15 averages"]


TWINS = {
    "starfish_posed.ply": "starfish.ply",
    "bennu_like_low.ply": "bennu_like.ply",
    "trefoil_cloud.xyzrgb": "trefoil_knot.ply",
}
SCRIPTS = {
    "canonical_pose.py": check_poses,
    "colours_on_a_starfish.py": check_starfish,
    "features_of_points.py": check_matches,
    "find_similar.py": check_hits,
    "inspect_scan.py": check_alignment,
    "smooth_without_shrinking.py": check_smoothing,
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_draws_its_picture(name, tmp_path):
    done = run_script(GALLERY / name, "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    SCRIPTS[name](done.stdout)
    assert [path.name for path in tmp_path.iterdir()] == [Path(name).with_suffix(".png").name]
    picture, shown = (Image.open(folder / Path(name).with_suffix(".png")) for folder in (tmp_path, PICTURES))
    # What the documentation shows is what the script draws. Not to the byte: other versions of libraries round
    # otherwise, and a rotation that symmetry leaves open may then be another one. Each strip stays as bright.
    assert picture.size == shown.size
    for own, other in zip(ImageStat.Stat(picture).mean, ImageStat.Stat(shown).mean, strict=True):
        assert abs(own - other) < 5  # of 255; a missing panel changes more


def test_gallery_is_complete():
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert {path.name for path in GALLERY.glob("*.py")} == set(SCRIPTS)
    for script in GALLERY.glob("*.py"):
        picture = PICTURES / script.with_suffix(".png").name
        assert f"images/gallery/{picture.name}" in page
        assert f"pipelines/gallery/{script.name}" in page
        assert picture.stat().st_size < 100_000  # the pages stay light
        text = script.read_text(encoding="utf-8")
        assert 50 <= len(text.splitlines()) <= 110
        assert "trade-off" in text or "price" in text or "pays" in text
