"""Every public name of the PyTorch layer shows how it is used, and what it shows runs."""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402


@pytest.mark.parametrize("name", ft.__all__)
def test_example_runs(name, tmp_path, monkeypatch):
    """Methods go on where their class's example ends."""
    (tmp_path / "samples").symlink_to(Path(__file__).parents[2] / "samples")
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    value = getattr(ft, name)
    found = [test for test in doctest.DocTestFinder().find(value, name, module=False, globs={}) if test.examples]
    assert re.search(rf"\bft\.{name}\b", "".join(example.source for test in found for example in test.examples))
    own = [member for member in vars(value) if not member.startswith("_")] if inspect.isclass(value) else []
    shown = "".join(example.source for test in found for example in test.examples)
    for method in own:
        if inspect.isfunction(getattr(value, method)) and method not in ("forward", "extra_repr"):
            assert f".{method}(" in shown, f"{name}.{method}: no example calls it"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    names, report = {"fsh": fsh, "ft": ft, "np": np, "torch": torch}, []
    for test in sorted(found, key=lambda test: test.lineno or 0):
        test.globs = names
        runner.run(test, out=report.append, clear_globs=False)
    assert not report, "".join(report)
