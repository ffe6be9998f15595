"""Descriptors for tests: quick, and able to fail in every way. At the top of a module, so that processes find them."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.distance import cdist

from fsh3d_o3d.jobs import worker_pool

RAISE, NAN, CRASH, EXIT, HANG, THREADS, OPEN3D = 101, 102, 103, 104, 105, 106, 107
"""Numbers of vertices that make ``ToyDescriptor`` misbehave, or tell about its process."""


@dataclass(frozen=True)
class ToyDescriptor:
    """The extents of the bounding box, sorted."""

    fingerprint: str = "toy"
    hanging: Path | None = None
    """Made once it hangs."""

    def describe(self, geometry):
        count = len(geometry.vertices)
        if count == RAISE:
            raise ZeroDivisionError("cannot\ndescribe this")
        if count == NAN:
            return np.full(3, np.nan)
        if count == CRASH:
            os.kill(os.getpid(), signal.SIGSEGV)
        if count == EXIT:
            os._exit(7)
        if count == HANG:
            if self.hanging is not None:
                self.hanging.touch()
            time.sleep(1000)
        if count == THREADS:
            return np.full(3, float(os.environ["OMP_NUM_THREADS"]))
        if count == OPEN3D:
            return np.full(3, float("open3d" in sys.modules))
        return np.sort(np.ptp(geometry.vertices, axis=0))

    def distances(self, queries, others, *, progress=False):
        return cdist(queries, others, "cityblock")


@dataclass(frozen=True)
class NotAVector(ToyDescriptor):
    def describe(self, geometry):
        return geometry.vertices


class DoesNotArrive(ToyDescriptor):
    """Pickles, but cannot be made again in another process."""

    def __reduce__(self):
        return int, ("not a number",)


def let_an_hour_pass(monkeypatch, mark: Path) -> None:
    """Let the clock of those who wait for processes leap as soon as a file is there.

    Then a process that hangs is found out whatever the limit, which may be longer than a busy machine needs for others.
    """
    real = time.monotonic
    clock = SimpleNamespace(monotonic=lambda: real() + 3601 * mark.exists())
    monkeypatch.setattr(worker_pool, "time", clock)
