"""Keywords of OBJ: which lines are statements, which are those of other programs, and which are damaged."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import TextLines, text_reason

_STATEMENTS = (
    "v vt vn vp f fo l p g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj ctech "
    "stech deg bmat step cstype curv curv2 surf parm trim hole scrv sp end con call csh"
)
_KNOWN = np.array(_STATEMENTS.encode().split(), dtype="S12")
# Creases of OpenSubdiv, weights of a skin, and the statements of material files, which some programs write inside.
_FOREIGN = set(
    b"t vw newmtl ka kd ks ke tf tr ns ni d illum sharpness map_ka map_kd map_ks map_ke map_ns map_d map_tr map_bump "
    b"bump disp decal refl norm pr pm ps pc pcr aniso anisor map_pr map_pm map_ps".split()
)
_NUMBER = re.compile(rb"[-+.]*\d[-+.\deE]*\Z")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


def known_keywords(source: Source, lines: TextLines) -> NDArray[np.bytes_]:
    """Return the keyword of each line in lower case; lines of other words are passed over with a note.

    A vertex lost to damage would shift every later index. So what looks like a damaged vertex or face is an error, and
    so is a file with more such lines than vertices and faces.
    """
    keywords = lines.keywords()
    unknown = np.flatnonzero(~np.isin(keywords, _KNOWN))
    if not len(unknown):
        return keywords
    lower = np.char.lower(keywords[unknown])
    capital = np.isin(lower, _KNOWN)
    if capital.any():
        keywords[unknown[capital]] = lower[capital]
        source.note(f"{counted(capital.sum(), 'keyword')} in capitals")
        unknown, lower = unknown[~capital], lower[~capital]
    foreign = [line for line, word in zip(unknown.tolist(), lower.tolist(), strict=True) if word not in _FOREIGN]
    geometry = int(np.isin(keywords, [b"v", b"f", b"fo"]).sum())
    for line in foreign:
        reason = _damage(lines.raw(line)) if len(foreign) < geometry else "most lines are none"
        if reason:
            raise GeometryReadError(f"{text_reason(bytes(keywords[line]))} is not a keyword of OBJ: {reason}")
    if len(unknown):
        words = list(dict.fromkeys(text_reason(bytes(keywords[line])) for line in unknown[:1000].tolist()))
        shown = ", ".join(words[:3]) + (" …" if len(words) > 3 else "")
        source.note(f"{counted(len(unknown), 'line')} passed over whose keywords OBJ does not have: {shown}")
    return keywords


def _damage(line: bytes) -> str:
    """Return why a line is damage and not text of someone's own, or nothing."""
    try:
        line.decode("utf-8")
    except UnicodeDecodeError:
        return "the line is not text"
    if _CONTROL.search(line):
        return "the line is not text"
    word, *rest = line.split()
    numbers = sum(_NUMBER.match(token) is not None for token in rest)
    if re.match(rb"[-+.\d]", word):
        return "the line begins with a number"
    if re.match(rb"[vf](\W*\d|.?\Z)", word, re.IGNORECASE) or (numbers >= 2 and 2 * numbers >= len(rest)):
        return "it looks like a damaged vertex or face"
    return ""
