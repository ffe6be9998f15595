"""Processes that each do one task at a time and may die doing it (private).

``concurrent.futures`` gives up all pending work when one process dies, and cannot say which task killed it. Here each
process has its own pipe and one task in hand: a crash, an out-of-memory kill or an endless loop costs that task.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

# The processes share the cores already: a library that starts a thread a core in each of them slows all down.
_SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "DUCC0_NUM_THREADS"), "1"
)
_START_PATIENCE = 120.0  # seconds; starting takes one
# Seconds after which waiting looks up: a signal that the system has given to another thread, because this one was deaf
# to it while a process started, wakes nobody who waits.
_HEARTBEAT = 0.5


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What became of one task: a result or a reason."""

    index: int
    """Position among the tasks."""
    result: Result | None
    """What the function returned, if it did."""
    reason: str | None
    """One line if it did not."""


def run_tasks(
    function: Callable[[Task], Result], tasks: Sequence[Task], *, workers: int, timeout: float
) -> Generator[Outcome[Result], None, None]:
    """Call ``function`` with each task in separate processes; outcomes come as they are done.

    Args:
        function: Anything that pickles, such as a function at the top of a module or an instance of a class there.
        tasks: Anything that pickles.
        workers: Processes, each with one thread. No more are started than there are tasks.
        timeout: Seconds after which a task's process is killed.

    Raises:
        RuntimeError: A process does not start.
    """
    pending = deque(enumerate(tasks))
    pool: list[_Worker] = []
    try:
        while len(pool) < min(workers, len(tasks)):
            pool.append(_Worker(function))
        while pool:
            patience = min(_HEARTBEAT, max(0.0, min(worker.deadline for worker in pool) - time.monotonic()))
            ready = wait([worker.pipe for worker in pool], timeout=patience)
            now = time.monotonic()
            for worker in [w for w in pool if w.pipe in ready or now > w.deadline]:
                alive, outcome = worker.answer() if worker.pipe in ready else (False, worker.too_late(timeout))
                if alive and pending:
                    worker.give(*pending.popleft(), timeout)
                else:
                    pool.remove(worker)
                    worker.stop()
                    if pending:
                        pool.append(_Worker(function))
                if outcome is not None:
                    yield outcome
    finally:
        for worker in pool:
            worker.stop()


@dataclass
class _Worker:
    """A process and the task it has in hand."""

    function: Callable[[Any], Any]
    deadline: float = field(init=False)

    def __post_init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.deadline = time.monotonic() + _START_PATIENCE
        self._index: int | None = None
        self._process: SpawnProcess = context.Process(target=_serve, args=(theirs, self.function), daemon=True)
        try:
            with _worker_environment():
                self._process.start()
        except BaseException:
            self.pipe.close()
            raise
        finally:
            theirs.close()  # only the process holds it now: its death ends the pipe

    def give(self, index: int, task: object, timeout: float) -> None:
        """Hand over a task."""
        self._index = index
        self.deadline = time.monotonic() + timeout
        with contextlib.suppress(OSError):  # a process that has died since is noticed when its answer is awaited
            self.pipe.send(task)

    def answer(self) -> tuple[bool, Outcome[Any] | None]:
        """Whether the process lives, and what became of its task (None when it has only come up)."""
        try:
            answer = self.pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            cause = _cause(self._process.exitcode)
            return False, Outcome(self._in_hand(cause), None, f"the process describing it {cause}")
        return True, None if answer is None else Outcome(self._in_hand(""), *answer)

    def too_late(self, timeout: float) -> Outcome[Any]:
        """The outcome of a task whose time is over."""
        return Outcome(self._in_hand("hangs"), None, f"took longer than {timeout:g} s")

    def _in_hand(self, cause: str) -> int:
        if self._index is None:
            raise RuntimeError(f"a worker process did not start: it {cause}")
        return self._index

    def stop(self) -> None:
        """End the process, whatever it does."""
        self.pipe.close()
        self._process.kill()
        self._process.join()
        self._process.close()


def _cause(code: int | None) -> str:
    if code is None or code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    return f"was killed by {name}" + (", perhaps for want of memory" if -code == signal.SIGKILL else "")


@contextlib.contextmanager
def _worker_environment() -> Iterator[None]:
    """What a process started in this block inherits: one thread for libraries, and deafness to Ctrl-C.

    A terminal sends Ctrl-C to all its processes; this one answers it by ending the others.
    """
    before = {name: os.environ.get(name) for name in _SINGLE_THREADED}
    resource_tracker.ensure_running()  # starting it unblocks SIGINT (bpo-33613), so not after the next line
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ.update(_SINGLE_THREADED)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """The process's side: say that it is up, then answer tasks until the pipe ends."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError):  # where memory runs out, one task ends rather than the whole job
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # standard output belongs to the caller
    with contextlib.suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            pipe.send(_answer(function, pipe.recv()))


def _answer(function: Callable[[Any], Any], task: Any) -> tuple[Any, str | None]:
    try:
        return function(task), None
    except MemoryError:
        return None, "out of memory"
    except OSError as error:
        return None, error.strerror or str(error)
    except ValueError as error:
        return None, str(error)
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"
