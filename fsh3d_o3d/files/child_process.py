"""Python processes that import only what is installed, and do not outlive the one that started them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import weakref
from collections.abc import Mapping, Sequence

from fsh3d_o3d._imports import working_folder

# The kernel kills the process as soon as nobody holds the other end of its lifeline any more, however its parent ended
# and whatever it does at that moment: a thread that waits for that would need the interpreter, which native code may
# hold. (The signal for a parent's death, PR_SET_PDEATHSIG, comes when the thread ends that started the process.)
_PROGRAM = """
import fcntl, os, select, signal, sys
fcntl.fcntl({lifeline}, fcntl.F_SETOWN, os.getpid())
fcntl.fcntl({lifeline}, fcntl.F_SETSIG, signal.SIGKILL)
fcntl.fcntl({lifeline}, fcntl.F_SETFL, os.O_ASYNC)
if select.select([{lifeline}], [], [], 0)[0]:
    os._exit(1)
sys.path[:] = {path!r}
import importlib, types
for name, folders in {packages!r}:
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = folders
importlib.import_module({module!r}).{function}({argument!r})
"""
_STANDARD_ERROR = 2  # the last of the three standard descriptors
_OVERTIME_SECONDS = 5.0  # after its caller's time limit, a choice: the caller, who can say why, ends it before

_started: weakref.WeakSet[ChildProcess] = weakref.WeakSet()


class ChildProcess(subprocess.Popen[bytes]):
    """A Python process that calls one function of one module; used by one thread at a time.

    Isolated mode and a search path of our choice: neither the working folder nor the environment can put another module
    in place of one that is installed. A session of its own: an interrupt from the keyboard is for the caller.
    """

    def __init__(
        self,
        module: str,
        function: str,
        argument: str | int,
        *,
        path: Sequence[str],
        packages: Sequence[tuple[str, list[str]]] = (),
        environment: Mapping[str, str],
        descriptor: int | None = None,
        streams: int | None = None,
    ) -> None:
        """Start it.

        Args:
            module: Holds the function.
            function: Name of what is called.
            argument: What it is called with.
            path: Where the process looks for modules.
            packages: Packages that are entered without running their ``__init__``, and their folders.
            environment: Variables beside those of this process.
            descriptor: An open one that it inherits.
            streams: What its standard input and output are, as for ``Popen``. Default: nothing.
        """
        fill_standard_descriptors()  # so that none of those below is one of them
        theirs, ours = os.pipe()
        self._release = weakref.finalize(self, os.close, ours)
        _started.add(self)
        program = _PROGRAM.format(
            lifeline=theirs,
            path=list(path),
            packages=list(packages),
            module=module,
            function=function,
            argument=argument,
        )
        streams = subprocess.DEVNULL if streams is None else streams
        try:
            super().__init__(
                [sys.executable, "-I", "-c", program],
                stdin=streams,
                stdout=streams,
                stderr=subprocess.DEVNULL if streams == subprocess.PIPE else None,
                bufsize=0,
                env={**os.environ, **environment},
                start_new_session=True,
                cwd="/" if working_folder() is None else None,  # some libraries do not bear one that was removed
                pass_fds=(theirs,) if descriptor is None else (theirs, descriptor),
            )
        except BaseException:
            self._release()
            raise
        finally:
            os.close(theirs)

    def end(self) -> int:
        """End it, whatever it does, and return its exit code: 128 and more are signals."""
        self.close_pipes()
        self.kill()
        code = self.wait()
        self._release()
        return code

    def close_pipes(self) -> None:
        """Close this side of its standard streams."""
        for pipe in (self.stdin, self.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def abandon(self) -> None:
        """Let go of it without ending it: in a forked child it belongs to the parent."""
        self.returncode = 0  # not ours to wait for
        self.close_pipes()


def _forget_lifelines() -> None:
    """A forked process holds a copy of each, which would keep the children of its parent alive."""
    for process in list(_started):
        process._release()
    _started.clear()


os.register_at_fork(after_in_child=_forget_lifelines)


def fill_standard_descriptors() -> None:
    """Open ``/dev/null`` where standard input, output or error is closed, or the next file opened would become it."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= _STANDARD_ERROR:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


def end_after(seconds: float) -> None:
    """Let the kernel end this process unless it is asked again in time; 0: not any more.

    The caller's own time limit is shorter. This is for one that is stopped, or that has lost sight of the process.
    """
    if seconds:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    signal.setitimer(signal.ITIMER_REAL, seconds + _OVERTIME_SECONDS if seconds else 0)
