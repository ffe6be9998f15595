"""LAS and LAZ: millimetres far from the origin, versions and formats of points, and what laspy says."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import read_geometry_arrays, write_geometry
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry import PointArrays
from tests.files.mutations import COLORS, VERTICES

FAR = np.array([500_000.0, 5_400_000.0, 300.0])  # a place in a national grid, in metres
pytest.importorskip("lazrs", reason="lazrs is not installed: the extra of this format is absent")


def laspy_bytes(points: np.ndarray, kind: int, version: str, *, packed: bool, scale: float = 0.001, **fields) -> bytes:
    laspy = pytest.importorskip("laspy", reason="laspy, a second opinion, is not installed")
    header = laspy.LasHeader(point_format=kind, version=version)
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.full(3, scale)
    las = laspy.LasData(header)
    las.xyz = points
    for name, values in fields.items():
        setattr(las, name, values)
    buffer = io.BytesIO()
    las.write(buffer, do_compress=packed, laz_backend=laspy.LazBackend.Lazrs if packed else None)
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_millimetres_survive_at_500_km(suffix, tmp_path):
    """Steps of a millimetre, as far from the origin as national grids are: float64 keeps 1e-9 there."""
    steps = np.arange(30).reshape(-1, 3) * 0.001
    data = laspy_bytes(FAR + steps, 3, "1.2", packed=suffix == ".laz")
    (tmp_path / f"far{suffix}").write_bytes(data)
    found = read_geometry_arrays(tmp_path / f"far{suffix}").points
    np.testing.assert_allclose(found - FAR, steps, atol=2e-9)  # twice the spacing of float64 at 5.4e6
    write_geometry(tmp_path / f"again{suffix}", PointArrays(found))
    again = read_geometry_arrays(tmp_path / f"again{suffix}").points
    np.testing.assert_allclose(again - FAR, steps, atol=4e-9)


@pytest.mark.parametrize("kind", range(11))
@pytest.mark.parametrize("packed", [False, True])
def test_every_format_of_points(kind, packed):
    if kind in (4, 5, 9, 10) and packed:
        pytest.skip("lazrs writes no waveforms")
    fields = {}
    if kind in (2, 3, 5, 7, 8, 10):
        fields = dict(zip(("red", "green", "blue"), COLORS.T.astype(np.uint16) * 257, strict=True))
    data = laspy_bytes(VERTICES, kind, "1.4" if kind > 3 else "1.2", packed=packed, **fields)
    found = parse_content("/a.laz" if packed else "/a.las", data).geometry
    np.testing.assert_allclose(found.points, VERTICES, atol=1e-12)
    assert (found.colors is not None) == bool(fields)
    if fields:
        np.testing.assert_allclose(found.colors, COLORS / 255, atol=1e-15)


def test_colours_of_eight_bits_and_points_marked_as_deleted():
    colors = dict(zip(("red", "green", "blue"), COLORS.T.astype(np.uint16), strict=True))
    for kind in (2, 7):
        withheld = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)
        data = laspy_bytes(VERTICES, kind, "1.4", packed=False, withheld=withheld, **colors)
        found = parse_content("/a.las", data)
        np.testing.assert_allclose(found.geometry.points, VERTICES[[0, 2, 3, 4, 5]], atol=1e-12)
        np.testing.assert_allclose(found.geometry.colors, COLORS[[0, 2, 3, 4, 5]] / 255, atol=1e-15)
        assert found.notes == ("1 point marked as deleted left out",)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_laspy_reads_what_is_written(suffix, tmp_path):
    laspy = pytest.importorskip("laspy", reason="laspy, a second opinion, is not installed")
    write_geometry(tmp_path / f"a{suffix}", PointArrays(VERTICES * np.pi, colors=COLORS / 255))
    las = laspy.read(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(las.xyz, VERTICES * np.pi, atol=1e-8)  # the scale it is written with
    np.testing.assert_array_equal(np.stack([las.red, las.green, las.blue], axis=1), COLORS * 257)
    np.testing.assert_allclose(las.header.mins, las.xyz.min(axis=0), atol=1e-12)
    np.testing.assert_allclose(las.header.maxs, las.xyz.max(axis=0), atol=1e-12)


def test_refused_with_the_reason():
    def refuse(data: bytes, reason: str) -> None:
        with pytest.raises(GeometryReadError, match=reason):
            parse_content("/a.las", data)

    data = laspy_bytes(VERTICES, 2, "1.2", packed=False)
    refuse(data[:-1], "truncated: 6 points need 156 bytes, but 155 follow")
    refuse(data[:100], "the header breaks off")
    refuse(b"LASX" + data[4:], "does not begin with 'LASF'")
    refuse(data[:24] + b"\2" + data[25:], "a version that is not known: 2.2")
    refuse(data[:107] + b"\0\0\0\0" + data[111:], "announces 0 points")
    refuse(data[:131] + bytes(8) + data[139:], "scale or offset")
    refuse(data[:105] + b"\3" + data[106:], "points of format 2 cannot have 3 bytes")
    packed = laspy_bytes(VERTICES, 2, "1.2", packed=True)
    bomb = packed[:107] + b"\xff\xff\xff\xff" + packed[111:]
    refuse(bomb, "unpack to more than")
    refuse(packed.replace(b"laszip encoded", b"lazzip encoded"), "does not say how")


def test_without_lazrs_one_line_names_the_extra(monkeypatch, tmp_path):
    packed = laspy_bytes(VERTICES, 2, "1.2", packed=True)
    monkeypatch.setitem(sys.modules, "lazrs", None)
    with pytest.raises(GeometryReadError, match=r"a\.laz: LAZ files need the package lazrs.*'fsh3d-o3d\[formats\]'$"):
        parse_content("/a.laz", packed)
    with pytest.raises(ValueError, match=r"\.laz needs the package lazrs: pip install 'fsh3d-o3d\[formats\]'; \.las"):
        write_geometry(tmp_path / "a.laz", PointArrays(VERTICES))
    assert not list(tmp_path.iterdir())
