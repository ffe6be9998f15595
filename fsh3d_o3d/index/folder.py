"""What lies in the folder of an index."""

from __future__ import annotations

import os

from fsh3d_o3d.files import folder_names, is_uri
from fsh3d_o3d.index.errors import ShapeIndexError


def is_unmade(path: str) -> bool:
    """Whether the making of the models' table was cut off before its first manifest: it then has no data, either."""
    table = os.path.join(path, "models.lance")  # noqa: PTH118 - keeps bytes that are not UTF-8
    return not any(names_in(os.path.join(table, part)) for part in ("_versions", "data"))  # noqa: PTH118


def names_in(path: str) -> set[str] | None:
    """What a folder holds; None if there is none."""
    if is_uri(path):
        return folder_names(path) or None
    if os.path.isfile(path):  # noqa: PTH113 - keeps bytes that are not UTF-8
        raise ShapeIndexError(f"{path}: this is a file, not the folder of an index")
    return set(os.listdir(path)) if os.path.isdir(path) else None  # noqa: PTH112, PTH208 - same


def require_format(path: str, found: str, known: int) -> None:
    """Check the version of the tables of an index, as they tell it.

    Raises:
        ShapeIndexError: It is another than the one that is known.
    """
    if not found.isdigit():
        raise ShapeIndexError(f"{path}: this folder is no index of fsh3d_o3d")
    if int(found) > known:
        raise ShapeIndexError(
            f"{path}: the index has format {found}, made by a newer version of fsh3d_o3d; this one reads up to {known}"
        )
    if int(found) < known:
        raise ShapeIndexError(
            f"{path}: the index has format {found}, made by an older version of fsh3d_o3d; index the library anew"
        )
