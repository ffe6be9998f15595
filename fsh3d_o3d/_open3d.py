"""The one place that imports Open3D.

Importing Open3D takes seconds, so nothing does it before it is needed. ``open3d()`` returns the module.
"""

from __future__ import annotations

import errno
import functools
from types import ModuleType

from fsh3d_o3d._imports import import_installed, working_folder

_HOW_TO_INSTALL = (
    "fsh3d_o3d needs Open3D, and exactly one of its two wheels, which install the same module: "
    "pip install 'fsh3d-o3d[cpu]' (open3d-cpu) or pip install 'fsh3d-o3d[cuda]' (open3d)"
)


@functools.cache
def open3d() -> ModuleType:
    """Return the ``open3d`` module.

    Raises:
        FileNotFoundError: The working folder is gone.
        ImportError: Open3D is not installed, or a system library it links to is missing; says what to do.
    """
    if working_folder() is None:  # its MKL would end the process
        raise FileNotFoundError(errno.ENOENT, "The working folder is gone, and Open3D needs one: change to another")
    try:
        return import_installed("open3d")
    except ModuleNotFoundError as error:
        if error.name == "open3d":
            raise ImportError(_HOW_TO_INSTALL) from error
        raise
    except ImportError as error:
        raise ImportError(
            f"Open3D is installed but does not load: {error}. On Debian or Ubuntu: "
            "apt-get install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        ) from error
