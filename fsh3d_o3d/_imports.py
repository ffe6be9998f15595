"""Where modules are looked for: never first, and never unasked, in the working folder.

Python started with ``-c``, ``-m`` or a program on standard input, a prompt and a notebook look for modules in the
working folder before anywhere else. Whoever works in a folder of files from elsewhere would run its ``numpy.py``. What
this package imports late, and what its own processes import, comes from where packages are installed.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import site
import sys
import sysconfig
import threading
from collections.abc import Iterator
from types import ModuleType


def working_folder() -> str | None:
    """Return the working folder, links resolved; None where it was removed."""
    try:
        return os.path.realpath(os.getcwd())  # noqa: PTH109 - pathlib would raise as well
    except OSError:
        return None


# ``python -m`` and an empty entry of PYTHONPATH put it on the path by its name, which stays there when folders change.
_STARTED_IN = working_folder()
PACKAGE_FOLDER = os.path.realpath(os.path.dirname(os.path.dirname(__file__)))  # noqa: PTH120 - any bytes
# Working in one of these is no reason to do without it. The package's own is a checkout's, for those who work on it.
_INSTALLED = {
    os.path.realpath(folder)
    for folder in (
        *(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")),
        *site.getsitepackages(),
        site.getusersitepackages(),
        PACKAGE_FOLDER,
    )
}
_lock = threading.RLock()


def installed_path() -> list[str]:
    """Return ``sys.path`` without the working folder, that of the start, and entries relative to any."""
    untrusted = {working_folder(), _STARTED_IN} - _INSTALLED
    kept = [entry for entry in sys.path if isinstance(entry, str) and os.path.isabs(entry)]  # noqa: PTH117
    return [entry for entry in kept if os.path.realpath(entry) not in untrusted]


def path_for_processes() -> list[str]:
    """Return ``installed_path``, and behind it the folders from which this process has run code already.

    A descriptor that a user has written in a module beside the notebook is found, but nothing there stands in for what
    is installed.
    """
    path = installed_path()
    known = {os.path.realpath(entry) for entry in path}
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__dict__", {}).get("__file__")
        if "." in name or not isinstance(file, str) or not os.path.isfile(file):  # noqa: PTH113 - any bytes
            continue
        folder = os.path.dirname(os.path.realpath(file))  # noqa: PTH120 - same
        if hasattr(module, "__path__"):
            folder = os.path.dirname(folder)  # noqa: PTH120 - same
        if folder not in known:
            known.add(folder)
            path.append(folder)
    return path


@contextlib.contextmanager
def only_installed() -> Iterator[None]:
    """A block that imports nothing from the working folder."""
    if installed_path() == sys.path:
        yield
        return
    with _lock:
        kept = installed_path()
        taken = [(place, entry) for place, entry in enumerate(sys.path) if entry not in kept]
        sys.path[:] = kept
        try:
            yield
        finally:
            for place, entry in taken:  # what was added meanwhile stays
                sys.path.insert(place, entry)


def import_installed(name: str) -> ModuleType:
    """Import a module, from anywhere but the working folder unless it has been imported already."""
    if name in sys.modules:
        return importlib.import_module(name)
    with only_installed():
        return importlib.import_module(name)
