"""What the scripts share: arguments, where results go, how figures look."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from fsh3d_o3d.files import atomic_write_bytes

mpl.use("Agg")  # files only; before pyplot

import matplotlib.pyplot as plt

__all__ = ["parser", "plt", "run", "save_figure", "save_results", "table"]


def parser(description: str, name: str) -> argparse.ArgumentParser:
    """Return the arguments that all scripts take."""
    result = argparse.ArgumentParser(description=description.strip().splitlines()[0])
    result.add_argument("--output", type=Path, default=Path("output/paper") / name, help="folder for the results")
    result.add_argument("--full", action="store_true", help="the whole experiment instead of a quick one")
    result.add_argument("--seed", type=int, default=0, help="of everything that is drawn at random")
    return result


def run(main: Callable[[], None]) -> None:
    """Run a script and say how long it took; bad input is one line on standard error and exit code 2."""
    start = time.monotonic()
    try:
        main()
    except (ValueError, OSError) as error:
        print(f"{Path(sys.argv[0]).name}: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from None
    print(f"{time.monotonic() - start:.1f} s")


def save_results(folder: Path, name: str, results: Mapping[str, Any]) -> None:
    """Write figures as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_plain(results), indent=1, allow_nan=False)
    atomic_write_bytes(folder / f"{name}.json", f"{text}\n".encode())


def save_figure(folder: Path, name: str, figure: Any) -> None:
    """Write a figure as PNG and close it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.png"
    figure.savefig(path, dpi=130, bbox_inches="tight")
    plt.close(figure)
    print(f"wrote {path}")


def table(header: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    """Return rows as text; numbers in three digits."""
    shown = [header, *(tuple(_text(cell) for cell in row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    lines = []
    for row in shown:
        first = row[0].ljust(widths[0])
        lines.append("  ".join([first, *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]))
    return "\n".join(lines)


def _text(cell: Any) -> str:
    return f"{cell:.3g}" if isinstance(cell, (float, np.floating)) else str(cell)


def _plain(value: Any) -> Any:
    """As JSON has it: null where there is no figure."""
    if isinstance(value, Mapping):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
