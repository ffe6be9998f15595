"""The user's cache folder: the platform's, or the one that FSH3D_CACHE_DIR names."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

# Below which nothing can be made, so that what is not kept there is worked out each time: whoever has no home has no
# cache either, unless FSH3D_CACHE_DIR names one.
_NOWHERE = Path(os.devnull)


def cache_folder() -> Path:
    """Return the folder; it need not exist.

    Raises:
        ValueError: ``FSH3D_CACHE_DIR`` is in the home of a user whom there is not.
    """
    given = os.environ.get("FSH3D_CACHE_DIR")
    if given:
        try:
            return Path(given).expanduser()
        except RuntimeError:
            raise ValueError(f"FSH3D_CACHE_DIR is {given!r}, but there is no such user, or no home of his") from None
    try:
        folder = platformdirs.user_cache_path("fsh3d_o3d", appauthor=False)
    except (RuntimeError, KeyError, OSError):
        return _NOWHERE
    return folder if folder.is_absolute() else _NOWHERE
