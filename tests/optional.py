"""What is tested only where an optional package is installed; `make test` lists what was left out, and why."""

from __future__ import annotations

import importlib.util

import pytest

HAS_TORCH = importlib.util.find_spec("torch") is not None
WITHOUT_TORCH = "PyTorch is not installed: fsh3d_o3d.torch is left out"


def skip_without_torch(*, needed: bool = True) -> None:
    """Leave out a test that needs PyTorch where there is none."""
    if needed and not HAS_TORCH:
        pytest.skip(WITHOUT_TORCH)
