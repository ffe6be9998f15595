"""Meshopt streams: those of the reference encoder, and larger ones that a plain encoder here writes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsh3d_o3d.files.formats.gltf.meshopt import decode_meshopt
from tests.files.formats.gltf.meshopt_streams import FILTERED, SHEET

SIDE = 9


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """Vertices (81, 4) as shorts, and triangles."""
    y, x = np.mgrid[:SIDE, :SIDE]
    vertices = np.stack([100 * x, -7 * y, x * y * y, 0 * x], axis=-1).reshape(-1, 4).astype("<i2")
    a = (y * SIDE + x)[:-1, :-1].ravel()
    triangles = np.stack([a, a + 1, a + SIDE, a + 1, a + SIDE + 1, a + SIDE], axis=1).reshape(-1, 3)
    return vertices, triangles


def plain_attributes(items: np.ndarray, version: int) -> bytes:
    """Pack (n, stride) bytes with 8 bits for each delta, the first item as the baseline."""
    count, stride = items.shape
    steps = np.diff(items, axis=0, prepend=items[:1])
    coded = np.where(steps & 128, ~(steps << 1), steps << 1).astype(np.uint8)
    out = bytearray([0xA0 + version])
    size = min(8192 // stride // 16 * 16, 256)
    for row in range(0, count, size):
        block = coded[row : row + size]
        groups = -(-len(block) // 16)
        if version == 1:
            out += b"\xff" * (stride // 4)
        for column in range(stride):
            if version == 0:
                out += b"\xff" * -(-groups // 4)
            out += block[:, column].tobytes() + b"\0" * ((16 * groups - len(block)) * (version == 0))
    tail = items[0].tobytes() + bytes(stride // 4 * version)
    return bytes(out) + tail.rjust(24 if version else 32, b"\0")


def plain_triangles(triangles: np.ndarray) -> bytes:
    """Pack triangles with each corner spelt out."""
    steps = np.diff(triangles.ravel().astype(np.int64), prepend=0)
    rest = bytearray()
    for number, step in enumerate(steps.tolist()):
        if number % 3 == 0:
            rest.append(0xFF)
        value = step << 1 if step >= 0 else ~(step << 1)
        while value > 127:
            rest.append(value & 127 | 128)
            value >>= 7
        rest.append(value)
    return b"\xe1" + b"\xff" * len(triangles) + bytes(rest) + bytes(16)


@pytest.mark.parametrize("version", [0, 1])
def test_streams_of_the_reference_encoder(version):
    vertices, triangles = sheet()
    count = len(vertices)
    shorts = decode_meshopt(SHEET[f"shorts{version}"], count, 8, "ATTRIBUTES", "NONE").view("<i2").reshape(-1, 4)
    np.testing.assert_array_equal(shorts, vertices)
    floats = decode_meshopt(SHEET[f"floats{version}"], count, 12, "ATTRIBUTES", "NONE").view("<f4").reshape(-1, 3)
    np.testing.assert_array_equal(floats, vertices[:, :3] / 8)
    listed = decode_meshopt(SHEET["indices"], triangles.size, 2, "INDICES", "NONE").view("<u2").reshape(-1, 3)
    np.testing.assert_array_equal(listed, triangles)
    again = decode_meshopt(SHEET["triangles"], triangles.size, 2, "TRIANGLES", "NONE").view("<u2").reshape(-1, 3)
    # The encoder may turn a triangle to begin with another corner.
    first = again.argmin(axis=1)
    turned = np.take_along_axis(again, (first[:, None] + np.arange(3)) % 3, axis=1)
    np.testing.assert_array_equal(turned, triangles)


@pytest.mark.parametrize(("name", "stride"), FILTERED)
def test_filters_agree_with_the_reference_decoder(name, stride):
    stream, expected = FILTERED[name, stride]
    found = decode_meshopt(stream, 5, stride, "ATTRIBUTES", name)
    if name == "EXPONENTIAL":
        np.testing.assert_array_equal(found, np.frombuffer(expected, np.uint8))
        return
    dtype = f"<{'u' if name == 'COLOR' else 'i'}{stride // 4}"
    other = np.frombuffer(expected, dtype)
    # The format leaves the last unit open.
    assert np.abs(found.view(dtype).astype(int) - other).max() <= 1


@pytest.mark.parametrize("stride", [4, 12, 64, 256])
@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("count", [1, 16, 17, 255, 257, 1000])
def test_any_items_of_any_size(stride, version, count):
    items = np.random.default_rng(stride + count).integers(0, 256, (count, stride), dtype=np.uint8)
    found = decode_meshopt(plain_attributes(items, version), count, stride, "ATTRIBUTES", "NONE")
    np.testing.assert_array_equal(found.reshape(count, stride), items)


@settings(max_examples=100)
@given(st.lists(st.tuples(*[st.integers(0, 2**31 - 1)] * 3), min_size=1, max_size=40))
def test_any_triangles(triangles):
    array = np.array(triangles)
    found = decode_meshopt(plain_triangles(array), array.size, 4, "TRIANGLES", "NONE").view("<u4")
    np.testing.assert_array_equal(found.reshape(-1, 3), array)


@pytest.mark.parametrize(
    ("stream", "count", "stride", "mode", "reason"),
    [
        (b"", 1, 4, "ATTRIBUTES", "unknown version"),
        (b"", 3, 4, "TRIANGLES", "unknown version"),
        (b"", 3, 4, "INDICES", "unknown version"),
        (b"\xa0" + bytes(100), 10**12, 256, "ATTRIBUTES", "truncated: 101 bytes for 1000000000000 items"),
        (b"\xa1" + bytes(100), 10**12, 4, "ATTRIBUTES", "truncated: 101 bytes for 1000000000000 items"),
        (b"\xe1" + bytes(100), 10**12, 4, "TRIANGLES", "truncated"),
        (b"\xd1" + bytes(100), 10**12, 4, "INDICES", "96|100 indices instead of 1000000000000"),
        (SHEET["shorts1"], 81, 6, "ATTRIBUTES", "items of 6 bytes"),
        (SHEET["shorts1"], 81, 8, "VERTICES", "the mode 'VERTICES'"),
        (SHEET["shorts1"], 80, 8, "ATTRIBUTES", "left over|truncated"),
        (SHEET["triangles"], 381, 2, "TRIANGLES", "left over|not there|truncated|damaged"),
        (b"\xe1\x00" + bytes(16), 3, 2, "TRIANGLES", "refer to what is not there"),
        (b"\xd1" + b"\xff" * 6 + b"\1" + bytes(4), 1, 2, "INDICES", "more than five bytes"),
    ],
)
def test_damaged_streams_are_refused(stream, count, stride, mode, reason):
    with pytest.raises(ValueError, match=reason):
        decode_meshopt(stream, count, stride, mode, "NONE")


@pytest.mark.parametrize(
    ("name", "mode"), [("floats1", "ATTRIBUTES"), ("triangles", "TRIANGLES"), ("indices", "INDICES")]
)
def test_every_truncation_is_refused(name, mode):
    count, stride = (81, 12) if mode == "ATTRIBUTES" else (384, 2)
    for size in range(len(SHEET[name])):
        with pytest.raises(ValueError):
            decode_meshopt(SHEET[name][:size], count, stride, mode, "NONE")


@pytest.mark.parametrize(
    ("name", "mode"), [("floats0", "ATTRIBUTES"), ("floats1", "ATTRIBUTES"), ("triangles", "TRIANGLES")]
)
def test_damaged_bytes_are_decoded_or_refused(name, mode):
    count, stride = (81, 12) if mode == "ATTRIBUTES" else (384, 2)
    rng = np.random.default_rng(0)
    outcomes = set()
    for _ in range(500):
        data = bytearray(SHEET[name])
        data[rng.integers(len(data))] = rng.integers(256)
        try:
            outcomes.add(len(decode_meshopt(bytes(data), count, stride, mode, "NONE")))
        except ValueError:
            outcomes.add(0)
    assert outcomes == {0, count * stride}
