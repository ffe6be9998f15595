"""``fsh3d describe``: the rotation-invariant features of one or many files in one ``.npz``."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import encodable, printable
from fsh3d_o3d.cli.console import Progress, error_line, print_json, say
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.descriptors import SHDOption, shd_descriptor
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.shapes import write_arrays

SHD_OPTIONS: dict[str, Callable[[], SHDOption]] = {
    "best": SHDOption.best,
    "published": SHDOption.published,
    "energies": SHDOption,
}
"""What --option may name."""


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "describe",
        help="write rotation-invariant features of meshes and point clouds",
        description="Write the spherical harmonic descriptors of meshes and point clouds: numbers that do not change "
        "when a shape is moved, rotated, mirrored or scaled. A file that cannot be described is reported and left out.",
    )
    parser.add_argument("inputs", nargs="+", metavar="IN", help="mesh or point cloud")
    parser.add_argument("-o", "--output", required=True, metavar="FEATURES.npz", help="file to write")
    parser.add_argument(
        "--option",
        choices=list(SHD_OPTIONS),
        default="best",
        help="best: for retrieval (default); published: Kazhdan et al. 2003; energies: one number a degree and shell",
    )
    parser.add_argument("--bandwidth", type=int, metavar="B", help="degrees 0 … B-1 instead of the option's own")
    parser.add_argument("--shells", type=int, metavar="S", help="number of shells instead of the option's own")
    parser.add_argument("--json", action="store_true", help="print what was written as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command: 0 if all files were described, 1 if some were, 2 if none."""
    option = _option(options)
    inputs = {f"input {number}": path for number, path in enumerate(options.inputs, start=1)}
    checked_targets({"the output": (options.output, (".npz",))}, inputs)
    paths, features, failed = [], [], []
    with Progress(len(options.inputs), not options.quiet) as progress:
        for path in options.inputs:
            progress.step(Path(path).name[:24])
            try:
                features.append(shd_descriptor(read_geometry_arrays(path), option))
                paths.append(os.fspath(path))
            except (ValueError, OSError, MemoryError) as error:
                failed.append({"path": os.fspath(path), "reason": error_line(error)})
    for failure in failed:
        say(f"fsh3d: error: {_named(**failure)}", error=True)
    if not features:
        return 2
    arrays = {
        "paths": np.array([encodable(path) for path in paths]),
        "features": np.stack(features),
        "shape": np.array(option.feature_shape),
        "option": np.array(options.option),
        "metric": np.array(option.metric),
        "fingerprint": np.array(option.fingerprint),
    }
    write_arrays(options.output, "features", arrays)
    rows, columns = option.feature_shape
    if options.json:
        summary = {"output": options.output, "option": options.option, "fingerprint": option.fingerprint}
        print_json({**summary, "described": len(paths), "shape": [rows, columns], "failed": failed})
    else:
        say(f"{options.output}: {len(paths)} of {len(options.inputs)} files, {rows} × {columns} numbers each")
    return 1 if failed else 0


def _option(options: argparse.Namespace) -> SHDOption:
    own = {name: getattr(options, name) for name in ("bandwidth", "shells") if getattr(options, name) is not None}
    if "bandwidth" in own:
        check.bandwidth(own["bandwidth"], "--bandwidth")
    return dataclasses.replace(SHD_OPTIONS[options.option](), **own)


def _named(path: str, reason: str) -> str:
    """The reason in one line that names the file, once."""
    return reason if printable(path) in reason else f"{path}: {reason}"
