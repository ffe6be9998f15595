"""Thread counts: where they come from, and that the caller's BLAS setting survives."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import fsh3d_o3d as fsh
from fsh3d_o3d.sphere import threads as _threads


def blas() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_given_threads_are_checked() -> None:
    assert _threads.resolve_threads(3) == 3
    for bad in (0, -1, 5000):
        with pytest.raises(ValueError, match=rf"threads must be between 1 and 1024, got {bad}"):
            _threads.resolve_threads(bad)
    with pytest.raises(TypeError, match=r"threads must be an integer, got str 'all'"):
        _threads.resolve_threads("all")  # type: ignore[arg-type]


@pytest.mark.parametrize(("setting", "expected"), [("1", 1), ("2", 2), ("64", 3), ("0", 1), ("2,2", 2), ("", 3)])
def test_default_is_what_the_process_may_use(setting: str, expected: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_threads.os, "sched_getaffinity", lambda _: {0, 1, 5}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", setting)
    assert _threads.resolve_threads(None) == expected


def test_without_affinity(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(_threads.os, "sched_getaffinity", raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr(_threads.os, "cpu_count", lambda: None)
    assert _threads.resolve_threads(None) == 1


def test_results_keep_the_order_of_the_jobs() -> None:
    jobs = [lambda i=i: i * i for i in range(50)]
    assert _threads.run_all(jobs, 1) == _threads.run_all(jobs, 4) == [i * i for i in range(50)]
    assert _threads.run_all([], 4) == []


def test_errors_of_jobs_are_raised() -> None:
    def fail() -> None:
        raise ZeroDivisionError

    for threads in (1, 2):
        with pytest.raises(ZeroDivisionError):
            _threads.run_all([fail, fail, fail], threads)


def test_blas_setting_is_restored() -> None:
    with threadpool_limits(2, "blas"):
        before = blas()
        with _threads.single_threaded_blas():
            assert set(blas()) <= {1}
        assert blas() == before
        with _threads.single_threaded_blas():
            with _threads.single_threaded_blas():
                pass
            assert set(blas()) <= {1}
        assert blas() == before


@pytest.mark.parametrize("first_out", ["main", "worker"])
def test_blas_setting_survives_overlapping_calls(first_out: str) -> None:
    """Two threads whose limited sections overlap: whoever enters second sees the limit of the first as the setting."""
    entered, leave = threading.Event(), threading.Event()

    def other() -> None:
        with _threads.single_threaded_blas():
            entered.set()
            leave.wait(10)

    worker = threading.Thread(target=other)
    with threadpool_limits(2, "blas"):
        before = blas()
        if first_out == "main":
            with _threads.single_threaded_blas():
                worker.start()
                entered.wait(10)
            leave.set()
            worker.join()
        else:
            worker.start()
            entered.wait(10)
            with _threads.single_threaded_blas():
                leave.set()
                worker.join()
        assert blas() == before


@pytest.mark.parametrize("b", [4, 40])
@pytest.mark.parametrize("bad", [0, -2, 1.5, "all"])
def test_every_function_checks_threads(b: int, bad: object) -> None:
    """Whichever engine answers, the small one or the large."""
    grid = fsh.fibonacci_grid(6 * b * b)
    calls = [
        lambda: fsh.evaluate(np.ones(b * b), grid, threads=bad),  # type: ignore[arg-type]
        lambda: fsh.fit_coefficients(np.ones(len(grid)), grid, b, threads=bad),  # type: ignore[arg-type]
        lambda: fsh.SphericalHarmonicTransform(b, threads=bad),  # type: ignore[arg-type]
        lambda: fsh.analytic_weights(grid, b, threads=bad),  # type: ignore[arg-type]
    ]
    for call in calls:
        with pytest.raises((ValueError, TypeError), match=r"threads must be"):
            call()
