"""Run the benchmarks: ``python -m benchmarks --output DIR [--only NAME ...] [--quick]``."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

from benchmarks import (
    descriptors,
    features,
    harmonics,
    index,
    learning,
    local_features,
    radial,
    registration,
    rotation,
    roundtrip,
    transform,
    weights,
)
from benchmarks._measure import environment
from benchmarks._table import Table, write_tables

BENCHMARKS = {
    "weights": weights.run,
    "roundtrip": roundtrip.run,
    "harmonics": harmonics.run,
    "transform": transform.run,
    "radial": radial.run,
    "features": features.run,
    "descriptors": descriptors.run,
    "local_features": local_features.run,
    "registration": registration.run,
    "index": index.run,
    "rotation": rotation.run,
    "learning": learning.run,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks asked for and print and write their tables; a missed target is a figure, not a failure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Accuracy and speed beside peers.")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for tables and pictures")
    parser.add_argument("--only", nargs="+", choices=tuple(BENCHMARKS), metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that everything runs")
    options = parser.parse_args(arguments)
    surroundings = environment()
    tables: list[Table] = []
    begin = time.perf_counter()
    # Weights cached by earlier runs of the package would make some of these look better than they are.
    with tempfile.TemporaryDirectory() as cache, mock.patch.dict(os.environ, {"FSH3D_CACHE_DIR": cache}):
        for name in options.only or BENCHMARKS:
            for table in BENCHMARKS[name](quick=options.quick):
                print(table.text(), end="\n\n", flush=True)
                tables.append(table)
    written = write_tables(options.output, tables, surroundings)
    print(f"{time.perf_counter() - begin:.0f} s; written: {', '.join(map(str, written))}")
    missed = [line for table in tables for line in table.missed]
    checks = [check for table in tables for row in table.rows for check in row.checks]
    print(f"{sum(check.met for check in checks)} of {len(checks)} targets reached")
    for line in missed:
        print(f"missed: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
