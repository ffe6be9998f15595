"""Names and messages that people read: in one line, without what steers a terminal or hides in a page (private)."""

from __future__ import annotations

import re
import unicodedata

# Control characters; invisible ones, those among them that reverse the order of what follows; lone surrogates, which no
# encoding can hold; line and paragraph separators.
_HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
_SURROGATE = re.compile("[\ud800-\udfff]")


def printable(text: object) -> str:
    r"""Return a text with what is hidden in it escaped, such as ``\x1b``, and bytes that are not UTF-8 as ``\xff``."""
    return "".join(_escaped(c) if unicodedata.category(c) in _HIDDEN else c for c in encodable(str(text)))


def encodable(text: str) -> str:
    """Return a name as text that any encoding can hold: bytes that are not UTF-8 are escaped."""
    return _SURROGATE.sub(lambda found: _escaped(found.group()), text)


def _escaped(character: str) -> str:
    byte = ord(character) - 0xDC00  # as ``os.fsdecode`` gives one that is not UTF-8
    return f"\\x{byte:02x}" if 0x80 <= byte <= 0xFF else character.encode("unicode_escape").decode("ascii")
