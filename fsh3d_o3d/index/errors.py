"""What can be wrong with an index, and what Lance's messages mean."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator

from fsh3d_o3d._printable import without_credentials
from fsh3d_o3d.files import is_uri, storage_error

# What Lance and Arrow raise for data they cannot make sense of; Arrow's own errors are of these, too.
_OF_LANCE = (ValueError, RuntimeError, OSError, LookupError, ArithmeticError, TypeError, AssertionError)
# Panics of native code. They belong to modules that cannot be imported, and one of them is no Exception.
_PANICS = {"PanicException", "RustPanic"}
_OS_ERROR = re.compile(r"os error (\d+)")


class ShapeIndexError(ValueError):
    """A folder that is no index, or a damaged one, one of a newer version, or one made with other options."""


@contextlib.contextmanager
def translated(path: str, doing: str) -> Iterator[None]:
    """A block that calls Lance: its errors come out as ``OSError`` where the system said no, else as a damaged index.

    Args:
        path: The index.
        doing: What the block does, for the message.
    """
    try:
        yield
    except (ShapeIndexError, MemoryError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        if not (isinstance(error, _OF_LANCE) or type(error).__name__ in _PANICS):
            raise
        text = without_credentials(" ".join(str(error).split()))
        code = _OS_ERROR.search(text)
        if code is not None and int(code.group(1)) != 2:  # a missing file is damage
            number = int(code.group(1))
            raise OSError(number, f"{os.strerror(number)} while {doing}; the index is as it was", path) from error
        refused = storage_error(path, text) if is_uri(path) else None
        if refused is not None:
            raise refused from error
        raise ShapeIndexError(f"{path}: the index is damaged ({doing}): {text[:300]}") from error
