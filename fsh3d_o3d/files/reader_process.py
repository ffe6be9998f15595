"""A process that reads files for another one and may die doing it.

``ReaderProcess`` is the side that asks, ``serve`` the side that reads. A request is a line of JSON; an answer is eight
bytes of length, that much JSON, and the raw bytes of the arrays it names. Nothing that is read is ever executed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import importlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import installed_path
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files.child_process import ChildProcess, end_after
from fsh3d_o3d.files.formats import Part, ReadFile
from fsh3d_o3d.files.parsing import read_error
from fsh3d_o3d.geometry import MeshArrays, PointArrays

READ_FILE = "fsh3d_o3d.files.parsing:read_file"
_START_SECONDS = 60.0  # a choice; starting takes a quarter of a second, on a busy system many times that
_POLL_SECONDS = 0.5  # a choice; waiting looks up, as a signal that another thread has got wakes nobody who waits
_EXIT_SECONDS = 10.0  # a choice, for a process that has closed its pipes; it takes milliseconds
_LARGEST_HEADER = 1 << 20  # bytes of JSON, a choice; answers have some hundred, and what is larger is none
_CLASSES = {kind.__name__: kind for kind in (MeshArrays, PointArrays)}
_ATTRIBUTE = "attributes/"  # before the names of attributes, which are anything
_MOST_AXES = 3  # of an array; texture coordinates have three
_DTYPES = {"f8": np.dtype(np.float64), "i8": np.dtype(np.int64)}
# One thread: the reader multiplies no matrices, and each BLAS thread would take address space from the limit.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

_STORAGE = ("AWS_", "GOOGLE_", "AZURE_")  # beginnings of the variables that tell how object storage is reached


def _packages() -> list[tuple[str, list[str]]]:
    """Return the packages that hold this module, outermost first, and where each finds its modules.

    The reader enters them empty: their own __init__ would load SciPy and more, which takes longer than everything else
    here, and which a process that reads untrusted files should not hold.
    """
    parts = __name__.split(".")[:-1]
    names = [".".join(parts[: depth + 1]) for depth in range(len(parts))]
    return [(name, list(sys.modules[name].__path__)) for name in names]


class ReaderProcess:
    """A reading process: started at the first request, kept for the next, replaced when it dies or hangs.

    Threads may share it (their requests queue); a forked process must not, see ``abandon``.
    """

    def __init__(self, function: str = READ_FILE) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._process: ChildProcess | None = None
        self._storage: dict[str, str] = {}

    def read(self, path: str, *, timeout: float, memory_limit: int) -> ReadFile:
        """Return what the process read from an absolute path.

        Raises:
            FileNotFoundError: There is no such file.
            GeometryReadError: The file cannot be read, or the process died, ran out of time or of memory.
        """
        with self._lock:
            try:
                process = self._running()
                answer = _ask(process, path, timeout, memory_limit)
            except _OutOfTimeError:
                self._stop()
                raise read_error(path, f"the reader was stopped after {timeout:g} s") from None
            except (EOFError, OSError):  # its end of the pipe is closed: it is dying, which takes a busy system a while
                raise read_error(path, f"the reader died ({self._stop(_EXIT_SECONDS)})") from None
            except (LookupError, TypeError, ValueError, AttributeError):
                raise read_error(path, f"the reader died ({self._stop()})") from None
            except BaseException:  # an interrupt leaves half an answer in the pipe
                self._stop()
                raise
        return _read_file(path, answer)

    def close(self) -> None:
        """End the process, if there is one, also while another thread waits for its answer."""
        process = self._process
        if process is not None:
            process.kill()
        with self._lock:
            self._stop()

    def abandon(self) -> None:
        """Let go of the process without ending it: in a forked child it belongs to the parent."""
        process, self._process = self._process, None
        self._lock = threading.Lock()  # another thread may have held it at the fork
        if process is not None:
            process.abandon()

    def _running(self) -> ChildProcess:
        if self._process is not None and self._process.poll() is not None:
            self._stop()  # it was ended from outside while idle; this request need not suffer
        storage = {name: value for name, value in os.environ.items() if name.startswith(_STORAGE)}
        if self._process is not None and storage != self._storage:
            self._stop()  # it knows other credentials than this process does by now
        if self._process is None:
            self._storage = storage
            self._process = ChildProcess(
                __name__,
                "serve",
                self._function,
                path=installed_path(),
                packages=_packages(),
                environment=_ENVIRONMENT,
                streams=subprocess.PIPE,
            )
            _receive(self._process, 1, time.monotonic() + _START_SECONDS)
        return self._process

    def _stop(self, seconds: float = 0) -> str:
        """End the process, unless it does so itself within ``seconds``, and say how it had ended."""
        process, self._process = self._process, None
        if process is None:
            return "it did not start"
        process.close_pipes()
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(timeout=seconds)
            process.end()
            return f"signal {-code}" if code < 0 else f"exit code {code}"
        process.end()
        return "it broke the protocol"


class _OutOfTimeError(Exception):
    """The answer took too long."""


def _ask(process: ChildProcess, path: str, timeout: float, memory_limit: int) -> dict[str, Any]:
    assert process.stdin is not None
    deadline = time.monotonic() + timeout
    request = json.dumps({"path": path, "memory_limit": memory_limit, "timeout": timeout}).encode("ascii") + b"\n"
    process.stdin.write(request)
    size = int.from_bytes(_receive(process, 8, deadline), "little")
    if size > _LARGEST_HEADER:
        raise ValueError("the header is too long")
    answer = json.loads(bytes(_receive(process, size, deadline)))
    if not isinstance(answer, dict):
        raise ValueError("the header is not an object")
    for array in answer.get("arrays", {}).values():
        shape = tuple(int(length) for length in array["shape"])
        dtype = _DTYPES.get(array["dtype"])
        if dtype is None or not 1 <= len(shape) <= _MOST_AXES or min(shape) < 0:
            raise ValueError("the header asks for impossible arrays")
        size = math.prod(shape) * dtype.itemsize
        if size > memory_limit:
            raise ValueError("the header asks for impossible arrays")
        array["data"] = _receive(process, size, deadline).view(dtype).reshape(shape)
    return answer


def _receive(process: ChildProcess, size: int, deadline: float) -> NDArray[np.uint8]:
    assert process.stdout is not None
    descriptor = process.stdout.fileno()
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    result = np.empty(size, dtype=np.uint8)
    rest = memoryview(cast(Any, result))
    while rest:
        remaining = deadline - time.monotonic()
        if remaining <= 0:
            raise _OutOfTimeError
        if not poll.poll(1000 * min(remaining, _POLL_SECONDS)):
            continue
        got = os.readv(descriptor, [rest])
        if got == 0:
            raise EOFError
        rest = rest[got:]
    return result


def _read_file(path: str, answer: dict[str, Any]) -> ReadFile:
    if answer.get("error") == "FileNotFoundError":
        raise FileNotFoundError(errno.ENOENT, "No such file", path)
    if "error" in answer or answer.get("kind") not in _CLASSES:
        raise read_error(path, str(answer.get("reason", "the reader broke the protocol")))
    kind: Any = _CLASSES[answer["kind"]]
    try:
        given = {name: array["data"] for name, array in answer["arrays"].items()}
        attributes = {name.removeprefix(_ATTRIBUTE): given.pop(name) for name in list(given) if _ATTRIBUTE in name}
        geometry: MeshArrays | PointArrays = kind(**given, attributes=attributes)
        parts = tuple(
            Part(str(name), int(points), int(triangles)) for name, points, triangles in answer.get("parts", [])
        )
        return ReadFile(geometry, tuple(str(note) for note in answer.get("notes", [])), parts=parts)
    except (GeometryError, LookupError, TypeError, AttributeError, ValueError) as error:
        raise read_error(path, str(error)) from None


def serve(function: str) -> None:
    """Answer requests on standard input until it ends. ``function`` is ``module:name`` of what reads a path."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    with contextlib.suppress(OSError):  # fewer turns between the processes; not essential
        fcntl.fcntl(1, fcntl.F_SETPIPE_SZ, 1 << 20)
    output = os.dup(1)  # the answers' own descriptor: a stray print cannot mix with them
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    module, _, name = function.partition(":")
    read: Callable[[str], ReadFile] = getattr(importlib.import_module(module), name)
    os.write(output, b"+")
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    for line in sys.stdin.buffer:
        request = json.loads(line)
        end_after(request["timeout"])
        limit = _address_space() + request["memory_limit"]
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
        header, arrays = _answer(read, request["path"])
        end_after(0)
        encoded = json.dumps(header).encode("ascii")
        _send(output, len(encoded).to_bytes(8, "little") + encoded)
        for array in arrays:
            _send(output, memoryview(cast(Any, array)).cast("B"))


def _answer(read: Callable[[str], ReadFile], path: str) -> tuple[dict[str, Any], list[Float64Array]]:
    try:
        found = read(path)
    except FileNotFoundError:
        return {"error": "FileNotFoundError"}, []
    except GeometryError as error:
        return {"error": "GeometryReadError", "reason": str(error).removeprefix(f"{path}: ")}, []
    except MemoryError:
        return {"error": "GeometryReadError", "reason": "needs more memory than the reader is allowed"}, []
    geometry = found.geometry
    arrays = {field.name: getattr(geometry, field.name) for field in fields(geometry)}
    attributes = {f"{_ATTRIBUTE}{name}": array for name, array in arrays.pop("attributes").items()}
    given = {name: array for name, array in {**arrays, **attributes}.items() if array is not None}
    described = {name: {"dtype": array.dtype.str[1:], "shape": array.shape} for name, array in given.items()}
    header = {
        "kind": type(geometry).__name__,
        "arrays": described,
        "notes": found.notes,
        "parts": [(part.name, part.points, part.triangles) for part in found.parts],
    }
    return header, list(given.values())


def _address_space() -> int:
    """Bytes of address space in use now: the limit is on what a file may add."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a device, not a path
        return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _send(descriptor: int, data: bytes | memoryview) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]
