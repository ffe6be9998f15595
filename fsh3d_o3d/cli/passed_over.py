"""What of a folder was not looked at, in words."""

from __future__ import annotations

from fsh3d_o3d._printable import printable
from fsh3d_o3d.index import LibraryScan

_NAMED = 10  # extensions; all are in the JSON


def other_formats(scan: LibraryScan) -> dict[str, int]:
    """Return how many files there are of each extension that is not read, most frequent first."""
    return dict(sorted(scan.other_formats.items(), key=lambda kind: (-kind[1], kind[0])))


def passed_over(scan: LibraryScan) -> list[str]:
    """Return what was passed over, a line each: files of other formats by extension, most frequent first, and links."""
    lines = []
    if scan.other_formats:
        kinds = list(other_formats(scan).items())
        named = [f"{printable(extension) or 'no extension'} {count}" for extension, count in kinds[:_NAMED]]
        if len(kinds) > _NAMED:
            rest = sum(count for _, count in kinds[_NAMED:])
            named.append(f"and {rest} of {len(kinds) - _NAMED} further extensions")
        total = scan.other_formats.total()
        lines.append(f"{total} {'file' if total == 1 else 'files'} of other formats: {', '.join(named)}")
    if scan.links:
        lines.append(f"{scan.links} symbolic {'link' if scan.links == 1 else 'links'}, not followed")
    return lines


def in_brackets(scan: LibraryScan) -> str:
    """Return the same for the end of a sentence; nothing if nothing was passed over."""
    lines = passed_over(scan)
    return f" ({'; '.join(lines)})" if lines else ""
