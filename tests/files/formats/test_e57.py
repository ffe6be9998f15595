"""E57: scans with poses, numbers of odd widths, what is marked as invalid, and what pye57 says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from tests.files.exchange import Scan, e57_bytes
from tests.files.mutations import COLORS, VERTICES

with pytest.MonkeyPatch.context() as _patch:
    _patch.syspath_prepend(str(Path(__file__).parents[3] / "samples"))
    from _survey_writers import checksum, packed_bits

TURN = (0.5, 0.5, 0.5, 0.5)  # x becomes y, y becomes z, z becomes x
SHIFT = (1.0, 2.0, 3.0)
MANY = np.random.default_rng(3).uniform(-20, 20, (5000, 3)).round(4)


def read(data: bytes):
    return parse_content("/a.e57", data)


def test_scans_are_placed_by_their_poses_and_told_apart():
    invalid = np.arange(6) == 2
    found = read(
        e57_bytes([Scan("north", VERTICES, TURN, SHIFT, COLORS / 255, invalid), Scan("south", MANY, colors=MANY * 0)])
    )
    assert [(part.name, part.points) for part in found.parts] == [("north", 5), ("south", 5000)]
    assert found.notes == ("1 point marked as invalid left out",)
    placed = np.roll(VERTICES, 1, axis=1)[~invalid] + SHIFT
    np.testing.assert_allclose(found.geometry.points[:5], placed, atol=1e-12)
    np.testing.assert_allclose(found.geometry.points[5:], MANY, atol=1e-12)
    np.testing.assert_allclose(found.geometry.colors[:5], COLORS[~invalid] / 255, atol=1e-15)


def test_checksum_and_bits():
    assert checksum(b"123456789") == 0xE3069283  # the check value of CRC-32C
    assert packed_bits(np.array([1, 2, 3]), 3) == bytes([0b11010001, 0])


def test_a_millimetre_survives_at_500_km():
    steps = np.arange(30).reshape(-1, 3) * 0.001
    far = (500_000.0, 5_400_000.0, 300.0)
    found = read(e57_bytes([Scan("far", steps, translation=far)])).geometry.points
    np.testing.assert_allclose(found - far, steps, atol=2e-9)  # twice the spacing of float64 at 5.4e6


def test_pye57_agrees(tmp_path):
    pye57 = pytest.importorskip("pye57", reason="pye57, a second opinion, is not installed")
    path = tmp_path / "a.e57"
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), MANY.T.astype(np.float32), strict=True))
    file = pye57.E57(str(path), mode="w")
    file.write_scan_raw(data, name="first", rotation=np.array(TURN), translation=np.array(SHIFT))
    file.close()
    theirs = read(path.read_bytes()).geometry.points
    np.testing.assert_allclose(theirs, np.roll(MANY.astype(np.float32), 1, axis=1) + np.array(SHIFT), atol=1e-6)
    path.write_bytes(e57_bytes([Scan("first", MANY, TURN, SHIFT)]))
    scan = pye57.E57(str(path)).read_scan(0, ignore_missing_fields=True)
    ours = np.stack([scan[name] for name in data], axis=1)
    np.testing.assert_allclose(read(path.read_bytes()).geometry.points, ours, atol=1e-9)


def test_refused_with_the_reason():
    def refuse(data: bytes, reason: str) -> None:
        with pytest.raises(GeometryReadError, match=reason):
            read(data)

    data = e57_bytes([Scan("one", VERTICES)])

    def changed(old: bytes, new: bytes) -> bytes:
        """With the checksums made right again: a hostile file, not a damaged one."""
        logical = b"".join(data[at : at + 1020] for at in range(0, len(data), 1024)).replace(old, new)
        pages = [logical[at : at + 1020] for at in range(0, len(logical), 1020)]
        return b"".join(page + checksum(page).to_bytes(4, "big") for page in pages)

    refuse(data[:-1], "truncated: the header announces 2048 bytes, the file has 2047")
    refuse(data[:700] + b"x" + data[701:], "the checksum of page 0 and 0 more is wrong")
    refuse(changed(b'recordCount="6"', b'recordCount="9"'), "9 points need 22 bytes of 'cartesianX', but 15 are there")
    refuse(changed(b'recordCount="6"', b'recordCount="x"'), "'x' of 'recordCount' should be a whole number")
    refuse(changed(b'fileOffset="48"', b'fileOffset="90"'), "there are none|beyond its end|other columns")
    refuse(changed(b"cartesianX", b"cartesianQ"), "neither Cartesian nor spherical")
    refuse(changed(b'maximum="262143"', b'maximum="262x43"'), "should be a whole number")
    refuse(changed(b"<data3D", b"<data4D").replace(b"a", b"a"), "no whole XML")
