"""How many threads a call may use."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from fsh3d_o3d import _validation as check

Result = TypeVar("Result")


def resolve_threads(threads: int | None) -> int:
    """Return ``threads``, or where it is None what the process may use: its affinity, capped by OMP_NUM_THREADS."""
    if threads is not None:
        return check.integer(threads, "threads", minimum=1, maximum=1024)
    try:
        available = len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        available = os.cpu_count() or 1
    # The variable may be a list, one number a nesting level.
    with contextlib.suppress(ValueError):
        available = min(available, max(1, int(os.environ.get("OMP_NUM_THREADS", "").split(",")[0])))
    return available


@contextlib.contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Give BLAS one thread within the block.

    Our own threads share the work instead, in blocks that do not depend on their number: BLAS's own split of a product
    changes the last bits of its result.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()  # looks through the loaded libraries, which takes a millisecond


def run_all(jobs: Sequence[Callable[[], Result]], threads: int) -> list[Result]:
    """Run jobs that release the GIL, at most ``threads`` at a time; results in the order of the jobs."""
    if threads == 1 or len(jobs) <= 1:
        return [job() for job in jobs]
    with ThreadPoolExecutor(min(threads, len(jobs))) as pool:
        return list(pool.map(lambda job: job(), jobs))
