"""The checks at the public boundary: what passes, what is refused, in which words."""

from __future__ import annotations

import fractions

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsh3d_o3d import _validation as check
from fsh3d_o3d.errors import MemoryEstimateError


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3), np.array(3)])
def test_integers(value: object) -> None:
    result = check.integer(value, "n", minimum=0)
    assert result == 3 and type(result) is int


@pytest.mark.parametrize("value", [3.0, "3", None, True, np.True_, [3], np.float32(3), fractions.Fraction(3)])
def test_not_integers(value: object) -> None:
    with pytest.raises(TypeError, match=r"^n must be an integer, got "):
        check.integer(value, "n", minimum=0)


def test_integer_bounds() -> None:
    assert check.integer(1, "n", minimum=1, maximum=1) == 1
    with pytest.raises(ValueError, match=r"^n must be between 1 and 4, got 5$"):
        check.integer(5, "n", minimum=1, maximum=4)
    with pytest.raises(ValueError, match=r"^n must be at least 1, got 0$"):
        check.integer(0, "n", minimum=1)
    assert check.bandwidth(4096) == check.MAXIMUM_BANDWIDTH
    with pytest.raises(ValueError, match=r"^bandwidth must be between 1 and 4096, got 4097$"):
        check.bandwidth(4097)


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers(value: float) -> None:
    assert check.number(value, "x") == value
    assert check.number(np.float64(value), "x") == value


def test_number_bounds() -> None:
    assert check.number(2, "x", minimum=2, maximum=2) == 2.0
    with pytest.raises(ValueError, match=r"^x must be >= 0, got -1$"):
        check.number(-1, "x", minimum=0)
    with pytest.raises(ValueError, match=r"^x must be > 0, got 0$"):
        check.number(0, "x", minimum=0, exclusive=True)
    with pytest.raises(ValueError, match=r"^x must be >= 0 and <= 1, got 2$"):
        check.number(2, "x", minimum=0, maximum=1)
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match=r"^x must be finite, got"):
            check.number(bad, "x")
    for wrong in ("a", None, [1, 2], 1j):
        with pytest.raises(TypeError, match=r"^x must be a number, got"):
            check.number(wrong, "x")


def test_choice() -> None:
    assert check.choice("a", "mode", ("a", "b")) == "a"
    for bad in ("c", None, ["a"], 1):
        with pytest.raises(ValueError, match=r"^mode must be one of 'a', 'b', got "):
            check.choice(bad, "mode", ("a", "b"))


def test_real_arrays() -> None:
    single = np.ones(3, dtype=np.float32)
    assert check.real_array(single, "v") is single
    for other in ([1, 2], np.ones(2, dtype=np.float16), np.ones(2, dtype=bool), np.ones(2, dtype=">f8")):
        result = check.real_array(other, "v")
        assert result.dtype == np.float64 and result.dtype.isnative
    for bad in (["a"], [1j], [None], np.array(["2020-01-01"], dtype="datetime64[D]")):
        with pytest.raises(TypeError, match=r"^v must be an array of real numbers, got dtype"):
            check.real_array(bad, "v")
    with pytest.raises(ValueError, match=r"^v must be finite, got 2 NaN or infinite of 3 values"):
        check.real_array([np.nan, 1, np.inf], "v")
    assert np.isnan(check.real_array([np.nan], "v", finite=False)).all()


@given(count=st.integers(1, 5), shape=st.lists(st.integers(0, 4), max_size=3).map(tuple))
def test_values_on(count: int, shape: tuple[int, ...]) -> None:
    values = np.zeros(shape)
    if shape and shape[-1] == count:
        assert check.values_on(values, "values", count) is values
    else:
        with pytest.raises(ValueError, match=rf"^values must have shape \(…, n\) = \(…, {count}\), got"):
            check.values_on(values, "values", count)


def test_vectors_and_points() -> None:
    assert check.vectors([[1, 2, 3]], "v").flags.c_contiguous
    assert check.vectors(np.zeros((0, 3)), "v", minimum=0).shape == (0, 3)
    for bad in ([1, 2, 3], [[1, 2]], np.zeros((0, 3)), np.zeros((2, 2, 3))):
        with pytest.raises(ValueError, match=r"^v must have shape \(n, 3\) with n >= 1, got"):
            check.vectors(bad, "v")
    given_point = np.array([1.0, 2, 3])
    assert check.point(given_point, "p") is not given_point
    with pytest.raises(ValueError, match=r"^p must have shape \(3,\), got \(2,\)"):
        check.point([1, 2], "p")


def test_directions_are_normalised_within_reason() -> None:
    result = check.directions([[1 + 5e-7, 0, 0]])
    assert result.tolist() == [[1, 0, 0]]
    for bad in ([[1 + 2e-6, 0, 0]], [[0, 0, 0]], [[1e200, 0, 0]], [[1e-200, 0, 0]]):
        with pytest.raises(ValueError, match=r"^directions must be unit vectors"):
            check.directions(bad)


@given(b=st.integers(1, 60))
def test_coefficients(b: int) -> None:
    values, found = check.coefficients(np.zeros((2, b * b)))
    assert found == b and values.shape == (2, b * b)
    with pytest.raises(ValueError, match=r"square number of coefficients last, got"):
        check.coefficients(np.zeros(b * b + 1))


def test_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "_available_memory", lambda: 10.0 * 2**30)
    monkeypatch.setattr(check, "_NEGLIGIBLE_MEMORY", 0)
    check.memory(7 * 2**30, "it")
    with pytest.raises(MemoryEstimateError, match=r"^it needs about 9\.0 GiB, more than the 8\.0 GiB allowed here$"):
        check.memory(9 * 2**30, "it")
    with pytest.raises(MemoryEstimateError, match=r"more than the 1\.0 GiB"):
        check.memory(2 * 2**30, "it", limit=2**30)


def test_available_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    assert check._available_memory() > 0

    def nowhere(*_: object, **__: object) -> None:
        raise FileNotFoundError

    monkeypatch.setattr("builtins.open", nowhere)
    assert check._available_memory() == float("inf")  # not Linux: the fixed limit alone counts
