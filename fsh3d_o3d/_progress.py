"""Bars that show how far a long computation has come: on a terminal and in a notebook, nowhere else."""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

from tqdm import tqdm


def progress_bar(total: float, *, wanted: bool, **options: Any) -> Any:
    """Return a bar of ``tqdm``, silent where none is wanted or nobody would see it change.

    In a notebook it is drawn by its widgets where these are installed (``ipywidgets``), else as text below the cell.

    Args:
        total: What makes it full.
        wanted: Whether the caller asked for it.
        options: Of ``tqdm``.
    """
    notebook = in_a_notebook()
    shown = wanted and (notebook or sys.stderr.isatty())
    kind: Any = tqdm
    if shown and notebook and importlib.util.find_spec("ipywidgets") is not None:
        from tqdm.notebook import tqdm as kind
    return kind(total=total, leave=False, disable=not shown, **options)


def in_a_notebook() -> bool:
    """Return whether what is printed appears in a notebook: its kernel has put streams of its own in their place."""
    return type(sys.stderr).__module__.partition(".")[0] == "ipykernel"
