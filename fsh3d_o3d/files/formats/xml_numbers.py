"""Long lists of small XML elements, such as the vertices of 3MF, as arrays: too many for one object each."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.text import numbers_between

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_LONGEST_NAME = 16  # bytes before the first element, so that looking back for a name stays within the text
_QUOTE, _LESS, _SLASH, _EQUALS, _SPACE = (ord(letter) for letter in '"</= ')


def cut_lists(data: bytes, names: Sequence[str]) -> tuple[bytes, list[bytes]]:
    """Return a document without what stands inside the elements of these names, and that, piece by piece.

    In place of each piece the element has an attribute ``piece``, its number. Comments are left out.
    """
    pieces: list[bytes] = []

    def cut(found: re.Match[bytes]) -> bytes:
        pieces.append(found[2])
        return b'<%s piece="%d"/>' % (found[1], len(pieces) - 1)

    if b"<!--" in data:
        data = _COMMENT.sub(b"", data)
    wanted = "|".join(names).encode("ascii")
    pattern = re.compile(rb"<((?:[\w.-]+:)?(?:%s))(?:\s[^<>]*)?(?<!/)>(.*?)</\1\s*>" % wanted, re.DOTALL)
    return pattern.sub(cut, data), pieces


def element_numbers(piece: bytes, element: str, names: Sequence[str]) -> Float64Array:
    """Return attributes of a list of elements of one name as an (n, k) table; other attributes are passed over.

    Raises:
        GeometryReadError: Other elements are among them, an attribute is missing, or not a number.
    """
    piece = piece.replace(b"'", b'"')
    if re.search(rb'\s=|=[^"]', piece):
        piece = re.sub(rb"\s*=\s*", b"=", piece)
    data = np.frombuffer(b" " * _LONGEST_NAME + piece, dtype=np.uint8)
    opens = np.flatnonzero(data[:-1] == _LESS)
    opens = opens[data[opens + 1] != _SLASH]
    count = len(re.findall(rb"<(?:[\w.-]+:)?%s(?=[\s/>])" % element.encode("ascii"), piece))
    if count != len(opens):
        raise GeometryReadError(f"damaged: {len(opens) - count} other elements stand among those named '{element}'")
    quotes = np.flatnonzero(data == _QUOTE)
    if len(quotes) % 2:
        raise GeometryReadError(f"damaged: a quotation mark is missing among the elements '{element}'")
    starts, stops = quotes[0::2] + 1, quotes[1::2]
    owners = np.searchsorted(opens, starts) - 1
    columns = []
    for name in names:
        letters = name.encode("ascii")
        chosen = (data[starts - 2] == _EQUALS) & (data[starts - 3 - len(letters)] <= _SPACE)
        for place, letter in enumerate(letters):
            chosen &= data[starts - 2 - len(letters) + place] == letter
        column = np.flatnonzero(chosen)
        if len(column) != count or (owners[column] != np.arange(count)).any():
            raise GeometryReadError(f"damaged: an element '{element}' has no attribute '{name}', or has it twice")
        columns.append(column)
    chosen_values = np.stack(columns, axis=1).ravel()
    order = np.argsort(chosen_values, kind="stable")
    result = np.empty(len(order))
    result[order] = numbers_between(data, starts[chosen_values[order]], stops[chosen_values[order]])
    return result.reshape(-1, len(names))
