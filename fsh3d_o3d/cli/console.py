"""What the sub-commands share: messages in one line, progress, JSON."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Mapping
from typing import Any

from fsh3d_o3d._printable import printable
from fsh3d_o3d._progress import progress_bar


def say(*lines: str, error: bool = False) -> None:
    """Print lines, on standard error if they are about one; all that a command prints goes through here."""
    print(*map(printable, lines), sep="\n", file=sys.stderr if error else sys.stdout)


def error_line(error: object) -> str:
    """An error or warning in one line, with the file it is about."""
    if isinstance(error, MemoryError) and not str(error):
        return "out of memory"
    if isinstance(error, OSError) and error.strerror:
        name = os.fsdecode(error.filename) if isinstance(error.filename, (str, bytes, os.PathLike)) else error.filename
        return printable(f"{name}: {error.strerror}" if name else error.strerror)
    return printable(" ".join(str(error).split())) or type(error).__name__


def print_json(values: Mapping[str, Any]) -> None:
    """Print strict JSON: NaN and infinities become null, arrays lists."""
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    print(json.dumps(finite, ensure_ascii=True, allow_nan=False, default=lambda array: array.tolist()))


def fields(value: object, *names: str) -> dict[str, Any]:
    """Return some attributes of a value by their names, as JSON shows them."""
    return {name: getattr(value, name) for name in names}


class Progress:
    """A bar over the named steps of one job on standard error; silent when not wanted or not a terminal."""

    def __init__(self, steps: int, wanted: bool) -> None:
        form = "{desc:<24} {bar:20} {n_fmt}/{total_fmt} [{elapsed}]"
        self._bar = progress_bar(steps, wanted=wanted, bar_format=form)
        self._started = False

    def step(self, name: str) -> None:
        """The step before is done; this one begins."""
        if self._started:
            self._bar.update()
        self._started = True
        self._bar.set_description_str(printable(name))

    def rename(self, name: str) -> None:
        """The step that is going on is better called so."""
        self._bar.set_description_str(printable(name))

    def close(self) -> None:
        """The last step is done, or the job has failed."""
        self._bar.close()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """--json, --quiet and --threads."""
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--threads", type=int, metavar="N", help="threads to use (default: all this process may)")


def point_or_name(text: str) -> str | tuple[float, ...]:
    """A centre on the command line: X,Y,Z or a name."""
    if "," not in text:
        return text
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,Z") from None
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text!r} is not three finite numbers X,Y,Z")
    return values
