"""Header of PLY: the elements of the file and their properties."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.text import text_reason

_SHORT_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float"}
_LONG_TYPES = {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)}
_TYPES = {
    **{name: dtype for dtype, name in _SHORT_TYPES.items()},
    **_LONG_TYPES,
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAXIMUM_HEADER = 1 << 20  # bytes; room for thousands of comments, and what is no PLY is not searched to its end
# What is looked for: such a name in capitals means the same.
_NAMES = frozenset(["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "vertex_indices", "vertex_index"])


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element."""

    name: str
    """Name in the header."""
    dtype: str
    """NumPy type of the value, or of a list's items, in the file's byte order."""
    count_dtype: str | None = None
    """Type of a list's length; None for a single value."""


@dataclass(frozen=True)
class PlyElement:
    """A table of the file: ``count`` records of the same properties."""

    name: str
    """Name in the header."""
    count: int
    """Number of records."""
    properties: tuple[PlyProperty, ...]
    """What a record holds, in order."""


@dataclass(frozen=True, eq=False)
class PlyColumn:
    """All values of one property."""

    values: Float64Array
    """(count,) values, or (sum of the lengths,) items of lists."""
    counts: IntArray | None
    """(count,) lengths of the lists; None for single values."""
    dtype: str
    """Type in the file: colours are fractions or integers."""


def parse_header(source: Source) -> tuple[str, list[PlyElement], int]:
    """Return the byte order ("" for text), the elements, and the offset of the data."""
    data = source.data
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)", data[:_MAXIMUM_HEADER])
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise GeometryReadError("does not begin with ply")
    if end is None:
        raise GeometryReadError("truncated: the header has no end_header")
    order: str | None = None
    elements: list[PlyElement] = []
    for line in re.split(rb"[\r\n]+", data[: end.start()])[1:]:
        words = line.decode("latin-1").split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if kind in _ORDERS and order is None:
                order = _ORDERS[kind]
            case ["element", name, number] if number.isascii() and number.isdigit() and len(number) <= 18:
                if name in {element.name for element in elements}:
                    raise GeometryReadError(f"element {text_reason(name.encode())} is announced twice")
                elements.append(PlyElement(name, int(number), ()))
            case ["property", *what] if elements and order is not None:
                old = elements[-1]
                elements[-1] = PlyElement(old.name, old.count, (*old.properties, _property(what, order, old, line)))
            case _ if _is_unmarked_comment(line):
                source.note(f"header line {text_reason(line)} passed over: it is neither a comment nor anything else")
            case _:
                raise GeometryReadError(f"header line {text_reason(line)} is not understood")
    if order is None:
        raise GeometryReadError("the header names no format")
    return order, [_in_lower_case(source, element) for element in elements], end.end()


def _is_unmarked_comment(line: bytes) -> bool:
    """Whether a line is a comment without the word (Blender 2.47 wrote such), and nothing that damage has changed."""
    words = line.decode("latin-1").split()
    statement = words[0][:2].lower() in ("el", "pr", "fo", "en") or (len(words) == 3 and words[2].isdigit())
    known = not {"list", *_TYPES, *_ORDERS}.isdisjoint(words)
    return line.decode("latin-1").isprintable() and len(words) > 1 and not statement and not known


def _in_lower_case(source: Source, element: PlyElement) -> PlyElement:
    """Return the element with the names that are looked for in lower case, as they are defined."""
    names = {entry.name for entry in element.properties}
    renamed = []
    for entry in element.properties:
        small = entry.name.lower()
        if small != entry.name and small in _NAMES and small not in names:
            source.note("names of properties in capitals")
            names.add(small)
            entry = dataclasses.replace(entry, name=small)
        renamed.append(entry)
    return PlyElement(element.name, element.count, tuple(renamed))


def _property(words: list[str], order: str, element: PlyElement, line: bytes) -> PlyProperty:
    match words:
        case ["list", counts, items, name] if counts in _TYPES and items in _TYPES and _TYPES[counts][0] in "iu":
            result = PlyProperty(name, order + _TYPES[items], order + _TYPES[counts])
        case [kind, name] if kind in _TYPES:
            result = PlyProperty(name, order + _TYPES[kind])
        case _:
            raise GeometryReadError(f"header line {text_reason(line)} is not understood")
    if name in {known.name for known in element.properties}:
        raise GeometryReadError(f"property {text_reason(name.encode())} is announced twice")
    return result
