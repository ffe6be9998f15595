"""The ``fsh3d`` command: one file a sub-command.

Exit codes: 0 done, 1 finished with some inputs failed (they are listed), 2 bad input or usage, 130 interrupted,
143 and 129 ended by SIGTERM or SIGHUP.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn

from fsh3d_o3d._imports import only_installed
from fsh3d_o3d._printable import printable
from fsh3d_o3d._version import __version__
from fsh3d_o3d.cli import align, cache, describe, evaluate, index, info, merge, query, reconstruct, view
from fsh3d_o3d.cli.console import error_line, say
from fsh3d_o3d.cli.process import TerminatedError, open_standard_streams, terminable
from fsh3d_o3d.errors import ConvergenceWarning, GeometryReadWarning, QuadratureWarning
from fsh3d_o3d.files import require_no_credentials

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with the given arguments (those of the process if None) and return its exit code."""
    open_standard_streams()
    with only_installed():
        return _run(arguments)


class _Parser(argparse.ArgumentParser):
    """Repeats nothing of the command line as it is; its sub-commands are of this class too."""

    def error(self, message: str) -> NoReturn:
        super().error(printable(message))


def _run(arguments: Sequence[str] | None) -> int:
    parser = _Parser(prog="fsh3d", description="Shapes as frequencies: meshes and point clouds as spherical harmonics.")
    parser.add_argument("--version", action="version", version=f"fsh3d_o3d {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (reconstruct, describe, align, merge, evaluate, index, query, info, view, cache):
        module.add_parser(commands)
    try:
        for argument in sys.argv[1:] if arguments is None else arguments:
            require_no_credentials(argument)  # before anything is repeated in a message
    except ValueError as error:
        say(f"fsh3d: error: {error}", error=True)
        return 2
    try:
        options = parser.parse_args(arguments)
    except SystemExit as stop:  # argparse has printed the help (0) or its message (2)
        return stop.code if isinstance(stop.code, int) else 2
    try:
        with terminable(), warnings.catch_warnings():
            # Said once each to the person at the terminal, whatever filters Python was started with.
            for category in (ConvergenceWarning, GeometryReadWarning, QuadratureWarning):
                warnings.simplefilter("always", category)
            warnings.showwarning = lambda message, *_: say(f"fsh3d: warning: {error_line(message)}", error=True)
            code: int = options.run(options)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        say("fsh3d: interrupted", error=True)
        return 130
    except TerminatedError as end:
        with contextlib.suppress(OSError):  # the terminal may be gone
            say(f"fsh3d: ended by {end}", error=True)
        return end.code
    except BrokenPipeError:
        # The reader of our output has gone; what Python would flush at exit goes nowhere instead.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if options.debug:
            raise
        foreseen = isinstance(error, (ValueError, TypeError, OSError, ImportError, MemoryError))
        prefix = "" if foreseen else f"internal error, please report it ({type(error).__name__}): "
        say(f"fsh3d: error: {prefix}{error_line(error)}", error=True)
        return 2
