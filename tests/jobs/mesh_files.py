"""Small files for tests."""

from __future__ import annotations

from pathlib import Path


def write_box(path: Path, extents=(1, 2, 3), vertices: int = 8) -> Path:
    """An OFF file of two triangles that span a box, with as many vertices as asked for."""
    a, b, c = extents
    corners = [(0, 0, 0), (a, b, 0), (a, 0, c), (0, b, c)] + [(0, 0, 0)] * (vertices - 4)
    lines = ["OFF", f"{vertices} 2 0", *(f"{x} {y} {z}" for x, y, z in corners), "3 0 1 2", "3 0 2 3"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path
