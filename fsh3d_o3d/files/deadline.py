"""A time limit for calls that have none of their own."""

from __future__ import annotations

import errno
import queue
import threading
from collections.abc import Callable


def within(seconds: float, call: Callable[[], object]) -> None:
    """Call in a thread that is left behind if it takes too long: the clients of some storages have no limit of time.

    Raises:
        TimeoutError: It did.
    """
    outcome: queue.SimpleQueue[BaseException | None] = queue.SimpleQueue()

    def run() -> None:
        try:
            call()
            outcome.put(None)
        except BaseException as error:
            outcome.put(error)

    threading.Thread(target=run, daemon=True).start()
    try:
        error = outcome.get(timeout=seconds)
    except queue.Empty:
        raise TimeoutError(errno.ETIMEDOUT, f"no answer within {seconds:g} s, timed out") from None
    if error is not None:
        raise error
