"""Names and messages that people read: in one line, without what steers a terminal or hides in a page."""

from __future__ import annotations

import re
import unicodedata

# Control characters; invisible ones, those among them that reverse the order of what follows; lone surrogates, which no
# encoding can hold; line and paragraph separators.
_HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
_SURROGATE = re.compile("[\ud800-\udfff]")


# User and password of an address; the password of storage may hold slashes.
_CREDENTIALS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*:/{1,2})[^\s/@:]*:[^\s@]*@")


def without_credentials(text: str) -> str:
    """Return a text with user and password left out of the addresses in it."""
    return _CREDENTIALS.sub(r"\1…@", text)


def printable(text: object) -> str:
    r"""Return a text with what is hidden in it escaped, such as ``\x1b``, and bytes that are not UTF-8 as ``\xff``.

    Passwords in addresses are left out.
    """
    shown = encodable(without_credentials(str(text)))
    return "".join(_escaped(c) if unicodedata.category(c) in _HIDDEN else c for c in shown)


def encodable(text: str) -> str:
    """Return a name as text that any encoding can hold: bytes that are not UTF-8 are escaped."""
    return _SURROGATE.sub(lambda found: _escaped(found.group()), text)


def _escaped(character: str) -> str:
    byte = ord(character) - 0xDC00  # as ``os.fsdecode`` gives one that is not UTF-8
    return f"\\x{byte:02x}" if 0x80 <= byte <= 0xFF else character.encode("unicode_escape").decode("ascii")
