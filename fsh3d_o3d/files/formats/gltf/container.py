"""The container of a binary glTF file: a header and chunks, of which one is JSON and one may be data."""

from __future__ import annotations

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source, counted

_HEADER = 12  # bytes: magic, version, length
_CHUNK_HEADER = 8  # bytes: length, kind
_ALIGNMENT = 4  # bytes, to a multiple of which chunks are padded


def glb_chunks(source: Source) -> tuple[bytes, memoryview | None]:
    """Return the JSON of a .glb, and its data where it has any; chunks of other kinds are passed over.

    Raises:
        GeometryReadError: It is not a whole .glb of version 2.
    """
    data = source.data
    if data[:4] != b"glTF" or len(data) < _HEADER + _CHUNK_HEADER:
        raise GeometryReadError("does not begin with a whole glTF header")
    version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != 2:
        raise GeometryReadError(f"glTF version {version} is not read, only 2")
    if length > len(data):
        raise GeometryReadError(f"truncated or damaged: the header announces {length} bytes, the file has {len(data)}")
    if length < len(data):
        source.note(f"{counted(len(data) - length, 'byte')} behind the announced end were passed over")
    whole = memoryview(data)[:length]
    chunks = _chunks(whole, padded=False)
    if chunks is None:  # written with the length of the content, though what follows is padded
        chunks = _chunks(whole, padded=True)
    if chunks is None:
        raise GeometryReadError("damaged: a chunk reaches beyond the end of the file")
    if any(len(content) % _ALIGNMENT for _, content in chunks):
        source.note(f"the length of a chunk is not a multiple of {_ALIGNMENT}")
    found: dict[bytes, memoryview] = {}
    for kind, content in chunks:
        found.setdefault(kind, content)
    if b"JSON" not in found:
        raise GeometryReadError("damaged: there is no JSON chunk")
    text = bytes(found[b"JSON"])
    if text.endswith(b"\0"):
        source.note("the JSON is padded with zero bytes instead of blanks")
        text = text.rstrip(b"\0")
    return text, found.get(b"BIN\0")


def _chunks(data: memoryview, *, padded: bool) -> list[tuple[bytes, memoryview]] | None:
    """All chunks by kind and content; None where they do not end where the data does."""
    found: list[tuple[bytes, memoryview]] = []
    at = _HEADER
    while len(data) - at >= _CHUNK_HEADER:
        size, begin = int.from_bytes(data[at : at + 4], "little"), at + _CHUNK_HEADER
        if begin + size > len(data):
            return None
        found.append((bytes(data[at + 4 : begin]), data[begin : begin + size]))
        at = begin + size
        if padded:
            at += -at % _ALIGNMENT
    return None if bytes(data[at:]).strip(b"\0 ") else found
