"""Columns of numbers as programs export them: separators, names of columns, comments."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.text import TextLines, text_reason, without_comments

_LINE = re.compile(rb"([^\r\n]*)(?:\r\n|\n|\r|$)")
_COMMENT_MARK = re.compile(rb"\s*(?:#|//|%)")
_SLASHED = re.compile(rb"//[^\r\n]*")
_SEPARATORS = (b";", b",", b"\t")  # names may hold blanks where one of these stands between them
_UNIT_SUFFIX = re.compile(r"[\[(].*")  # as in ``x [m]``
_NUMBER = re.compile(rb"[-+]?(?:\.?\d|nan\b|inf)", re.IGNORECASE)
_EMPTY_FIELD = re.compile(rb"(?:^|[\r\n]|[,;])[ \t]*[,;]")
_ATOM = re.compile(rb"\s*[A-Z][a-z]?\d{0,3}(?:\s+[-+]?\.?\d\S*){3}")
_OTHER_NAMES = {
    **{f"normal_{axis}": f"n{axis}" for axis in "xyz"},
    **{f"normal{axis}": f"n{axis}" for axis in "xyz"},
    "red": "r",
    "green": "g",
    "blue": "b",
    "rf": "r",
    "gf": "g",
    "bf": "b",  # CloudCompare's floats
}


@dataclass(frozen=True, eq=False)
class TextColumns:
    """Lines of numbers between blanks, and what their columns are called."""

    lines: TextLines
    """The lines."""
    names: tuple[str, ...] | None
    """A name for each column, x, y and z among them, or None."""
    in_comment: bool
    """The names stand in a comment, which need not mean the columns."""


def text_columns(source: Source) -> TextColumns:
    """Return the lines of a text cloud.

    Raises:
        GeometryReadError: The columns cannot be told apart, or the text is of another kind.
    """
    text = source.data
    names, in_comment, start = _heading(source, text)
    text = without_comments(text[start:] if start else text)
    if b"//" in text:
        text = _SLASHED.sub(b"", text)
    return TextColumns(TextLines.of(_without_separators(source, text)), names, in_comment)


def _heading(source: Source, text: bytes) -> tuple[tuple[str, ...] | None, bool, int]:
    """Return names of columns, whether a comment gives them, and where the numbers begin."""
    names: tuple[str, ...] | None = None
    in_comment = False
    at = 0
    while at < len(text):
        line = _line_at(text, at)
        found = line[1].strip(b"\0 \t")
        mark = _COMMENT_MARK.match(found)
        if mark:
            comment = _column_names(found[mark.end() :])
            names, in_comment = (comment, True) if comment else (names, in_comment)
        elif found and _NUMBER.match(found):
            _check_not_a_molecule(text, at)
            break
        elif found:
            _check_not_a_molecule(text, at)
            names, in_comment = _column_names(found), False
            if names is None:
                raise GeometryReadError(
                    "the first line is neither numbers nor the names of columns, x, y and z among them: "
                    f"found {text_reason(found)}"
                )
            source.note(f"the columns are those that the first line names: {' '.join(names)[:80]}")
        at = line.end()
    return names, in_comment, at


def _line_at(text: bytes, at: int) -> re.Match[bytes]:
    line = _LINE.match(text, at)
    assert line is not None  # it matches nothing as well
    return line


def _column_names(line: bytes) -> tuple[str, ...] | None:
    """Names in one spelling, or None where x, y and z are not each named once."""
    separator = next((mark for mark in _SEPARATORS if mark in line), None)
    words = [word.strip(b"\"' \t") for word in line.strip(b" \t,;").split(separator)]
    plain = [_UNIT_SUFFIX.sub("", word.decode("latin-1").lower()).strip() for word in words]
    names = tuple(_OTHER_NAMES.get(name, name) for name in plain)
    return names if all(names.count(axis) == 1 for axis in "xyz") else None


def _check_not_a_molecule(text: bytes, at: int) -> None:
    """Chemistry's .xyz: the number of atoms, a comment, and lines of an element and its place."""
    for _ in range(3):
        line = _line_at(text, at)
        if _ATOM.fullmatch(line[1].rstrip()):
            raise GeometryReadError("a molecule (elements and where their atoms are), not geometry")
        at = line.end()


def _without_separators(source: Source, text: bytes) -> bytes:
    """Return the numbers with blanks between them."""
    first = next((line for line in _first_lines(text) if b"," in line or b";" in line), None)
    if first is None:
        return text
    if _EMPTY_FIELD.search(text):
        raise GeometryReadError("a field between two separators is empty")
    if b";" in first and b"," in first:
        if b"." in text:
            raise GeometryReadError("both points and commas stand inside the numbers that semicolons separate")
        source.note("numbers have decimal commas, with semicolons between them")
        return text.replace(b",", b".").replace(b";", b" ")
    separator = b";" if b";" in first else b","
    fields = first.split()
    if any(not (a.endswith(separator) or b.startswith(separator)) for a, b in itertools.pairwise(fields)):
        raise GeometryReadError(
            f"blanks and {_called(separator)} both stand between digits: write decimal points, and one separator"
        )
    source.note(f"numbers are separated by {_called(separator)}")
    return text.replace(separator, b" ")


def _first_lines(text: bytes) -> list[bytes]:
    """Return the first lines that hold something: of these the second is a point where the first is a count."""
    lines: list[bytes] = []
    at = 0
    while at < len(text) and len(lines) < 2:
        line = _line_at(text, at)
        if line[1].strip():
            lines.append(line[1].strip())
        at = line.end()
    return lines


def _called(separator: bytes) -> str:
    return "semicolons" if separator == b";" else "commas"
