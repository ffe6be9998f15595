"""Files of models by their ids, in any folder layout."""

from __future__ import annotations

import errno
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from fsh3d_o3d._printable import printable

MODEL_FORMATS: tuple[str, ...] = (".off", ".ply", ".obj", ".stl", ".glb")
"""Extensions that are looked for."""

_NUMBERED = re.compile(r"m?(\d+)")


@dataclass(frozen=True)
class ModelFiles:
    """Where models are."""

    paths: dict[str, Path]
    """The file of each id that has exactly one."""
    missing: tuple[str, ...]
    """Ids without a file."""
    ambiguous: dict[str, tuple[Path, ...]]
    """Ids with several files, and which."""


def find_models(folder: str | os.PathLike[str], ids: Sequence[str]) -> ModelFiles:
    """Find the file of each id below a folder.

    The file's name decides, in any sub-folder and any case: ``123.off`` and ``m123.off`` are model ``123``. Links to
    folders are followed once.

    Raises:
        OSError: The folder does not exist, is none or cannot be listed.
    """
    found: dict[str, list[Path]] = {_key(model): [] for model in ids}
    for path in _files(Path(folder)):
        if path.suffix.lower() in MODEL_FORMATS:
            found.get(_key(path.stem), []).append(path)
    files = {model: found[_key(model)] for model in ids}
    return ModelFiles(
        paths={model: paths[0] for model, paths in files.items() if len(paths) == 1},
        missing=tuple(model for model, paths in files.items() if not paths),
        ambiguous={model: tuple(sorted(paths)) for model, paths in files.items() if len(paths) > 1},
    )


def _key(name: str) -> str:
    numbered = _NUMBERED.fullmatch(name.lower())
    return numbered.group(1) if numbered else name.lower()


def _files(folder: Path) -> Iterator[Path]:
    if not folder.is_dir():
        reason = errno.ENOTDIR if folder.exists() else errno.ENOENT
        raise OSError(reason, os.strerror(reason), str(folder))
    os.scandir(folder).close()  # raises where the folder cannot be listed at all
    visited: set[tuple[int, int]] = set()
    for parent, folders, names in os.walk(folder, onerror=_warn, followlinks=True):
        about = os.stat(parent)  # noqa: PTH116 - os.walk gives strings
        if (about.st_dev, about.st_ino) in visited:  # a link back up, or a second way to the same folder
            folders.clear()
            continue
        visited.add((about.st_dev, about.st_ino))
        folders.sort()
        yield from (Path(parent, name) for name in names)


def _warn(error: OSError) -> None:
    message = f"{error.filename}: {error.strerror}, so models in it are not found"
    warnings.warn(printable(message), stacklevel=2)
