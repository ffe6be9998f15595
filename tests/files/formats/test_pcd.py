from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry.arrays import PointArrays
from tests.files import mutations

TEXT, BINARY, PACKED = (mutations.valid_files()[f"{name}.pcd"].data for name in ("text", "binary", "compressed"))


def read(data: bytes) -> tuple[PointArrays, str]:
    found = parse_content("/a.pcd", data)
    assert isinstance(found.geometry, PointArrays)
    return found.geometry, "; ".join(found.notes)


def without(*names: bytes) -> bytes:
    return re.sub(rb"(?m)^(%s) .*\n" % b"|".join(names), b"", TEXT)


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (without(b"WIDTH", b"HEIGHT"), "no WIDTH and HEIGHT; POINTS tells"),
        (without(b"WIDTH"), "no WIDTH; POINTS tells"),
        (without(b"HEIGHT", b"POINTS"), "no HEIGHT; it was taken for 1"),
        (without(b"COUNT", b"VERSION", b"VIEWPOINT", b"POINTS"), ""),
        (TEXT.replace(b"WIDTH 6\nHEIGHT 1", b"HEIGHT 3\nWIDTH 2"), ""),
        (TEXT.replace(b"VERSION 0.7", b"VERSION .5").replace(b"FIELDS", b"COLUMNS"), ""),
        (TEXT.replace(b"x y z normal_x normal_y normal_z rgb", b"X Y Z Normal_X NY nz RGB"), ""),
        (TEXT.replace(b"DATA ascii", b"data ASCII").replace(b"FIELDS", b"Fields"), ""),
        (TEXT.replace(b"\n", b"\r\n"), ""),
        (TEXT.replace(b"\n", b"\r"), ""),
        (b"# by hand: \xe4\xf6\xfc\n" + TEXT, ""),
        (TEXT + b"\n\n", ""),
        (BINARY.replace(b"\nVER", b"\r\nVER").replace(b"binary\n", b"binary\r\n"), ""),
        (BINARY + b"\n", ""),
        (BINARY + b"the end", "7 bytes behind the 6 points"),
        (BINARY + bytes(4096), ""),
        (PACKED + bytes(4096), ""),
        (PACKED + b"the end", "7 bytes behind the compressed points"),
    ],
)
def test_odd_but_sound(data, note):
    cloud, notes = read(data)
    np.testing.assert_array_equal(cloud.points, mutations.VERTICES)
    np.testing.assert_allclose(cloud.normals, mutations.NORMALS, atol=1e-7)  # float32 in the binary files
    np.testing.assert_allclose(cloud.colors, mutations.COLORS / 255, atol=1e-15)  # eight bits divided by 255
    assert note in notes if note else not notes


def test_first_versions_have_float32_fields_without_saying_so():
    points = mutations.VERTICES.astype("<f4")
    cloud, notes = read(b"VERSION .5\nFIELDS x y z\nPOINTS 6\nDATA binary\n" + points.tobytes())
    np.testing.assert_array_equal(cloud.points, mutations.VERTICES)
    assert "no SIZE and TYPE" in notes


@pytest.mark.parametrize(("kind", "scale"), [("U", 255), ("F", 255), ("F", 1)])
def test_colours_in_fields_of_their_own(kind, scale):
    size = {"U": 1, "F": 4}[kind]
    code = {"U": "B", "F": "f"}[kind]
    head = (
        f"WIDTH 6\nHEIGHT 1\nFIELDS x y z r g b\nSIZE 4 4 4{f' {size}' * 3}\nTYPE F F F{f' {kind}' * 3}\nDATA binary\n"
    )
    colors = mutations.COLORS * scale // 255 if scale == 255 else mutations.COLORS / 255
    rows = zip(mutations.VERTICES.tolist(), colors.tolist(), strict=True)
    cloud, _ = read(head.encode() + b"".join(struct.pack(f"<3f3{code}", *point, *color) for point, color in rows))
    np.testing.assert_allclose(cloud.colors, mutations.COLORS / 255, atol=1e-7)  # float32


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (without(b"FIELDS"), "the header is damaged (FIELDS is missing)"),
        (without(b"TYPE"), "the header is damaged (TYPE is missing)"),
        (without(b"WIDTH", b"POINTS"), "neither WIDTH and HEIGHT nor POINTS is there"),
        (without(b"DATA"), "the header has no DATA line"),
        (TEXT.replace(b"POINTS 6", b"POINTS 5"), "announces 5 points, width times height is 6"),
        (without(b"WIDTH", b"HEIGHT").replace(b"POINTS 6", b"POINTS 5"), "announces 5 points, but 6 lines follow"),
        (BINARY.replace(b"POINTS 6", b"POINTS 5").replace(b"WIDTH 6", b"WIDTH 5"), "28 bytes follow the 5 points"),
        (BINARY[:-1], "truncated: 6 points need 168 bytes, but 167 follow"),
        (PACKED[:-1], "truncated"),
        (TEXT.replace(b"FIELDS x", b"FIELDS w"), "there are no fields x, y and z"),
        (TEXT.replace(b"DATA ascii", b"DATA zip"), "DATA must be ascii, binary or binary_compressed, found 'zip'"),
    ],
)  # fmt: skip
def test_damaged_is_refused_with_the_right_reason(data, reason):
    with pytest.raises(GeometryReadError, match=re.escape(reason)):
        read(data)


def test_compressed_sizes_that_lie():
    at = PACKED.index(b"binary_compressed\n") + len(b"binary_compressed\n")
    for place in (at, at + 4):
        size = int.from_bytes(PACKED[place : place + 4], "little")
        for lie in (0, 1, size - 1, size + 1, 2**31, 2**32 - 1):
            with pytest.raises(GeometryReadError, match=r"truncated|damaged"):
                read(PACKED[:place] + struct.pack("<I", lie) + PACKED[place + 4 :])
