"""The cache of solved weights: hits, damage, concurrency, unwritable folders."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import QuadratureWarning
from fsh3d_o3d.sphere import weight_cache, weight_solver

GRID = fsh.fibonacci_grid(24)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, in memory as on disk."""
    monkeypatch.setenv("FSH3D_CACHE_DIR", str(tmp_path))
    forget()
    return tmp_path / "weights"


def forget() -> None:
    with weight_cache._lock:
        weight_cache._memory.clear()


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.exists() else []


def assert_same(a: fsh.WeightSolution, b: fsh.WeightSolution) -> None:
    for name, value in vars(a).items():
        other = vars(b)[name]
        assert type(other) is type(value)
        assert np.array_equal(other, value), name


def no_solving(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise AssertionError("solved although cached")

    monkeypatch.setattr(weight_solver, "_solve", fail)


def test_hits_from_memory_and_disk(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = fsh.analytic_weights(GRID, 2)
    assert len(files(folder)) == 1
    no_solving(monkeypatch)
    assert fsh.analytic_weights(GRID, 2) is first
    forget()
    second = fsh.analytic_weights(GRID, 2)
    assert second is not first
    assert_same(first, second)
    assert not second.weights.flags.writeable


def test_cache_false_neither_reads_nor_writes(folder: Path) -> None:
    fsh.analytic_weights(GRID, 2, cache=False)
    assert files(folder) == [] and not weight_cache._memory


def test_keys_tell_grids_and_bandwidths_apart(folder: Path) -> None:
    turned = fsh.grid_from_directions(GRID.directions[:, [1, 2, 0]])
    fsh.analytic_weights(GRID, 1)
    fsh.analytic_weights(GRID, 2)
    fsh.analytic_weights(turned, 2)
    assert len(files(folder)) == 3


def test_warning_comes_from_the_cache_too() -> None:
    grid = fsh.fibonacci_grid(4 * 20**2)
    for _ in range(2):
        with pytest.warns(QuadratureWarning):
            fsh.analytic_weights(grid, 20)


@pytest.mark.parametrize("mask", [0x01, 0x80])
def test_no_flipped_byte_gets_through(mask: int, folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Any one byte damaged: the file is refused or its contents are intact, and nothing is raised."""
    caplog.set_level(logging.CRITICAL, "fsh3d_o3d")
    good = fsh.analytic_weights(GRID, 2)
    (path,) = files(folder)
    raw = path.read_bytes()
    raised: dict[str, int] = {}
    for position in range(len(raw)):
        damaged = bytearray(raw)
        damaged[position] ^= mask
        path.write_bytes(damaged)
        try:
            found = weight_cache._read(path, len(GRID))
        except Exception as error:
            raised.setdefault(type(error).__name__, position)
        else:
            if found is not None:  # a byte that no reader looks at, such as a time stamp
                assert_same(found, good)
    assert raised == {}


def test_truncated_files_are_solved_again(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    good = fsh.analytic_weights(GRID, 2)
    (path,) = files(folder)
    raw = path.read_bytes()
    for length in (0, 1, 100, len(raw) // 2, len(raw) - 1):
        path.write_bytes(raw[:length])
        forget()
        assert_same(fsh.analytic_weights(GRID, 2), good)
        assert path.stat().st_size == len(raw)  # and replaced by a good one
    assert "ignoring the damaged cache file" in caplog.text


@pytest.mark.parametrize("damage", ["shape", "dtype", "checksum", "fields", "text", "other bandwidth"])
def test_wrong_contents_are_solved_again(damage: str, folder: Path) -> None:
    good = fsh.analytic_weights(GRID, 2)
    (path,) = files(folder)
    with np.load(path) as file:
        weights, about = file["weights"], json.loads(str(file["about"]))
    if damage == "shape":
        weights = weights[:-1]
    elif damage == "dtype":
        weights = weights.astype(np.float32)
    elif damage == "checksum":
        weights[3] = np.nextafter(weights[3], 1)
    elif damage == "fields":
        del about["iterations"]
    about = json.dumps(about) if damage != "text" else "not JSON"
    np.savez(path, weights=weights, about=np.array(about))
    if damage == "other bandwidth":  # a file renamed by hand
        other = fsh.analytic_weights(GRID, 1)
        (path_of_other,) = set(files(folder)) - {path}
        path_of_other.replace(path)
        assert not np.array_equal(other.weights, good.weights)
    forget()
    assert_same(fsh.analytic_weights(GRID, 2), good)


def test_no_pickle_is_loaded(folder: Path) -> None:
    good = fsh.analytic_weights(GRID, 2)
    (path,) = files(folder)
    np.savez(path, weights=np.array([object()]), about=np.array("{}"))
    forget()
    assert_same(fsh.analytic_weights(GRID, 2), good)


def test_concurrent_processes_share_the_folder(folder: Path) -> None:
    code = (
        "import hashlib, fsh3d_o3d as fsh\n"
        "found = [fsh.analytic_weights(fsh.fibonacci_grid(6 * b * b), b).weights for b in (3, 4, 5)]\n"
        "print(hashlib.sha256(b''.join(w.tobytes() for w in found)).hexdigest())"
    )
    root = Path(__file__).parents[2]
    workers = [
        subprocess.Popen([sys.executable, "-W", "error", "-c", code], cwd=root, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    answers = {worker.communicate()[0] for worker in workers}
    assert [worker.returncode for worker in workers] == [0] * 4
    assert len(answers) == 1
    assert [path.suffix for path in files(folder)] == [".npz"] * 3  # one each, no temporaries
    for b in (3, 4, 5):
        grid = fsh.fibonacci_grid(6 * b * b)
        (path,) = folder.glob(f"*-b{b}-*")
        assert weight_cache._read(path, len(grid)) is not None


def test_failed_write_leaves_no_temporary(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    assert fsh.analytic_weights(GRID, 2).converged
    assert files(folder) == []


@pytest.mark.parametrize("where", ["a file", "below a file"])
def test_unwritable_folder_is_no_error(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Not by permissions: tests may run as root, whom they do not stop."""
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("FSH3D_CACHE_DIR", str(tmp_path / "taken" / ("" if where == "a file" else "deeper")))
    assert fsh.analytic_weights(GRID, 2).converged
    assert fsh.clear_weight_cache() == 0
    assert "damaged" not in caplog.text  # nothing is damaged where nothing can be


def test_clear(folder: Path) -> None:
    fsh.analytic_weights(GRID, 1)
    fsh.analytic_weights(GRID, 2)
    (folder / "left-behind.tmp").write_text("of a process that was killed")
    assert fsh.clear_weight_cache() == 3
    assert files(folder) == []
    assert not weight_cache._memory
    assert fsh.clear_weight_cache() == 0


def test_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert fsh.weight_cache_directory() == Path(os.environ["FSH3D_CACHE_DIR"]) / "weights"
    monkeypatch.delenv("FSH3D_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert fsh.weight_cache_directory() == tmp_path / "xdg" / "fsh3d_o3d" / "weights"
    assert not fsh.weight_cache_directory().exists()


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weight_cache, "_MEMORY_BYTES", 8 * 30)
    for n in (24, 25, 26):
        fsh.analytic_weights(fsh.fibonacci_grid(n), 2)
    assert [len(kept.weights) for kept in weight_cache._memory.values()] == [26]  # the latest


def test_what_is_no_regular_file_or_too_large_is_not_read(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    solution = fsh.analytic_weights(GRID, 2)
    (name,) = files(folder)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    weight_cache._memory.clear()
    assert fsh.analytic_weights(GRID, 2).weights.tobytes() == solution.weights.tobytes()
    (folder / name).unlink()
    np.savez(folder / name, weights=np.zeros(10**6))
    weight_cache._memory.clear()
    assert fsh.analytic_weights(GRID, 2).weights.tobytes() == solution.weights.tobytes()
    assert "would take more than" in caplog.text
