"""What a command writes, checked before any work is done (private)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path


def level_path(output: str, bandwidth: int) -> str:
    """Return where the level of detail of a bandwidth goes: ``out.ply`` gives ``out.b8.ply``."""
    path = Path(output)
    return str(path.with_name(f"{path.stem}.b{bandwidth}{path.suffix}"))


def checked_targets(targets: Mapping[str, tuple[str | None, tuple[str, ...]]], inputs: Mapping[str, str]) -> list[str]:
    """Return the files that will be written.

    Args:
        targets: Name of each option, the file it asks for if any, and what that may end in.
        inputs: Names of what is read, and the files.

    Raises:
        ValueError: Two are the same file, or one is a folder, in no folder, or of the wrong kind.
    """
    seen = {os.path.realpath(path): name for name, path in inputs.items()}
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
