"""Descriptors of many files: in worker processes on all cores, each file at its own risk."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import printable
from fsh3d_o3d._progress import progress_bar
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.files import read_geometry_file
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.jobs.descriptor_cache import CachedDescriptor, DescriptorCache, descriptor_key
from fsh3d_o3d.jobs.worker_pool import run_tasks

__all__ = ["Descriptor", "Extraction", "FailedInput", "extract_descriptors"]


class Descriptor(Protocol):
    """What describes shapes by vectors and compares these. Must pickle: it travels to the worker processes."""

    @property
    def fingerprint(self) -> str:
        """A text that differs wherever the same geometry would be described differently."""

    def describe(self, geometry: MeshArrays | PointArrays) -> NDArray[Any]:
        """Return the descriptor (d,) of a geometry, d being the same for all."""

    def distances(
        self, queries: NDArray[np.float32], others: NDArray[np.float32], *, progress: bool = False
    ) -> NDArray[Any]:
        """Return the distances (n, m) between descriptors (n, d) and (m, d); only their order in a row counts."""


@value
class FailedInput:
    """An input that was left out."""

    path: str
    """The file, or the model's id where no file was found."""
    reason: str
    """What is wrong with it, in one line."""


@value
class Extraction:
    """The descriptors of a list of files."""

    descriptors: NDArray[np.float32]
    """(n, d) descriptors of the files that could be described, in the order of the list."""
    indices: IntArray
    """(n,) positions in the list of the files described."""
    failed: tuple[FailedInput, ...]
    """The other files, in the order of the list."""
    seconds: Float64Array
    """(n,) CPU seconds that reading and describing each file took, in this run or when it was put into the cache."""
    cached: int
    """How many descriptors came from the cache."""


def extract_descriptors(
    paths: Sequence[str | os.PathLike[str]],
    descriptor: Descriptor,
    *,
    workers: int | None = None,
    cache: bool = True,
    timeout: float = 300.0,
    progress: bool = False,
) -> Extraction:
    """Describe many files.

    Each worker process uses one thread; the result does not depend on their number. A file that cannot be read or
    described, that kills its process or takes too long is listed and does not stop the others. A script that defines
    its own descriptor is imported again by the processes, so it calls this below ``if __name__ == "__main__":``.

    Args:
        paths: Meshes and point clouds in any format that is read.
        descriptor: What to compute.
        workers: Processes; by default one for each core that this process may use.
        cache: Look descriptors up by the content of their files, and keep those computed (see ``descriptor_cache``).
        timeout: Seconds that one file may take.
        progress: Show a bar, on a terminal or in a notebook.

    Raises:
        RuntimeError: The worker processes do not start, or descriptors differ in length.
    """
    workers = available_cores() if workers is None else check.integer(workers, "workers", minimum=1, maximum=1024)
    timeout = check.seconds(timeout, "timeout")
    names = [os.fsdecode(path) for path in paths]
    entries: dict[int, CachedDescriptor] = {}
    reasons: dict[int, str] = {}
    with (
        DescriptorCache() if cache else nullcontext() as store,
        progress_bar(len(names), wanted=progress, unit="model") as bar,
    ):
        states = [_state(name) for name in names]
        keys: list[bytes | None] = [None] * len(names)
        if store is not None:
            with ThreadPoolExecutor(workers) as threads:
                keys = list(threads.map(partial(descriptor_key, fingerprint=descriptor.fingerprint), names))
            found = store.find(key for key in keys if key is not None)
            entries = {index: found[key] for index, key in enumerate(keys) if key in found}
        cached = len(entries)
        bar.update(cached)
        todo = [index for index in range(len(names)) if index not in entries]
        files = [names[index] for index in todo]
        # Closed whatever happens here: an interrupt must not leave processes behind.
        with closing(run_tasks(_Describe(descriptor), files, workers=workers, timeout=timeout)) as outcomes:
            for outcome in outcomes:
                index, key = todo[outcome.index], keys[todo[outcome.index]]
                bar.update()
                if outcome.result is None:
                    reasons[index] = reason_line(outcome.reason, names[index])
                    continue
                entries[index] = outcome.result
                # A file that changed while it was read may not have the content that was hashed.
                if store is not None and key is not None and _state(names[index]) == states[index]:
                    store.keep(key, outcome.result)
    indices = sorted(entries)
    return Extraction(
        descriptors=_stacked([entries[index].values for index in indices]),
        indices=np.array(indices, dtype=np.int64),
        failed=tuple(FailedInput(names[index], reasons[index]) for index in sorted(reasons)),
        seconds=np.array([entries[index].seconds for index in indices], dtype=np.float64),
        cached=cached,
    )


@dataclass(frozen=True)
class _Describe:
    """What a worker process does with a file."""

    descriptor: Descriptor

    def __call__(self, path: str) -> CachedDescriptor:
        start = time.process_time()
        # Not in yet another process: this one is the one that may die.
        geometry = read_geometry_file(path, isolated=False).geometry
        values = np.asarray(self.descriptor.describe(geometry), dtype=np.float32)
        if values.ndim != 1 or values.size == 0:
            raise ValueError(f"its descriptor should have shape (d,), got {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError("its descriptor is not finite")
        return CachedDescriptor(values, time.process_time() - start)


def available_cores() -> int:
    """Return how many cores this process may use."""
    # Not capped by OMP_NUM_THREADS, which is about threads within a process.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _state(path: str) -> tuple[int, int, int] | None:
    try:
        about = Path(path).stat()
    except OSError:
        return None
    return about.st_ino, about.st_size, about.st_mtime_ns


def reason_line(reason: str | None, path: str) -> str:
    """Return in one line, without the file's name before it, why a task about a file has failed."""
    reason = reason or ""
    for prefix in (path, os.path.abspath(path)):  # noqa: PTH100 - as the reader names it: links are not resolved
        reason = reason.removeprefix(f"{prefix}: ").removeprefix(f"{printable(prefix)}: ")
    return " ".join(reason.split()) or "failed without a message"


def _stacked(descriptors: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    lengths = {len(values) for values in descriptors}
    if len(lengths) > 1:
        raise RuntimeError(f"descriptors of one option must have the same length, got {sorted(lengths)}")
    return np.stack(descriptors) if descriptors else np.empty((0, 0), dtype=np.float32)
