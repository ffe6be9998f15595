"""Every dialect is read as what it holds; cut off, it is refused; trimesh is the second opinion."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import reading
from fsh3d_o3d.files.formats import PARSERS
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from tests.files import mutations
from tests.files.dialects import NO_READER, Dialect
from tests.files.dialects_clouds import cloud_dialects
from tests.files.dialects_gltf import gltf_dialects
from tests.files.dialects_polygons import polygon_dialects
from tests.files.dialects_stl import stl_dialects
from tests.files.exchange import FORMATS
from tests.files.test_reader_fuzz import check as check_damaged

DIALECTS = [*stl_dialects(), *cloud_dialects(), *gltf_dialects(), *polygon_dialects()]
LEAST = 200
_MISSING_READERS = {".pcd", ".pts", ".xyzn", ".xyzrgb"}
_BOX = (6.0, 22.0)  # volume and area of 1 x 2 x 3


def canonical(vertices: np.ndarray, triangles: np.ndarray) -> list:
    """Triangles as coordinates, each turned to begin with its smallest corner, sorted: free of any numbering."""
    corners = [[tuple((vertices[i] + 0.0).tolist()) for i in triangle] for triangle in triangles]
    return sorted(min(c[i:] + c[:i] for i in range(3)) for c in corners)


EXPECTED = canonical(mutations.VERTICES, mutations.TRIANGLES)


def measures(vertices: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
    """Volume and area."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    return float((a * normals).sum() / 6), float(np.linalg.norm(normals, axis=1).sum() / 2)


def wrong(dialect: Dialect, geometry: MeshArrays | PointArrays) -> str:
    """What is not as it should be, or nothing."""
    if dialect.shape == "cloud":
        if not isinstance(geometry, PointArrays):
            return "not a cloud"
        if not np.array_equal(geometry.points, mutations.VERTICES):
            return "other points"
        for name, there, truth in (
            ("normals", dialect.normals, mutations.NORMALS),
            ("colors", dialect.colors, mutations.COLORS / 255),
        ):
            found = getattr(geometry, name)
            # 1e-6: normals and colours are float32 or six digits in some of the files
            if (found is not None) != there or (there and np.abs(found - truth).max() > 1e-6):
                return f"other {name}"
        return ""
    if not isinstance(geometry, MeshArrays):
        return "not a mesh"
    return wrong_surface(dialect, geometry.vertices, geometry.triangles)


def wrong_surface(dialect: Dialect, vertices: np.ndarray, triangles: np.ndarray) -> str:
    if dialect.shape == "box":
        found = measures(vertices, triangles)
        return "" if np.allclose(found, _BOX, atol=1e-9) else f"volume and area {found}"
    return "" if canonical(vertices, triangles) == EXPECTED else "other triangles"


def failures(check: Callable[[Dialect], str]) -> str:
    """Names of dialects and what is wrong with them: all at once, as one fault often has many."""
    return "\n".join(f"{dialect.name}: {said}" for dialect in DIALECTS if (said := check(dialect)))


@pytest.fixture
def folder(tmp_path) -> Callable[[Dialect], Path]:
    def write(dialect: Dialect) -> Path:
        for name, data in ((dialect.name, dialect.data), *dialect.beside.items()):
            (tmp_path / name).write_bytes(data)
        return tmp_path / dialect.name

    return write


def test_there_are_many_of_each_format():
    assert len({dialect.name for dialect in DIALECTS}) == len(DIALECTS) >= LEAST
    assert {Path(dialect.name).suffix for dialect in DIALECTS} | FORMATS == set(PARSERS)


def test_every_dialect_is_read_as_what_it_holds_by_one_reader(folder):
    processes = set()

    def check(dialect: Dialect) -> str:
        try:
            found = reading.read_geometry_file(folder(dialect)).geometry
        except GeometryReadError as error:
            return str(error).rpartition(f"{dialect.name}: ")[2]
        finally:
            processes.add(reading._reader._process.pid)
        return wrong(dialect, found)

    found = failures(check)
    assert not found, found
    assert len(processes) == 1


def test_what_is_cut_off_is_refused_or_cannot_show():
    """Where nothing counts, a cut at the end of a line goes unseen; it must not make points or corners that are new."""

    def check(dialect: Dialect) -> str:
        for data in dialect.prefixes:
            try:
                parse_content(f"/{dialect.name}", data)
            except GeometryReadError:
                continue
            if not dialect.cut:
                return f"read from {len(data)} of {len(dialect.data)} bytes"
        return ""

    found = failures(check)
    assert not found, found


def test_damaged_dialects_are_read_or_refused(tmp_path):
    """Each with each kind of damage."""
    files = [mutations.SampleFile(dialect.name, dialect.data) for dialect in DIALECTS]
    outcomes = []
    for file in mutations.mutated_files(len(files) * len(mutations.DAMAGES), files=files):
        path = tmp_path / file.name
        path.write_bytes(file.data)
        outcomes.append(check_damaged(path, isolated=False))
        path.unlink()
    assert {*outcomes} == {"read", "refused"}


def test_trimesh_agrees_or_the_table_says_why_not(folder):
    def check(dialect: Dialect) -> str:
        reason = dialect.trimesh or (NO_READER if Path(dialect.name).suffix in _MISSING_READERS else "")
        said = _by_trimesh(dialect, folder(dialect))
        if reason and not said:
            return f"trimesh agrees, though '{reason}'"
        return "" if reason else said

    found = failures(check)
    assert not found, found


def _by_trimesh(dialect: Dialect, path: Path) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = trimesh.load(path, process=False, force="mesh" if dialect.shape != "cloud" else None)
        except Exception as error:
            return f"trimesh: {type(error).__name__} {error}"[:200]
    if dialect.shape == "cloud":
        points = np.asarray(getattr(found, "vertices", np.empty((0, 3))))
        same = points.shape == mutations.VERTICES.shape and np.array_equal(np.round(points, 6), mutations.VERTICES)
        return "" if same else "trimesh: other points"
    if not isinstance(found, trimesh.Trimesh) or not len(found.faces):
        return "trimesh: no mesh"
    said = wrong_surface(dialect, np.round(found.vertices, 6), found.faces)
    return f"trimesh: {said}" if said else ""
