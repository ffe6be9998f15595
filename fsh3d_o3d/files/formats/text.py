"""Text to numbers, in whole arrays.

``numpy.fromstring`` reads integers ten times faster than floats. A decimal such as ``-0.393421`` is the integer −393421
divided by 10⁶, and that quotient is correctly rounded as long as both are exact in float64 (Clinger 1990), so decimals
are read as integers too; only exponents, very long mantissas, NaN and infinities are read as floats.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError

# Control characters count as white space when tokens are cut; NumPy then stops at those that are none, an error.
_SPACE = ord(" ")
_NINE = ord("9")  # what is above it is a letter: exponents, nan, inf
_EXACT_INTEGER = 2**53  # float64 holds every whole number up to here
_EXACT_POWER = 22  # 10²² is the largest power of ten that float64 holds exactly
_POWERS = 10.0 ** np.arange(_EXACT_POWER + 1)  # of ten, all exact
# Appended to the text and looked for in the answer: NumPy before 2.4 only warns when it stops at garbage. Any number
# that files do not happen to end with will do.
_SENTINEL = 71408251


def text_reason(token: bytes) -> str:
    """Return a token of a file as it may stand in a one-line message."""
    shown = token[:24].decode("ascii", "backslashreplace")
    return f"'{shown}{'…' if len(token) > 24 else ''}'"


@dataclass(frozen=True, eq=False)
class NumberRows:
    """Rows of numbers that may differ in length."""

    values: Float64Array
    """(m,) all numbers, row after row."""
    counts: IntArray
    """(r,) how many numbers each row holds."""

    @property
    def starts(self) -> IntArray:
        """(r,) index in ``values`` of each row's first number."""
        return cast(IntArray, np.cumsum(self.counts) - self.counts)

    def columns(self, what: str, *, minimum: int) -> Float64Array:
        """Return the rows as an (r, c) array, c >= ``minimum``; rows of different lengths are an error."""
        if not len(self.counts):
            return np.empty((0, minimum))
        width = int(self.counts[0])
        uneven = np.flatnonzero(self.counts != width)
        if len(uneven):
            raise GeometryReadError(
                f"{what} {uneven[0]} has {self.counts[uneven[0]]} numbers, {what} 0 has {width}: damaged or truncated"
            )
        if width < minimum:
            raise GeometryReadError(f"each {what} needs {minimum} numbers, found {width}")
        return self.values.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class TextLines:
    """The lines of a text that are not blank, cut into tokens at white space."""

    data: NDArray[np.uint8]
    """(n,) the text."""
    token_starts: IntArray
    """(k,) offset of each token."""
    token_stops: IntArray
    """(k,) offset behind each token."""
    first: IntArray
    """(r,) index of each line's first token."""
    counts: IntArray
    """(r,) number of tokens in each line, >= 1."""

    @classmethod
    def of(cls, text: bytes) -> TextLines:
        """Cut ``text`` at line ends (LF, CRLF or CR) and white space."""
        if b"\r" in text:
            text = text.replace(b"\r", b"\n")
        data = np.frombuffer(text, dtype=np.uint8)
        starts, stops = _tokens(data)
        ends = np.append(np.flatnonzero(data == 10), len(data))
        upto = np.searchsorted(starts, ends)
        counts = np.diff(upto, prepend=0)
        filled = counts > 0
        return cls(data, starts, stops, (upto - counts)[filled], counts[filled])

    def __len__(self) -> int:
        return len(self.counts)

    def keywords(self, width: int = 12) -> NDArray[np.bytes_]:
        """(r,) first token of each line, cut to ``width`` bytes."""
        starts, stops = self.token_starts[self.first], self.token_stops[self.first]
        letters = np.zeros((len(starts), width), dtype=np.uint8)
        for place in range(width):
            inside = np.flatnonzero(starts + place < stops)
            letters[inside, place] = self.data[starts[inside] + place]
        return letters.view(f"S{width}").ravel()

    def raw(self, line: int) -> bytes:
        """Return one line as it stands, from its first token to its last."""
        first = self.first[line]
        return self.data[self.token_starts[first] : self.token_stops[first + self.counts[line] - 1]].tobytes()

    def span(self, start: int, stop: int) -> NumberRows:
        """Return lines ``start`` … ``stop`` − 1 as numbers."""
        if start >= stop:
            return NumberRows(np.empty(0), np.empty(0, dtype=np.int64))
        tokens = slice(self.first[start], self.first[stop - 1] + self.counts[stop - 1])
        return NumberRows(
            _numbers(self.data, self.token_starts[tokens], self.token_stops[tokens]), self.counts[start:stop]
        )

    def select(self, chosen: NDArray[np.bool_], *, skip: int) -> NumberRows:
        """Return the chosen lines, without the first ``skip`` tokens of each, as numbers."""
        counts = self.counts[chosen] - skip
        if len(counts) and counts.min() <= 0:
            raise GeometryReadError("a line breaks off after its keyword: damaged or truncated")
        first = self.first[chosen] + skip
        tokens = np.repeat(first - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        starts, stops = self.token_starts[first], self.token_stops[first + counts - 1]
        blanked = np.where(_inside(starts, stops, len(self.data)), self.data, np.uint8(_SPACE))
        return NumberRows(_numbers(blanked, self.token_starts[tokens], self.token_stops[tokens]), counts)


def _numbers(data: NDArray[np.uint8], starts: IntArray, stops: IntArray) -> Float64Array:
    """Return the numbers at the given tokens, between which there is only white space, correctly rounded."""
    if not len(starts):
        return np.empty(0)
    data = data[starts[0] : stops[-1]]
    starts, stops = starts - starts[0], stops - starts[0]
    slow = np.zeros(len(starts), dtype=bool)
    plain = data
    letters = np.flatnonzero(data > _NINE)
    if len(letters):  # exponents, nan, inf
        slow[np.searchsorted(starts, letters, side="right") - 1] = True
        plain = np.where(_inside(starts[slow], stops[slow], len(data)), np.uint8(ord("0")), data)
    quick = _decimals(plain, starts, stops)
    if quick is None:
        return _floats(data.tobytes(), len(starts))
    values, exact = quick
    slow |= ~exact
    if slow.any():
        kept = np.where(_inside(starts[slow], stops[slow], len(data)), data, np.uint8(_SPACE))
        values[slow] = _floats(kept.tobytes(), int(slow.sum()))
    return values


def indices(values: Float64Array, what: str) -> IntArray:
    """Return numbers read from text as integers; fractions, NaN and absurd sizes are an error."""
    with np.errstate(invalid="ignore"):
        result = values.astype(np.int64)
    good = result == values
    if not (good.all() and result.min(initial=0) >= -_EXACT_INTEGER and result.max(initial=0) <= _EXACT_INTEGER):
        good &= np.abs(values) <= _EXACT_INTEGER
        raise GeometryReadError(f"{what} must be whole numbers, found {values[~good][0]:g}")
    return result


def without_comments(text: bytes) -> bytes:
    """Return the text without what follows a ``#`` on each line."""
    return re.sub(rb"#[^\r\n]*", b"", text) if b"#" in text else text


def _tokens(data: NDArray[np.uint8]) -> tuple[IntArray, IntArray]:
    filled = np.zeros(len(data) + 2, dtype=bool)
    np.greater(data, _SPACE, out=filled[1:-1])
    edges = np.flatnonzero(filled[1:] != filled[:-1])
    return edges[0::2], edges[1::2]


def _inside(starts: IntArray, stops: IntArray, size: int) -> NDArray[np.bool_]:
    """(size,) which bytes lie in one of the sorted, disjoint spans."""
    step = np.zeros(size + 2, dtype=np.int8)
    np.add.at(step, starts, 1)
    np.add.at(step, stops, -1)
    return cast(NDArray[np.bool_], np.cumsum(step, dtype=np.int8)[:size].astype(bool))


def _decimals(
    data: NDArray[np.uint8], starts: IntArray, stops: IntArray
) -> tuple[Float64Array, NDArray[np.bool_]] | None:
    """Return numbers without exponents and which of them are correctly rounded; None where the text is malformed."""
    text = data.tobytes()
    dots = np.flatnonzero(data == ord("."))
    decimals = np.zeros(len(starts), dtype=np.int64)
    if len(dots):
        owner = np.searchsorted(starts, dots, side="right") - 1
        behind = data[np.minimum(dots + 1, len(data) - 1)]
        # Not one number: two dots, or a sign behind the dot.
        if (owner[1:] == owner[:-1]).any() or ((behind == ord("-")) | (behind == ord("+"))).any():
            return None
        decimals[owner] = stops[owner] - dots - 1
        text = text.replace(b".", b"")
    integers = _from_string(text, np.dtype(np.int64), len(starts))
    if integers is None:
        return None
    exact = (integers <= _EXACT_INTEGER) & (integers >= -_EXACT_INTEGER) & (decimals <= _EXACT_POWER)
    return integers / _POWERS[np.minimum(decimals, _EXACT_POWER)], exact


def _floats(text: bytes, count: int) -> Float64Array:
    values = _from_string(text, np.dtype(np.float64), count)
    if values is None:
        raise GeometryReadError(f"expected numbers, found {_first_bad(text)}")
    return cast(Float64Array, values)


def _from_string(text: bytes, dtype: np.dtype[Any], count: int) -> NDArray[Any] | None:
    """Return exactly ``count`` numbers, or None: each token is then one number, as glued ones only add to the count."""
    try:
        values: NDArray[Any] = np.fromstring(text + b" %d" % _SENTINEL, dtype=dtype, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    return values[:-1] if len(values) == count + 1 and values[-1] == _SENTINEL else None


def _first_bad(text: bytes) -> str:
    def is_number(token: bytes) -> bool:
        try:
            float(token)
        except ValueError:
            return False
        return b"_" not in token

    return next((text_reason(token) for token in text.split() if not is_number(token)), "something else")


def numbers(text: bytes) -> Float64Array:
    """Return all numbers of a text, with white space between them."""
    lines = TextLines.of(text)
    return lines.span(0, len(lines)).values


def numbers_between(data: NDArray[np.uint8], starts: IntArray, stops: IntArray) -> Float64Array:
    """Return the one number that each of the sorted, disjoint spans of a text holds, white space around it aside."""
    blanked = np.where(_inside(starts, stops, len(data)), data, np.uint8(_SPACE))
    first, last = _tokens(blanked)
    if len(first) != len(starts) or (first < starts).any() or (last > stops).any():
        held = np.searchsorted(first, stops) - np.searchsorted(first, starts)
        wrong = int(np.flatnonzero(held != 1)[0]) if (held != 1).any() else 0
        found = data[starts[wrong] : stops[wrong]].tobytes()
        raise GeometryReadError(f"expected one number, found {text_reason(found)}")
    return _numbers(blanked, first, last)
