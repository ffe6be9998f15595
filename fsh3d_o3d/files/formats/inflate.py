"""Deflated data, unpacked within bounds: a small file may announce, or hide, more than any machine holds."""

from __future__ import annotations

import zlib

from fsh3d_o3d.errors import GeometryReadError

MOST_UNPACKED = 4 * 2**30
"""Bytes that what is packed in one file may grow to: far more than models have, and far less than a small file of zeros
could ask for. The limit of the reading process may be met before."""
GZIP = 16 + zlib.MAX_WBITS
"""``wbits`` of the gzip format: its header, its length and its CRC are checked."""
RAW = -zlib.MAX_WBITS
"""``wbits`` of deflate without a header."""


def inflated(
    data: bytes | memoryview, *, what: str, wbits: int = zlib.MAX_WBITS, limit: int = MOST_UNPACKED
) -> tuple[bytes, bytes]:
    """Return what ``data`` unpacks to, and the bytes behind the end of what is packed.

    Args:
        data: Packed bytes.
        what: Their name in messages.
        wbits: Of the format, as for ``zlib``; the default has zlib's header and checksum.
        limit: Bytes that it may grow to.

    Raises:
        GeometryReadError: They are damaged, break off, or grow beyond the limit.
    """
    engine = zlib.decompressobj(wbits)
    try:
        unpacked = engine.decompress(data, limit + 1)
    except zlib.error as error:
        reason = str(error).rpartition(": ")[2] or "not deflate"
        raise GeometryReadError(f"damaged: {what} cannot be unpacked ({reason})") from None
    if len(unpacked) > limit:
        raise GeometryReadError(f"{what} grows to more than {limit} bytes when it is unpacked")
    if not engine.eof:
        raise GeometryReadError(f"truncated: {what} breaks off")
    return unpacked, engine.unused_data


def gunzipped(data: bytes) -> bytes:
    """Return the content of a ``.gz`` file, whose members stand one behind the other.

    Raises:
        GeometryReadError: It is damaged, breaks off, or grows beyond ``MOST_UNPACKED``.
    """
    members: list[bytes] = []
    room = MOST_UNPACKED
    while data:
        if not data.startswith(b"\x1f\x8b"):
            raise GeometryReadError(
                f"damaged: {len(data)} bytes behind the packed content are none" if members else "it is not packed"
            )
        member, data = inflated(data, what="the content", wbits=GZIP, limit=room)
        members.append(member)
        room -= len(member)
        data = data.lstrip(b"\0")  # tapes and some programs fill up with zeros
    return members[0] if len(members) == 1 else b"".join(members)
