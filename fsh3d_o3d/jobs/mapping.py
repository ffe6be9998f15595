"""Any function over the geometry of many files, in worker processes."""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import printable
from fsh3d_o3d._progress import progress_bar
from fsh3d_o3d.errors import GeometryReadWarning
from fsh3d_o3d.files import read_geometry_file
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.jobs.extraction import FailedInput, available_cores, reason_line
from fsh3d_o3d.jobs.worker_pool import run_tasks

__all__ = ["map_files"]


def map_files(
    function: Callable[[MeshArrays | PointArrays], Any],
    paths: Iterable[str | os.PathLike[str]],
    *,
    workers: int | None = None,
    timeout: float = 300.0,
    progress: bool = False,
) -> tuple[Any, ...]:
    """Call a function with the geometry of each file, side by side in worker processes.

    Every process uses one thread. A file that cannot be read, that the function refuses, that kills its process or
    takes too long gives a ``FailedInput`` in its place, and does not stop the others.

    Args:
        function: Takes ``MeshArrays`` or ``PointArrays`` and returns what pickles: a function or method of a module,
            or a ``functools.partial`` of one. A script that passes a function of its own is imported again by the
            processes, so it calls this below ``if __name__ == "__main__":``.
        paths: Files in any format that is read.
        workers: Processes; by default one for each core that this process may use.
        timeout: Seconds that one file may take.
        progress: Show a bar, on a terminal or in a notebook.

    Returns:
        What the function returned, or a ``FailedInput``, for each file in the order of the paths.

    Raises:
        TypeError: The function cannot be sent to another process.
        RuntimeError: The worker processes do not start; says why.

    Warns:
        GeometryReadWarning: A file was read in spite of something.

    Example:
        >>> from functools import partial
        >>> encode = partial(fsh.RadialShape.from_geometry, bandwidth=8)
        >>> gem, horn = fsh.map_files(encode, ["samples/gem.stl", "samples/horn.off"], workers=1)
        >>> gem.coefficients.shape
        (64,)
        >>> isinstance(horn, fsh.FailedInput), horn.reason.partition(" seen from")[0]
        (True, 'the surface is not star-shaped')
    """
    names = [os.fsdecode(path) for path in ([paths] if isinstance(paths, (str, os.PathLike)) else paths)]
    count = available_cores() if workers is None else check.integer(workers, "workers", minimum=1, maximum=1024)
    timeout = check.seconds(timeout, "timeout")
    try:
        ForkingPickler.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError):
        raise TypeError(
            f"function must be one of a module, which other processes can import, got {printable(repr(function))}"
        ) from None
    results: list[Any] = [None] * len(names)
    # Closed whatever happens here: an interrupt must not leave processes behind.
    with (
        progress_bar(len(names), wanted=progress, unit="file") as bar,
        closing(run_tasks(_Call(function), names, workers=count, timeout=timeout)) as outcomes,
    ):
        for outcome in outcomes:
            bar.update()
            name = names[outcome.index]
            if outcome.result is None:
                results[outcome.index] = FailedInput(name, reason_line(outcome.reason, name))
                continue
            results[outcome.index], notes = outcome.result
            for note in notes:
                warnings.warn(printable(f"{name}: {note}"), GeometryReadWarning, stacklevel=2)
    return tuple(results)


@dataclass(frozen=True)
class _Call:
    """What a worker process does with a file."""

    function: Callable[[MeshArrays | PointArrays], Any]

    def __call__(self, path: str) -> tuple[Any, tuple[str, ...]]:
        # Not in yet another process: this one is the one that may die.
        found = read_geometry_file(path, isolated=False)
        return self.function(found.geometry), found.notes
