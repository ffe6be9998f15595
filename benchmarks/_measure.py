"""Timing two sides fairly on a machine that is never quite idle, and memory in a process of its own.

Sides take turns, in reversed order every other round, so that a slow spell of the machine hits all of them; ratios are
medians of the rounds' ratios. Warm-up calls make plans, caches and thread pools before the clock starts. CPU time is
read beside wall time: ``Timing.cores`` shows whether a side kept to the threads it was given.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_info, threadpool_limits

_SHORTEST = 0.005  # seconds a sample takes at least: shorter calls are repeated within it
_LIBRARIES = ("numpy", "scipy", "ducc0", "open3d-cpu", "open3d", "healpy", "pyshtools")


@dataclass(frozen=True)
class Timing:
    """Seconds per call of one side."""

    samples: tuple[float, ...]
    """One per round, in the order of the rounds."""
    cores: float
    """CPU time over wall time, all rounds together."""

    @property
    def median(self) -> float:
        """The typical round."""
        return statistics.median(self.samples)

    @property
    def minimum(self) -> float:
        """The fastest round."""
        return min(self.samples)

    @property
    def maximum(self) -> float:
        """The slowest round."""
        return max(self.samples)

    def scaled(self, factor: float) -> Timing:
        """Return the time of ``factor`` calls, or of a part of one."""
        return Timing(tuple(factor * sample for sample in self.samples), self.cores)

    def over(self, other: Timing) -> float:
        """Return the median of this side's time over the other's, round by round."""
        return statistics.median(own / peer for own, peer in zip(self.samples, other.samples, strict=True))


def interleave(
    calls: Mapping[str, Callable[[], object]], *, rounds: int = 7, budget: float = 2.0, warm: bool = True
) -> dict[str, Timing]:
    """Time several sides in turns.

    Args:
        calls: The sides by name.
        rounds: At most so many samples a side.
        budget: Seconds after which rounds end early, though never before the third (the first without ``warm``).
        warm: Whether to call every side beforehand, which also tells how often to repeat short calls.
    """
    loops = {name: _loops(call) if warm else 1 for name, call in calls.items()}
    walls: dict[str, list[float]] = {name: [] for name in calls}
    cpu = dict.fromkeys(calls, 0.0)
    least = min(rounds, 3 if warm else 1)
    order = list(calls)
    collecting = gc.isenabled()
    gc.disable()
    try:
        begin = time.perf_counter()
        for turn in range(rounds):
            if turn >= least and time.perf_counter() - begin > budget:
                break
            for name in order if turn % 2 == 0 else reversed(order):
                wall, processor = _sample(calls[name], loops[name])
                walls[name].append(wall / loops[name])
                cpu[name] += processor / loops[name]
    finally:
        if collecting:
            gc.enable()
    return {name: Timing(tuple(walls[name]), cpu[name] / max(sum(walls[name]), 1e-12)) for name in calls}


@contextlib.contextmanager
def limited(threads: int) -> Iterator[None]:
    """Limit BLAS and OpenMP to so many threads within the block; ducc0 and our functions take theirs as arguments."""
    with threadpool_limits(threads):
        yield


def peak_memory(code: str, *arguments: object) -> int:
    """Return the peak resident memory in bytes of a fresh Python process that runs ``code``.

    ``resource.getrusage`` would not do: a process started from a large one reports the peak of its parent's image. The
    kernel's VmHWM belongs to the new image alone.

    Raises:
        RuntimeError: The process failed.
    """
    tail = "\nimport pathlib\nprint(pathlib.Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    done = subprocess.run(
        [sys.executable, "-c", code + tail, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"the process to measure failed with code {done.returncode}: {done.stderr.strip()[-500:]}")
    return int(done.stdout.split()[-1]) * 1024


def environment() -> dict[str, str]:
    """Return what figures depend on: processor, cores, load, versions, BLAS."""
    versions = {}
    for library in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[library] = metadata.version(library)
    blas = {f"{pool['internal_api']} {pool.get('version')}" for pool in threadpool_info() if pool["user_api"] == "blas"}
    return {
        "processor": _processor(),
        "cores available": str(len(os.sched_getaffinity(0))),
        "load average at start": ", ".join(f"{load:.1f}" for load in os.getloadavg()),
        "python": platform.python_version(),
        "libraries": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "BLAS": ", ".join(sorted(blas)),
    }


def _loops(call: Callable[[], object]) -> int:
    call()
    wall, _ = _sample(call, 1)
    return max(1, math.ceil(_SHORTEST / max(wall, 1e-7)))


def _sample(call: Callable[[], object], loops: int) -> tuple[float, float]:
    processor, wall = time.process_time(), time.perf_counter()
    for _ in range(loops):
        call()
    return time.perf_counter() - wall, time.process_time() - processor


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
