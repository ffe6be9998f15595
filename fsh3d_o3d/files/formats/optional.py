"""Libraries for a format that not every user needs: loaded when a file of that format is met."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.errors import GeometryError, GeometryReadError

_one_at_a_time = threading.Lock()
_STREAMS = (1, 2)  # descriptors of standard output and error


def optional_module(name: str, *, extra: str, what: str) -> Any:
    """Return a module of one of the package's extras.

    Args:
        name: Of the module.
        extra: What brings it.
        what: Files that need it, in the plural.

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


@contextlib.contextmanager
def guarded(what: str) -> Iterator[None]:
    """A block that calls a library on a file's content: whatever it raises becomes an error of the file.

    Raises:
        GeometryReadError: ``what`` went wrong, and the library's reason.
    """
    try:
        yield
    except (GeometryError, MemoryError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # a panic of Rust is no Exception
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise GeometryReadError(f"truncated or damaged: {what} ({reason})") from None


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """A block in which a library that is not Python writes nothing to standard output and error.

    Threads take turns: one that came in between would put back what the other had put in place.
    """
    with _one_at_a_time, open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - a device, not a path
        sys.stdout.flush()
        sys.stderr.flush()
        kept = [os.dup(descriptor) for descriptor in _STREAMS]
        try:
            for descriptor in _STREAMS:
                os.dup2(nowhere.fileno(), descriptor)
            yield
        finally:
            for descriptor, copy in zip(_STREAMS, kept, strict=True):
                os.dup2(copy, descriptor)
                os.close(copy)
