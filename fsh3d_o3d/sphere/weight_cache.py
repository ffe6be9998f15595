"""Solved weights, kept in memory and on disk.

A file holds one solution under a name made of everything it depends on, and a checksum of itself; one that does not
match is solved again. Files are written whole or not at all, so that processes may share the folder. A folder that
cannot be written is no error: the weights are then solved each time. ``FSH3D_CACHE_DIR`` moves it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._cache_folder import cache_folder
from fsh3d_o3d._npz import read_npz
from fsh3d_o3d.sphere.grids import SphericalGrid
from fsh3d_o3d.sphere.weight_solution import WeightSolution

__all__ = ["clear_weight_cache", "weight_cache_directory"]

_FORMAT = 2  # raised when the solver changes what it returns
_MEMORY_BYTES = 256 * 2**20  # of weights, a choice: some 300 solutions of b = 128
_ABOUT_BYTES = 2**16  # for the JSON beside the weights, which has some hundred; a choice
_log = logging.getLogger("fsh3d_o3d")
_lock = threading.Lock()
_memory: OrderedDict[str, WeightSolution] = OrderedDict()


def weight_cache_directory() -> Path:
    """Return the folder where solved weights are kept; it need not exist.

    Example:
        >>> removed = fsh.clear_weight_cache()
        >>> solution = fsh.analytic_weights(fsh.fibonacci_grid(600), bandwidth=10)
        >>> len(list(fsh.weight_cache_directory().iterdir()))
        1
    """
    return cache_folder() / "weights"


def clear_weight_cache() -> int:
    """Remove every solution from memory and disk, and what killed processes left; returns the number of files.

    Example:
        >>> removed = fsh.clear_weight_cache()  # what there was before
        >>> solution = fsh.analytic_weights(fsh.fibonacci_grid(600), bandwidth=10)
        >>> fsh.clear_weight_cache()
        1
    """
    with _lock:
        _memory.clear()
    removed = 0
    # What a killed process left begins with a dot and ends in .npz; in .tmp, where an older version wrote it.
    for path in [*weight_cache_directory().glob("*.npz"), *weight_cache_directory().glob("*.tmp")]:
        with contextlib.suppress(OSError):
            path.unlink()
            removed += 1
    return removed


def weight_key(grid: SphericalGrid, bandwidth: int) -> str:
    """A name for the solution of one grid and bandwidth."""
    return f"v{_FORMAT}-b{bandwidth}-n{len(grid)}-{grid.fingerprint[:32]}"


def find(key: str, n: int) -> WeightSolution | None:
    """The solution under a key, from memory or from a file that passes its checksum."""
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    solution = _read(weight_cache_directory() / f"{key}.npz", n)
    if solution is not None:
        _remember(key, solution)
    return solution


def keep(key: str, solution: WeightSolution) -> None:
    """Put a solution into memory and, if the folder can be written, on disk."""
    _remember(key, solution)
    path = weight_cache_directory() / f"{key}.npz"
    about = {name: value for name, value in vars(solution).items() if name != "weights"}
    about["sha256"] = _digest(key, solution.weights, about)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        archive = io.BytesIO()
        np.savez(archive, weights=solution.weights, about=np.array(json.dumps(about)))
        atomic_write_bytes(path, archive.getvalue())
    except OSError as error:
        _log.debug("weights not cached in %s: %s", path.parent, error)


def _read(path: Path, n: int) -> WeightSolution | None:
    try:
        file = read_npz(path, n * np.dtype(np.float64).itemsize + _ABOUT_BYTES)
        weights, about = file["weights"], json.loads(str(file["about"]))
        digest = about.pop("sha256")
        if weights.shape != (n,) or weights.dtype != np.float64 or _digest(path.stem, weights, about) != digest:
            raise ValueError("checksum differs")
        weights.setflags(write=False)
        return WeightSolution(weights=weights, **about)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except Exception as error:  # whatever a damaged file makes the readers do, the weights are then solved again
        _log.warning("ignoring the damaged cache file %s: %s", path, error)
        return None


def _remember(key: str, solution: WeightSolution) -> None:
    with _lock:
        _memory[key] = solution
        _memory.move_to_end(key)
        while len(_memory) > 1 and sum(kept.weights.nbytes for kept in _memory.values()) > _MEMORY_BYTES:
            _memory.popitem(last=False)


def _digest(key: str, weights: np.ndarray[Any, np.dtype[np.float64]], about: dict[str, object]) -> str:
    text = json.dumps([key, about], sort_keys=True)
    return hashlib.sha256(np.ascontiguousarray(weights).tobytes() + text.encode()).hexdigest()
