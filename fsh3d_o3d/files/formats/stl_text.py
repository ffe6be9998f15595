"""Text STL: one keyword a line, and the variants that programs write."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import TextLines, text_reason

_FACET = np.array([b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet"], dtype="S12")
_KNOWN = np.append(np.unique(_FACET), np.array([b"solid", b"endsolid"], dtype="S12"))
_EMPTY = "the file holds 0 triangles"
_COMMENT = re.compile(rb"^[ \t]*(?:#|;|//|%)[^\r\n]*", re.MULTILINE)
_SPLIT_KEYWORD = re.compile(rb"\bend[ \t]+(?=(?:loop|facet|solid)\b)")
_KEYWORD_INSIDE = re.compile(rb"(?<=[ \t])(?=(?:facet|outer|vertex|endloop|endfacet|endsolid|solid)\b)")


def text_stl_corners(source: Source) -> tuple[Float64Array, bool]:
    """Return the corners of all facets, (3t, 3), and whether each solid has its end mark.

    A text that even lacks the end of its last line counts as cut off.

    Raises:
        GeometryReadError: A facet is not three vertices in a loop, or the text is damaged otherwise.
    """
    lines, keywords = _one_keyword_a_line(source)
    known = np.isin(keywords, _KNOWN)
    _check_tail(keywords, known)
    if not known.all():
        source.note(
            f"{counted(int((~known).sum()), 'line')} outside the facets not of text STL passed over, "
            f"the first begins with {text_reason(bytes(keywords[~known][0]))}"
        )
    corners = lines.select(keywords == b"vertex", skip=1).columns("vertex", minimum=3)
    if corners.shape[1] != 3:
        raise GeometryReadError(f"each vertex needs 3 numbers, found {corners.shape[1]}")
    ended = _every_solid_ends(keywords[known])
    if not ended and not source.data.endswith((b"\n", b"\r")):
        raise GeometryReadError("truncated: endsolid is missing, and so is the end of the last line")
    return corners, ended


def _one_keyword_a_line(source: Source) -> tuple[TextLines, NDArray[np.bytes_]]:
    """Return the lines and the keyword of each, every facet whole; spellings that are not of the format come right.

    The names of solids may hold any word, so that words are moved only where the lines as they stand make no sense.
    """
    text = source.data.lower()
    lines = TextLines.of(text)
    keywords = lines.keywords()
    if np.isin(keywords, _KNOWN).all() and _fault(keywords) is None:
        return lines, keywords
    text, comments = _COMMENT.subn(b"", text)
    text, apart = _SPLIT_KEYWORD.subn(b"end", text)
    lines = TextLines.of(text)
    keywords = lines.keywords()
    fault = _fault(keywords)
    if fault is not None:
        lines = TextLines.of(_KEYWORD_INSIDE.sub(b"\n", text))
        keywords = lines.keywords()
        if (still := _fault(keywords)) is not None:
            raise GeometryReadError(still if fault == _EMPTY else fault)
        source.note("several keywords of text STL stand on one line")
    if comments:
        source.note(f"{counted(comments, 'comment line')}, which text STL does not have, passed over")
    if apart:
        source.note("keywords are written apart, as 'end loop'")
    return lines, keywords


def _fault(keywords: NDArray[np.bytes_]) -> str | None:
    """What is wrong with the facets; lines with other words may stand between them but not inside."""
    if not len(keywords) or not (keywords == b"solid").any():
        return "damaged: it does not begin with 'solid'"
    inside = keywords[(keywords != b"solid") & (keywords != b"endsolid")]
    known = np.isin(inside, _KNOWN)
    place: IntArray = np.cumsum(known) - known  # how many lines of facets stand before each line
    unknown = np.flatnonzero(~known & (place % len(_FACET) != 0))
    if len(unknown):
        return f"damaged or truncated: {text_reason(bytes(inside[unknown[0]]))} is not a keyword of text STL"
    body = inside[known]
    if len(body) % len(_FACET) or (body.reshape(-1, len(_FACET)) != _FACET).any():
        return "truncated or damaged: a facet is not three vertices in a loop"
    if not len(body):
        return _EMPTY
    return None


def _check_tail(keywords: NDArray[np.bytes_], known: NDArray[np.bool_]) -> None:
    last = bytes(keywords[-1])
    if not known[-1] and any(bytes(word).startswith(last) for word in _KNOWN):
        raise GeometryReadError(f"truncated: the last line breaks off at {text_reason(last)}")


def _every_solid_ends(keywords: NDArray[np.bytes_]) -> bool:
    marks = keywords[(keywords == b"solid") | (keywords == b"endsolid")]
    begins = marks == b"solid"
    if not begins[0] or (~begins[1:] & ~begins[:-1]).any():
        raise GeometryReadError("damaged: endsolid without solid")
    return bool(len(marks) % 2 == 0 and (begins[::2]).all() and keywords[-1] == b"endsolid")
