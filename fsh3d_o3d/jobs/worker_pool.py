"""Processes that each do one task at a time and may die doing it.

``concurrent.futures`` gives up all pending work when one process dies, and cannot say which task killed it. Here each
process has its own pipe and one task in hand: a crash, an out-of-memory kill or an endless loop costs that task.
"""

from __future__ import annotations

import contextlib
import pickle
import resource
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pipe, spawn
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Generic, TypeVar

from fsh3d_o3d._imports import path_for_processes
from fsh3d_o3d.files import ChildProcess, end_after

Task = TypeVar("Task")
Result = TypeVar("Result")

# The processes share the cores already: a library that starts a thread a core in each of them slows all down.
_SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "DUCC0_NUM_THREADS"), "1"
)
_START_TIMEOUT = 120.0  # seconds; starting takes one, on a loaded machine or a slow disk many
_POLL_INTERVAL = 0.5  # seconds between looks at signals: one that another thread has got wakes nobody who waits


_NO_GUARD = (
    "worker processes import the script again that passes a function of its own: put what the script does below "
    'if __name__ == "__main__":'
)
_NO_MODULE = (
    "worker processes cannot find the function: it is of a prompt, a notebook or python -c; write it into a file and "
    "import it from there"
)
_starting = False  # whether this is a worker process that imports the caller's script


@dataclass(frozen=True)
class _NotStarted:
    """What a process sends that cannot begin."""

    reason: str
    """In one line."""


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
        RuntimeError: A process does not start, or this is one that is only just importing the script that started it.
    """
    if _starting:
        raise RuntimeError(_NO_GUARD)
    pending = deque(enumerate(tasks))
    pool: list[_Worker] = []
    start = partial(_Worker, bytes(ForkingPickler.dumps(function)), path_for_processes())
    try:
        while len(pool) < min(workers, len(tasks)):
            pool.append(start())
        while pool:
            remaining = min(_POLL_INTERVAL, max(0.0, min(worker.deadline for worker in pool) - time.monotonic()))
            ready = wait([worker.pipe for worker in pool], timeout=remaining)
            now = time.monotonic()
            for worker in [w for w in pool if w.pipe in ready or now > w.deadline]:
                alive, outcome = worker.answer() if worker.pipe in ready else (False, worker.too_late(timeout))
                if alive and pending:
                    worker.give(*pending.popleft(), timeout)
                else:
                    pool.remove(worker)
                    worker.stop()
                    if pending:
                        pool.append(start())
                if outcome is not None:
                    yield outcome
    finally:
        for worker in pool:
            worker.stop()


@dataclass
class _Worker:
    """A process and the task it has in hand."""

    function: bytes
    path: list[str]
    deadline: float = field(init=False)

    def __post_init__(self) -> None:
        self.pipe, theirs = Pipe()
        self.deadline = time.monotonic() + _START_TIMEOUT
        self._index: int | None = None
        try:
            self._process = ChildProcess(
                __name__,
                "serve",
                theirs.fileno(),
                path=self.path,
                environment=_SINGLE_THREADED,
                descriptor=theirs.fileno(),
            )
        except BaseException:
            self.pipe.close()
            raise
        finally:
            theirs.close()  # only the process holds it now: its death ends the pipe
        with contextlib.suppress(OSError):  # as below
            self.pipe.send((_main_module(self.function), self.function))

    def give(self, index: int, task: object, timeout: float) -> None:
        """Hand over a task."""
        self._index = index
        self.deadline = time.monotonic() + timeout
        with contextlib.suppress(OSError):  # a process that has died since is noticed when its answer is awaited
            self.pipe.send((task, timeout))

    def answer(self) -> tuple[bool, Outcome[Any] | None]:
        """Whether the process lives, and what became of its task (None when it has only come up)."""
        try:
            answer = self.pipe.recv()
        except (EOFError, OSError):
            cause = _cause(self._process.wait())
            return False, Outcome(self._in_hand(cause), None, f"the process describing it {cause}")
        if isinstance(answer, _NotStarted):
            raise RuntimeError(answer.reason)
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
        self._process.end()


def _cause(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    return f"was killed by {name}" + (", perhaps for want of memory" if -code == signal.SIGKILL else "")


def _main_module(function: bytes) -> dict[str, Any]:
    """Return what a process needs to make the caller's main module again: nothing, unless the function is of it."""
    if b"__main__" not in function:
        return {}
    return {name: value for name, value in spawn.get_preparation_data("").items() if name.startswith("init_main")}


def serve(descriptor: int) -> None:
    """The process's side: say that it is up, then answer tasks until the pipe ends."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError):  # where memory runs out, one task ends rather than the whole job
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    pipe = Connection(descriptor)
    main_module, pickled = pipe.recv()
    try:
        function = _function(main_module, pickled)
    except BaseException as error:  # a script may also exit
        with contextlib.suppress(OSError):
            pipe.send(_NotStarted(_why_not_started(error, main_module)))
        return
    with contextlib.suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            task, timeout = pipe.recv()
            end_after(timeout)
            answer = _answer(function, task)
            end_after(0)
            pipe.send(answer)


def _function(main_module: dict[str, Any], pickled: bytes) -> Callable[[Any], Any]:
    """Return the function, after its script, if it is of one, was imported."""
    global _starting
    _starting = True
    spawn.prepare(main_module)
    _starting = False
    function: Callable[[Any], Any] = pickle.loads(pickled)
    return function


def _why_not_started(error: BaseException, main_module: dict[str, Any]) -> str:
    if str(error) == _NO_GUARD:
        return _NO_GUARD
    if isinstance(error, AttributeError) and "__main__" in str(error) and not main_module:
        return _NO_MODULE
    return f"a worker process cannot load the function: {type(error).__name__}: {' '.join(str(error).split())}"


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
