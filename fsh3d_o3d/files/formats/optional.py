"""Libraries for a format that not every user needs: loaded when a file of that format is met."""

from __future__ import annotations

from typing import Any

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.errors import GeometryReadError


def optional_module(name: str, *, extra: str, what: str) -> Any:
    """Return a module of one of the package's extras.

    Raises:
        GeometryReadError: It is not installed: one line that names the extra.
    """
    try:
        return import_installed(name)
    except ImportError as error:
        package = name.partition(".")[0]
        absent = isinstance(error, ModuleNotFoundError) and error.name == package
        broken = "" if absent else f", and the one installed cannot be loaded ({str(error)[:120]})"
        raise GeometryReadError(
            f"{what} need the package {package}{broken}: pip install 'fsh3d-o3d[{extra}]'"
        ) from None
