"""Names of files on a terminal (private)."""

from __future__ import annotations

import unicodedata


def printable(text: str) -> str:
    """Return a name in one line of text that any encoding can hold and that cannot steer a terminal.

    Bytes that are not UTF-8 and control characters, newlines among them, are escaped.
    """
    escaped = "".join(_escaped(c) if unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp") else c for c in text)
    return encodable(escaped)


def encodable(text: str) -> str:
    """Return a name as text that any encoding can hold: bytes that are not UTF-8 are escaped."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
