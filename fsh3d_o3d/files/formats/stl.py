"""STL, binary and text: triangles welded where corners are the same to the last bit."""

from __future__ import annotations

import codecs
import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import mesh_of, welded
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.stl_text import text_stl_corners
from fsh3d_o3d.geometry import MeshArrays

_HEADER_BYTES = 84  # 80 of free text, and four that count the facets
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNFILLED = (0, 2**32 - 1)  # what writers leave in the header that never come back to fill in the count
_HEAD_BYTES = 4096  # in which a text STL shows its first facet, however long the name of the solid; a choice
_BLANKS = b"\0 \t\r\n\x1a"
_FACET_WORDS = re.compile(rb"\bfacet\s+normal\s|\bouter\s+loop\s", re.IGNORECASE)
_SOLID = re.compile(rb"\s*solid\b", re.IGNORECASE)


def binary_stl_size(data: bytes) -> int | None:
    """Size that the count in a binary header asks for, or None where there is no whole header."""
    if len(data) < _HEADER_BYTES:
        return None
    return _HEADER_BYTES + _FACET.itemsize * int.from_bytes(data[80:84], "little")


def has_binary_header(data: bytes) -> bool:
    """Whether a binary header begins the data, although it may begin like a text in some encoding.

    Letters in the place of the count would ask for billions of triangles, and there are no zeros in UTF-8.
    """
    size = binary_stl_size(data)
    if size is None:
        return False
    return size <= len(data) or (data.startswith(codecs.BOM_UTF8) and 0 in data[80:_HEADER_BYTES])


def parse_stl(source: Source) -> MeshArrays:
    """Return an STL file as a mesh. STL lists loose triangles, so equal corners become one vertex."""
    data = source.data
    # Many binary headers begin with "solid" too: only the size, or the words behind it, tell the two kinds apart.
    if binary_stl_size(data) != len(data) and _is_text(data):
        corners, ended = text_stl_corners(source)
        vertices, triangles = welded(corners)
        if not ended:
            _check_whole(source, triangles)
    else:
        vertices, triangles = welded(_binary_corners(source))
    return mesh_of(source, vertices, triangles)


def _is_text(data: bytes) -> bool:
    head = data[:_HEAD_BYTES]
    return _FACET_WORDS.search(head) is not None or (_SOLID.match(head) is not None and b"\0" not in head)


def _check_whole(source: Source, triangles: IntArray) -> None:
    """Without its end mark a text may have been cut off: only a surface with every edge shared shows that it was not.

    Raises:
        GeometryReadError: Some edge belongs to an odd number of triangles.
    """
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, shared = np.unique(edges, axis=0, return_counts=True)
    if (shared % 2).any():
        raise GeometryReadError(
            "truncated: endsolid is missing, and the surface is open, so that facets may be missing as well; "
            "where the file is whole, add a line 'endsolid'"
        )
    source.note("endsolid is missing; no facet is, as the surface is closed")


def _binary_corners(source: Source) -> Float64Array:
    data = source.data
    expected = binary_stl_size(data)
    if expected is None:
        raise GeometryReadError(f"{len(data)} bytes are too few for a binary STL header, and it is not text")
    announced = (expected - _HEADER_BYTES) // _FACET.itemsize
    whole, rest = divmod(len(data) - _HEADER_BYTES, _FACET.itemsize)
    if announced in _UNFILLED and whole and not rest:
        corners = _facets(data, whole)["corners"]
        if (corners[:, 0] != corners[:, 1]).any():  # the same corner thrice, everywhere: no facets but a filling
            source.note(
                f"the header's count, {announced}, was never filled in; the file holds {counted(whole, 'whole facet')}"
            )
            return corners.reshape(-1, 3)
    sizes = f"the header announces {announced} triangles, {expected} bytes, but the file has {len(data)}"
    if announced == 0:
        raise GeometryReadError(f"truncated or damaged: {sizes}" if whole else "the header announces 0 triangles")
    if expected > len(data):
        if b"\0" not in data[:_HEAD_BYTES] and data[:_HEADER_BYTES].isascii():
            raise GeometryReadError("it does not begin with 'solid' as text STL does, and is no binary STL of its size")
        raise GeometryReadError(f"truncated or damaged: {sizes}, {whole} whole triangles")
    facets = _facets(data, announced)
    extra = len(data) - expected
    if extra and facets["attribute"].any():
        facets, extra = _with_payload(source, facets, extra)
    behind = data[len(data) - extra :].strip(_BLANKS)
    if behind and (extra % _FACET.itemsize == 0 or _another_facet_follows(facets, data[len(data) - extra :])):
        raise GeometryReadError(
            f"damaged: {sizes}, {whole} whole triangles: the count is wrong, or the file is not STL"
        )
    if extra:
        source.note(f"{counted(extra, 'byte')} behind the {announced} triangles that the header announces passed over")
    return facets["corners"].reshape(-1, 3)


def _facets(data: bytes, count: int) -> NDArray[np.void]:
    return np.frombuffer(data, dtype=_FACET, count=count, offset=_HEADER_BYTES)


def _another_facet_follows(facets: NDArray[np.void], behind: bytes) -> bool:
    """Whether what follows the facets looks like one more: a triangle where the others are."""
    if len(behind) < _FACET.itemsize or not len(facets):
        return False
    corners = facets["corners"].reshape(-1, 3).astype(np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = np.linalg.norm(high - low)
    more = np.frombuffer(behind, dtype=_FACET, count=1)["corners"][0].astype(np.float64)
    return bool(((more >= low - room) & (more <= high + room)).all() and (more[0] != more[1]).any())


def _with_payload(source: Source, facets: NDArray[np.void], extra: int) -> tuple[NDArray[np.void], int]:
    """Return the facets where each is followed by as many bytes as its attribute says and all end with the file.

    The bytes that are left over come second. Most writers put a colour there instead: then nothing fits, and the
    facets come back as they were.

    Raises:
        GeometryReadError: So it is for most facets, but the last ones are missing.
    """
    data = memoryview(source.data)
    pieces = []
    at = _HEADER_BYTES
    for _ in range(len(facets)):  # where a facet begins is known only from the one before it
        piece = data[at : at + _FACET.itemsize]
        at += _FACET.itemsize
        if at > len(data):
            break
        pieces.append(piece)
        at += int.from_bytes(piece[-2:], "little")
    if at <= len(data) and not bytes(data[at:]).strip(_BLANKS):
        source.note(
            f"{counted(at - _HEADER_BYTES - facets.nbytes, 'byte')} of attributes behind the facets passed over"
        )
        return np.frombuffer(b"".join(pieces), dtype=_FACET), len(data) - at
    # Colours that lead from facet to facet by chance, and yet are not all the same, are not to be feared.
    one_color = bool((facets["attribute"] == facets["attribute"][0]).all())
    if not one_color and len(pieces) * 2 >= len(facets):
        raise GeometryReadError("truncated or damaged: facets announce more bytes of attributes than the file has")
    return facets, extra
