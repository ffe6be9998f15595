from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.reading import read_geometry_file
from fsh3d_o3d.geometry.arrays import MeshArrays
from tests.files import mutations

COUNT = 690  # 23 files, 10 kinds of damage, three times
LARGEST = 64 * 2**20  # bytes: thousands of times the size of the files, and far below what their headers may announce


def check(path, *, isolated: bool) -> str:
    """Read a damaged file; return "read" or "refused", and fail at anything between."""
    try:
        geometry = read_geometry_file(path, isolated=isolated, timeout=20).geometry
    except GeometryReadError as error:
        message = str(error)
        assert message.startswith(f"{path}: ") and message.isprintable() and len(message) < 600, message
        assert "cannot be parsed" not in message, f"no parser foresaw it: {message}"
        assert "the reader" not in message, message
        return "refused"
    if isinstance(geometry, MeshArrays):
        points = geometry.vertices
        assert len(geometry.triangles) >= 1
        assert geometry.triangles.min() >= 0 and geometry.triangles.max() < len(points)
    else:
        points = geometry.points
    assert len(points) >= 1 and np.isfinite(points).all()
    return "read"


def test_damaged_files_are_read_or_refused_within_little_memory(tmp_path):
    outcomes = []
    tracemalloc.start()
    try:
        for file in mutations.mutated_files(COUNT):
            path = tmp_path / file.name
            path.write_bytes(file.data)
            outcomes.append(check(path, isolated=False))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < LARGEST
    # Both happen, or the damage is not what it should be.
    assert outcomes.count("refused") > COUNT // 2 and outcomes.count("read") > COUNT // 20


def test_damaged_files_do_no_harm_to_the_separate_reader(tmp_path):
    outcomes = set()
    for file in mutations.mutated_files(230, seed=1):
        path = tmp_path / file.name
        path.write_bytes(file.data)
        outcomes.add(check(path, isolated=True))
    assert outcomes == {"read", "refused"}


def test_mutations_are_the_same_at_every_run():
    first, second = (list(mutations.mutated_files(100, seed=7)) for _ in range(2))
    assert first == second != list(mutations.mutated_files(100, seed=8))
    assert len({file.name for file in first}) == 100


@pytest.mark.parametrize("name", ["plain.off", "plain.obj", "text.ply", "points.xyz", "text.pcd", "text.stl"])
def test_text_holds_against_any_single_byte(name, tmp_path):
    """One byte of each kind at some 150 places: what makes other numbers, and what makes none."""
    data = mutations.valid_files()[name].data
    path = tmp_path / name
    for place in range(0, len(data), len(data) // 150 + 1):
        for byte in (b"\0", b"-", b".", b" ", b"\n", b"e", b"\xff"):
            path.write_bytes(data[:place] + byte + data[place + 1 :])
            check(path, isolated=False)
