"""What the command needs of the process that it runs in: standard streams, and an orderly end."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

from fsh3d_o3d.files import fill_standard_descriptors


class TerminatedError(BaseException):
    """The process was asked to end. Like ``KeyboardInterrupt`` it is no ``Exception``: nobody handles it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number
        """Exit code that a shell gives to a process ended by this signal."""


def open_standard_streams() -> None:
    """Put ``/dev/null`` in the place of standard streams that are closed, as under some daemons."""
    fill_standard_descriptors()
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115 - for the process's life


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """A block that ends with ``TerminatedError`` when asked to, so that what it has begun is removed.

    Not where the caller has other plans for these signals, as ``nohup`` has.
    """

    def terminate(number: int, _: FrameType | None) -> None:
        for other in taken:  # removing what was begun is not disturbed by a second one
            signal.signal(other, signal.SIG_IGN)
        raise TerminatedError(number)

    taken: list[int] = []
    if threading.current_thread() is threading.main_thread():
        taken = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, terminate)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
