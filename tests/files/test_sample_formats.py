"""One small file a format, made by our own script, reads to the same surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.files import READABLE_FORMATS, format_of, read_geometry_arrays, read_geometry_file
from fsh3d_o3d.geometry import EdgeTable
from tests.files.exchange import exchange_files

SAMPLES = Path(__file__).parents[2] / "samples"
BRACKETS = sorted(path.name for path in (SAMPLES / "formats").glob("bracket.*"))
BALLS = sorted(path.name for path in (SAMPLES / "formats").glob("ball.*"))
LABELS = sorted(path.name for path in (SAMPLES / "formats").glob("labels.*"))
NEEDS = {Path(file.name).suffix: file.needs for file in exchange_files().values() if file.needs}
VOLUME = (40 * 8 + 8 * 22) * 20  # of the bracket


def path_of(name: str) -> Path:
    module = NEEDS.get(Path(name).suffix)
    if module:
        pytest.importorskip(module, reason=f"{module} is not installed: the extra of this format is absent")
    return SAMPLES / "formats" / name


def test_there_is_one_of_each_format():
    older = {path.suffix for path in SAMPLES.glob("*.*")}
    spellings = {".stp", ".iges", ".nhdr", ".tiff"}  # other names of formats that are there
    others = {".npz", ".gltf", ".pts", ".xyz"}  # written by the package itself, or simple texts
    there = older | {format_of(name).removesuffix(".gz") for name in (*BRACKETS, *BALLS, *LABELS)}
    assert {*READABLE_FORMATS} - there <= spellings | others


@pytest.mark.parametrize("name", BRACKETS)
def test_brackets_are_the_same_surface(name):
    expected = read_geometry_arrays(SAMPLES / "formats" / "bracket.ply")
    found = read_geometry_arrays(path_of(name))
    assert (EdgeTable(found.triangles).faces == 2).all()
    volume = np.linalg.det(found.vertices[found.triangles]).sum() / 6
    assert volume == pytest.approx(VOLUME, rel=1e-6)  # float32, where OpenCASCADE is on the way
    np.testing.assert_allclose(
        np.unique(found.vertices.round(3), axis=0), np.unique(expected.vertices.round(3) + 0.0, axis=0), atol=1e-3
    )
    assert fsh.surface_error(expected, found).relative().maximum < 1e-6


@pytest.mark.parametrize("name", BALLS)
def test_balls_are_the_same_points(name):
    expected = read_geometry_arrays(SAMPLES / "coloured_ball.pcd")
    found = read_geometry_arrays(path_of(name))
    assert len(found.points) == 1200
    # 1e-4: the step of E57. Sorted one axis by itself, as rounding may change the order of points.
    np.testing.assert_allclose(np.sort(found.points, axis=0), np.sort(expected.points, axis=0), atol=1e-4)
    np.testing.assert_allclose(np.sort(found.colors, axis=0), np.sort(expected.colors, axis=0), atol=1 / 255)


@pytest.mark.parametrize("name", LABELS)
def test_labels_are_the_same_two_surfaces(name):
    expected = read_geometry_arrays(SAMPLES / "formats" / "labels.nrrd")
    found = read_geometry_file(path_of(name))
    scale = np.array([0.5, 0.75, 1.0]) if name.endswith(".npy") else np.ones(3)
    np.testing.assert_allclose(found.geometry.vertices * scale, expected.vertices, atol=1e-5)  # spacing as float32
    np.testing.assert_array_equal(found.geometry.triangles, expected.triangles)
    parts = fsh.read_geometry_parts(path_of(name))
    assert [label for label, _ in parts] == ["label 1", "label 2"]
    assert all(surface.is_watertight() for _, surface in parts)


def test_parts_of_a_file():
    upper, lower = fsh.read_geometry_parts(SAMPLES / "formats" / "ball.e57", kind="tensor")
    assert (upper[0], lower[0]) == ("upper", "lower")
    assert float(upper[1].point.positions[:, 2].min().item()) > 0 > float(lower[1].point.positions[:, 2].min().item())
    (name, whole), *none = fsh.read_geometry_parts(SAMPLES / "gem.stl")
    assert name == "gem.stl" and len(whole.triangles) == 94 and not none
    assert [part for part, _ in fsh.read_geometry_parts(SAMPLES / "formats" / "bracket.3mf")] == ["part"]
