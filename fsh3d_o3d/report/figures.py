"""What the figures of a report are called, how they are written, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

FigureValue = str | float | bool | None
"""What a table may show: text, a number, yes or no, or nothing."""


@dataclass(frozen=True)
class Figure:
    """One row of a table."""

    label: str
    """What it is called."""
    value: str
    """The value as text."""
    meaning: str
    """One sentence for those who meet it first; may be empty."""


@dataclass(frozen=True)
class _Known:
    label: str
    meaning: str
    percent: bool = False


_KNOWN = {
    "method": _Known("Method", "How the surface was turned into functions on the sphere."),
    "bandwidth": _Known(
        "Bandwidth", "The number b of degrees 0 … b − 1; a function on the sphere takes b² coefficients."
    ),
    "rmse": _Known(
        "RMSE",
        "Root of the mean squared distance between the surfaces, in percent of the original's bounding-box diagonal.",
        percent=True,
    ),
    "mae": _Known("MAE", "Mean distance between the surfaces, in percent of the diagonal.", percent=True),
    "max": _Known(
        "Maximum", "Largest distance found from either surface to the other, in percent of the diagonal.", percent=True
    ),
    "volume_error": _Known(
        "Volume error", "Difference of the enclosed volumes, in percent of the original's volume.", percent=True
    ),
    "diagonal": _Known("Diagonal", "Length of the original's bounding-box diagonal, in the units of the file."),
    "closed": _Known("Closed", "Whether the reconstruction has no boundary."),
    "genus": _Known("Genus", "Number of handles of the reconstruction: 0 for a ball, 1 for a ring."),
}


def figure_rows(figures: Mapping[str, Any]) -> list[Figure]:
    """Return the rows of a table. Figures the package knows get a name, a unit and a meaning; others stay as they are.

    Raises:
        TypeError: A key that is not text, or a value that is neither text, number, bool nor None.
    """
    rows = []
    for key, value in figures.items():
        if not isinstance(key, str):
            raise TypeError(f"figures must have names of type str, got {key!r}")
        known = _KNOWN.get(key, _Known(_heading(key), ""))
        rows.append(Figure(known.label, _text(value, key, percent=known.percent), known.meaning))
    return rows


def percent_text(value: float) -> str:
    """Return a fraction in percent, three digits."""
    return f"{100 * value:.3g}\u202f%"


def _heading(key: str) -> str:
    words = key.replace("_", " ")
    return words[:1].upper() + words[1:]


def _text(value: Any, key: str, *, percent: bool) -> str:
    if value is None:
        return "not defined"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)) and not percent:
        return str(value)
    if isinstance(value, (int, float, np.integer, np.floating)):
        return percent_text(float(value)) if percent else f"{float(value):.6g}"
    raise TypeError(f"figure {key!r} must be text, a number, a bool or None, got {type(value).__name__}")
