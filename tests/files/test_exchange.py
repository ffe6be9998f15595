"""Formats of CAD, printing, surveying and medicine: read as what they hold; damaged, refused in one line."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import read_geometry_file
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from tests.files import mutations
from tests.files.exchange import Exchange, exchange_files

FILES = exchange_files()
FLIPS, FLIPS_OF_NATIVE = 150, 30  # damaged copies of each file; a library takes its time, in a process of its own


def needed(file: Exchange) -> None:
    if file.needs:
        pytest.importorskip(file.needs, reason=f"{file.needs} is not installed: the extra of this format is absent")


def corners_of(geometry: MeshArrays | PointArrays) -> np.ndarray:
    """Triangles as sorted coordinates, each turned to begin with its smallest corner; points sorted."""
    if isinstance(geometry, PointArrays):
        return np.array(sorted(geometry.points.tolist()))
    corners = [[tuple(corner) for corner in triangle] for triangle in np.round(mesh_corners(geometry), 5).tolist()]
    return np.array(sorted(min(c[i:] + c[:i] for i in range(3)) for c in corners))


def mesh_corners(mesh: MeshArrays) -> np.ndarray:
    return mesh.vertices[mesh.triangles] + 0.0


EXPECTED = {
    "octahedron": corners_of(MeshArrays(mutations.VERTICES, mutations.TRIANGLES)),
    "cloud": corners_of(PointArrays(mutations.VERTICES)),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("isolated", [True, False])
def test_read_as_what_it_holds(name, isolated, tmp_path):
    file = FILES[name]
    needed(file)
    (tmp_path / name).write_bytes(file.data)
    found = read_geometry_file(tmp_path / name, isolated=isolated)
    if file.shape == "labels":
        assert [part.name for part in found.parts] == ["label 3", "label 7"]  # test_volumes.py looks closer
        return
    # 1e-5: how far corners were rounded, so that they sort the same way
    np.testing.assert_allclose(corners_of(found.geometry), EXPECTED[file.shape], atol=max(file.tolerance, 1e-5))
    if file.shape == "octahedron" and file.tolerance == 0:
        np.testing.assert_allclose(np.sort(found.geometry.vertices, axis=0), np.sort(mutations.VERTICES, axis=0), 1e-15)
    if found.parts:
        assert sum(part.triangles for part in found.parts) == len(getattr(found.geometry, "triangles", ()))


def damaged(name: str, data: bytes, folder: Path) -> str:
    """Read a damaged file; return "read" or "refused", and fail at anything between."""
    native = FILES[name].needs != ""
    try:
        if native:
            (folder / name).write_bytes(data)
            read_geometry_file(folder / name, timeout=60)
        else:
            parse_content(f"/{name}", data)
    except GeometryReadError as error:
        message = str(error)
        assert message.isprintable() and len(message) < 600, message
        assert native or "cannot be parsed" not in message, f"no parser foresaw it: {message}"
        return "refused"
    return "read"


@pytest.mark.parametrize("name", FILES)
def test_cut_off_is_refused(name, tmp_path):
    file = FILES[name]
    needed(file)
    whole = len(file.data) - file.tail
    shares = np.linspace(0, 1, 12 if file.needs else 60, endpoint=False)
    for size in sorted({int(whole * share) for share in shares} | {whole - 1}):
        assert damaged(name, file.data[:size], tmp_path) == "refused", size


@pytest.mark.parametrize("name", FILES)
def test_flipped_bits_and_other_damage_are_refused_or_read(name, tmp_path):
    file = FILES[name]
    needed(file)
    rng = random.Random(name)
    files = [mutations.SampleFile(name, file.data)]
    outcomes = []
    for number in range(FLIPS_OF_NATIVE if file.needs else FLIPS):
        if number % 2:
            data = bytearray(file.data)
            for _ in range(rng.choice((1, 1, 1, 3))):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        else:
            damage = mutations.DAMAGES[number // 2 % len(mutations.DAMAGES)]
            data = damage(files[0], rng, files).data
        outcomes.append(damaged(name, bytes(data), tmp_path))
    assert "refused" in outcomes


@pytest.mark.parametrize("name", FILES)
def test_other_content_under_its_name_is_refused(name, tmp_path):
    needed(FILES[name])
    for content in (
        b"",
        b"\n\n",
        mutations.valid_files()["plain.off"].data,
        b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 8,
    ):
        assert damaged(name, content, tmp_path) == "refused"
