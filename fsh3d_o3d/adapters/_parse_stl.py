"""STL (private), binary and text: triangles welded where corners are the same to the last bit."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.adapters._parse_result import mesh_of
from fsh3d_o3d.adapters._parse_text import TextLines, text_reason
from fsh3d_o3d.adapters._source import Source
from fsh3d_o3d.adapters.geometry import MeshArrays
from fsh3d_o3d.errors import GeometryReadError

_HEADER_BYTES = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_KNOWN = np.array([b"solid", b"facet", b"outer", b"vertex", b"endloop", b"endfacet", b"endsolid"], dtype="S12")


def binary_stl_size(data: bytes) -> int | None:
    """Size that the count in a binary header asks for, or None where there is no whole header."""
    if len(data) < _HEADER_BYTES:
        return None
    return _HEADER_BYTES + _FACET.itemsize * int.from_bytes(data[80:84], "little")


def parse_stl(source: Source) -> MeshArrays:
    """Return an STL file as a mesh. STL lists loose triangles, so equal corners become one vertex."""
    data = source.data
    expected = binary_stl_size(data)
    # Many binary headers begin with "solid" too: only the size tells the two kinds apart.
    if expected == len(data):
        return _welded(source, np.frombuffer(data, dtype=_FACET, offset=_HEADER_BYTES)["corners"].reshape(-1, 3))
    if data.lstrip()[:5].lower() == b"solid":
        return _welded(source, _text_corners(data))
    if expected is None:
        raise GeometryReadError(f"{len(data)} bytes are too few for a binary STL header, and it is not text")
    raise GeometryReadError(
        f"truncated or damaged: the header announces {(expected - _HEADER_BYTES) // _FACET.itemsize} triangles, "
        f"{expected} bytes, but the file has {len(data)}"
    )


def _text_corners(data: bytes) -> Float64Array:
    lines = TextLines.of(data.lower())
    keywords = lines.keywords()
    unknown = np.flatnonzero(~np.isin(keywords, _KNOWN))
    if len(unknown):
        raise GeometryReadError(f"{text_reason(bytes(keywords[unknown[0]]))} is not a keyword of text STL")
    facet = np.array([b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet"], dtype="S12")
    body = keywords[(keywords != b"solid") & (keywords != b"endsolid")]
    if len(body) % len(facet) or (body.reshape(-1, len(facet)) != facet).any():
        raise GeometryReadError("truncated or damaged: a facet is not three vertices in a loop")
    if keywords[-1] != b"endsolid" or (keywords == b"solid").sum() != (keywords == b"endsolid").sum():
        raise GeometryReadError("truncated: endsolid is missing")
    corners = lines.select(keywords == b"vertex", skip=1).columns("vertex", minimum=3)
    if corners.shape[1] != 3:
        raise GeometryReadError(f"each vertex needs 3 numbers, found {corners.shape[1]}")
    return corners


def _welded(source: Source, corners: Float64Array) -> MeshArrays:
    if not len(corners):
        raise GeometryReadError("the file announces 0 triangles")
    # Adding 0 turns −0 into +0; then equal numbers have equal bytes, and one comparison sorts a whole corner.
    bits = np.ascontiguousarray(corners + 0.0)
    keys = bits.view(np.dtype((np.void, bits.dtype.itemsize * 3))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)  # vertices in the order of the file, not of their bytes
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return mesh_of(source, corners[first[order]], rank[inverse.ravel()].reshape(-1, 3))
