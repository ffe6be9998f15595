"""Transforms keep their precision under autocast, as PyTorch's own Fourier transforms and factorisations do.

A sum over thousands of points in half precision has no digits left, so inside of autocast these functions compute in
float32: what comes in half precision is converted, what goes out is float32.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor

F = TypeVar("F", bound=Callable[..., Any])

_HALVES = (torch.float16, torch.bfloat16)


def full_precision(function: F) -> F:
    """Let a function, or the ``forward`` of a module, compute as if there were no autocast."""

    @functools.wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        device = next((arg.device.type for arg in args if isinstance(arg, Tensor)), None)
        if device is None or device == "meta" or not torch.is_autocast_enabled(device):
            return function(*args, **kwargs)
        with torch.autocast(device, enabled=False):
            return function(*map(_widened, args), **{name: _widened(value) for name, value in kwargs.items()})

    return wrapped  # type: ignore[return-value]


def _widened(value: Any) -> Any:
    return value.float() if isinstance(value, Tensor) and value.dtype in _HALVES else value
