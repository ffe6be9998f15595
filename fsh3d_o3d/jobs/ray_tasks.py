"""The tasks of ``worker_pool.run_tasks`` spread over a Ray cluster.

Ray runs one part of the tasks on each of its processors, and there each part runs in a process of ``worker_pool``: a
crash, a hang or an allocation without end costs one task, with the same reason, as on one machine. Outcomes stream back
to the caller, who is the only one that writes.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any
from urllib.parse import urlsplit

from fsh3d_o3d._imports import PACKAGE_FOLDER, import_installed
from fsh3d_o3d.jobs.worker_pool import Outcome, Result, Task, run_tasks

_SMALLEST_PART = 8  # tasks: starting a process takes as long as describing dozens of files
_LARGEST_PART = 256  # tasks that Ray repeats at most when it loses a machine; a choice
_PARTS_A_PROCESSOR = 4  # at least, where there are so many tasks, so that all end at about the same time
_PARTS_IN_HAND = 2  # a processor: one that runs, one that waits
_ANSWER_TIMEOUT = 4.0  # seconds to connect, and as many to be greeted
# What opens every HTTP/2 connection, which gRPC is (RFC 9113, section 3.4), with empty settings behind it.
_HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
_KIND_AT, _SETTINGS = 3, 4  # the byte that tells the kind of what comes, and the kind that a server sends first


def run_tasks_on_ray(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int,
    timeout: float,
    address: str | None = None,
) -> Generator[Outcome[Result], None, None]:
    """Call ``function`` with each task on a Ray cluster; outcomes come as they are done.

    A Ray that this process is connected to already is used, and left as it is.

    Args:
        function: Anything that pickles and that every machine of the cluster can import.
        tasks: Anything that pickles.
        workers: Processors of a Ray that is started here.
        timeout: Seconds after which a task's process is killed.
        address: Of a cluster, as ``ray.init`` takes it; None: one is started on this machine, and ended afterwards.

    Raises:
        ModuleNotFoundError: Ray is not installed.
        ConnectionError: There is no cluster at the address.
        RuntimeError: Ray lost a part of the tasks, or a process does not start.
    """
    ray = _ray()
    if not tasks:
        return
    ours = not ray.is_initialized()
    if ours:
        if address is not None:
            _require_server(address)
        own = {"address": "local", "num_cpus": workers, "include_dashboard": False}
        try:
            with _in_the_package_folder():
                ray.init(
                    **(own if address is None else {"address": address}), log_to_driver=False, logging_level="ERROR"
                )
        except (RuntimeError, ValueError, OSError) as error:
            where = "on this machine" if address is None else f"at {address}"
            raise ConnectionError(f"no Ray {where}: {' '.join(str(error).split())[:200]}") from error
    try:
        yield from _outcomes(ray, function, tasks, timeout)
    except ray.exceptions.RayError as error:
        reason = " ".join(str(error).split())[-300:]
        raise RuntimeError(f"Ray lost a part of the work, what is written stays: {reason}") from error
    finally:
        if ours:
            ray.shutdown()


@contextmanager
def _in_the_package_folder() -> Iterator[None]:
    """A block in which the working folder is where this package is installed.

    Ray puts the one in which it is started before all else on the path of its workers, which would run a ``numpy.py``
    that lies among the files of a library.
    """
    before = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.chdir(PACKAGE_FOLDER)
        yield
    finally:
        os.fchdir(before)
        os.close(before)


def _require_server(address: str) -> None:
    """Find out whether something like Ray listens at an address: Ray itself would go on trying for minutes.

    Raises:
        ConnectionError: Nothing does, or this is no address.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", address)
    scheme, _, place = address.rpartition("://")
    if address in ("auto", "local") or scheme not in ("", "ray"):  # what Ray looks up itself
        return
    try:
        parts = urlsplit(f"//{place}")
        host, port = parts.hostname, parts.port
    except ValueError:  # a port that is no number, or too large a one
        host, port = None, None
    if not host or not port:
        raise ConnectionError(f"no Ray at {address}: expected HOST:PORT, ray://HOST:PORT, 'auto' or 'local'")
    try:
        greeting = _greeting(host, port)
    except (OSError, UnicodeError) as error:  # the latter of a name that can be no host's
        raise ConnectionError(f"no Ray at {address}: {getattr(error, 'strerror', None) or error}") from error
    encrypted = os.environ.get("RAY_USE_TLS", "0").lower() in ("1", "true")  # then only Ray can tell
    if not encrypted and greeting[_KIND_AT : _KIND_AT + 1] != bytes((_SETTINGS,)):
        raise ConnectionError(f"no Ray at {address}: something else listens there")


def _greeting(host: str, port: int) -> bytes:
    """Return the first bytes that a server sends, fewer than asked for if it does not care for gRPC."""
    with socket.create_connection((host, port), timeout=_ANSWER_TIMEOUT) as connection:
        try:
            connection.sendall(_HTTP2_PREFACE)
            with connection.makefile("rb") as stream:
                return stream.read(_KIND_AT + 1)
        except OSError:  # silent until the time was over, or hung up
            return b""


def _outcomes(
    ray: Any, function: Callable[[Task], Result], tasks: Sequence[Task], timeout: float
) -> Generator[Outcome[Result], None, None]:
    processors = max(1, int(ray.cluster_resources().get("CPU", 1)))
    fair = -(-len(tasks) // (_PARTS_A_PROCESSOR * processors))
    length = min(max(fair, _SMALLEST_PART), _LARGEST_PART)
    starts = iter(range(0, len(tasks), length))
    remote = ray.remote(num_cpus=1)(_part)
    shared = ray.put(function)  # once for all parts: it knows all that the index holds
    running: dict[Any, int] = {}

    def start_next() -> None:
        start = next(starts, None)
        if start is not None:
            running[remote.remote(shared, list(tasks[start : start + length]), timeout)] = start

    for _ in range(_PARTS_IN_HAND * processors):
        start_next()
    try:
        while running:
            part = ray.wait(list(running), num_returns=1)[0][0]
            try:
                outcome = ray.get(next(part))
            except StopIteration:
                del running[part]
                start_next()
                continue
            yield Outcome(running[part] + outcome.index, outcome.result, outcome.reason)
    finally:
        for part in running:
            ray.cancel(part)


def _part(
    function: Callable[[Task], Result], tasks: list[Task], timeout: float
) -> Generator[Outcome[Result], None, None]:
    """What runs on a processor of the cluster. One process, so that outcomes come in order if Ray has to repeat it."""
    with closing(run_tasks(function, tasks, workers=1, timeout=timeout)) as outcomes:
        yield from outcomes


def _ray() -> Any:
    # Ray reports usage to its makers unless told not to, and warns of a default that it will change.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        return import_installed("ray")  # takes a second or more
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "engine 'ray' needs Ray: install the extra, as in pip install 'fsh3d-o3d[ray]'", name="ray"
        ) from error
