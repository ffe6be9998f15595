"""What a command writes, checked before any work is done."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from fsh3d_o3d.files import absolute, is_uri


def level_path(output: str, bandwidth: int) -> str:
    """Return where the level of detail of a bandwidth goes: ``out.ply`` gives ``out.b8.ply``."""
    path = Path(output)
    return str(path.with_name(f"{path.stem}.b{bandwidth}{path.suffix}"))


def checked_targets(targets: Mapping[str, tuple[str | None, tuple[str, ...]]], inputs: Mapping[str, str]) -> list[str]:
    """Return the files that will be written.

    Args:
        targets: Name of each option, the file it asks for if any, and what that may end in; nothing: anything.
        inputs: Names of what is read, and the files.

    Raises:
        ValueError: Two are the same file, or one is a folder, a device, of the wrong kind, or in no folder that can
            be written to.
    """
    seen = {os.path.realpath(absolute(path)): name for name, path in inputs.items() if not is_uri(path)}
    for name, (target, suffixes) in targets.items():
        if not target:
            continue
        path = Path(target)
        if suffixes and path.suffix.lower() not in suffixes:
            raise ValueError(f"{name} must end in {' or '.join(suffixes)}, got {target!r}")
        if is_uri(target):
            raise ValueError(f"{name}: only an index can be in object storage, and {target!r} is not of one")
        if not path.parent.is_dir():
            raise ValueError(f"{name}: there is no folder {str(path.parent)!r}")
        if path.is_dir():
            raise ValueError(f"{name}: {target!r} is a folder")
        if path.exists() and not path.is_file():
            raise ValueError(f"{name}: {target!r} is not a regular file, so it is not replaced")
        real = os.path.realpath(absolute(target))
        if not os.access(Path(real).parent, os.W_OK | os.X_OK, effective_ids=True):
            raise ValueError(f"{name}: the folder of {target!r} cannot be written to")
        if real in seen:
            raise ValueError(f"{name} and {seen[real]} are the same file {target!r}")
        seen[real] = name
    return [target for target, _ in targets.values() if target]
