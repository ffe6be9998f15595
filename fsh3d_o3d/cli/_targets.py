"""What ``fsh3d reconstruct`` writes, checked before any work is done (private)."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from fsh3d_o3d.adapters.writing import WRITABLE_MESH_FORMATS


def level_path(output: str, bandwidth: int) -> str:
    """Return where the level of detail of a bandwidth goes: ``out.ply`` gives ``out.b8.ply``."""
    path = Path(output)
    return str(path.with_name(f"{path.stem}.b{bandwidth}{path.suffix}"))


def checked_targets(options: argparse.Namespace) -> list[str]:
    """Return the files that will be written.

    Raises:
        ValueError: Two are the same file, or one is a folder, in no folder, or of the wrong kind.
    """
    targets = {
        "output": (options.output, WRITABLE_MESH_FORMATS),
        **{f"level {b}": (level_path(options.output, b), WRITABLE_MESH_FORMATS) for b in options.levels},
        "--save": (options.save, (".npz",)),
        "--picture": (options.picture, (".png",)),
        "--report": (options.report, (".html", ".htm")),
    }
    seen: dict[str, str] = {os.path.realpath(options.input): "the input"}
    for name, (target, suffixes) in targets.items():
        if not target:
            continue
        path = Path(target)
        if path.suffix.lower() not in suffixes:
            raise ValueError(f"{name} must end in {' or '.join(suffixes)}, got {target!r}")
        if not path.parent.is_dir():
            raise ValueError(f"{name}: there is no folder {str(path.parent)!r}")
        if path.is_dir():
            raise ValueError(f"{name}: {target!r} is a folder")
        real = os.path.realpath(target)
        if real in seen:
            raise ValueError(f"{name} and {seen[real]} are the same file {target!r}")
        seen[real] = name
    return [target for target, _ in targets.values() if target]
