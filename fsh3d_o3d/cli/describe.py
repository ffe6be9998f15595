"""``fsh3d describe``: the rotation-invariant features of one or many files in one ``.npz``."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import encodable
from fsh3d_o3d.cli.console import print_json, say
from fsh3d_o3d.cli.passed_over import passed_over
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.descriptors import SHDOption, shd_descriptor
from fsh3d_o3d.index import is_folder, scan_library
from fsh3d_o3d.jobs import FailedInput, map_files
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
    parser.add_argument("inputs", nargs="+", metavar="IN", help="mesh or point cloud, or a folder: all files below it")
    parser.add_argument("-o", "--output", required=True, metavar="FEATURES.npz", help="file to write")
    parser.add_argument(
        "--option",
        choices=list(SHD_OPTIONS),
        default="best",
        help="best: for retrieval (default); published: Kazhdan et al. 2003; energies: one number a degree and shell",
    )
    parser.add_argument("--bandwidth", type=int, metavar="B", help="degrees 0 … B-1 instead of the option's own")
    parser.add_argument("--shells", type=int, metavar="S", help="number of shells instead of the option's own")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one for each core)")
    parser.add_argument("--json", action="store_true", help="print what was written as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command: 0 if all files were described, 1 if some were, 2 if none."""
    option = _option(options)
    inputs = {f"input {number}": path for number, path in enumerate(options.inputs, start=1)}
    checked_targets({"the output": (options.output, (".npz",))}, inputs)
    files, failed, others = _files(options)
    found = map_files(
        functools.partial(shd_descriptor, option=option), files, workers=options.workers, progress=not options.quiet
    )
    paths, features = [], []
    for path, descriptor in zip(files, found, strict=True):
        if isinstance(descriptor, FailedInput):
            failed.append({"path": path, "reason": descriptor.reason})
        else:
            paths.append(path)
            features.append(descriptor)
    for failure in failed:
        say(f"fsh3d: error: {failure['path']}: {failure['reason']}", error=True)
    for line in others:
        say(f"fsh3d: passed over: {line}", error=True)
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
        say(f"{options.output}: {len(paths)} of {len(paths) + len(failed)} files, {rows} × {columns} numbers each")
    return 1 if failed else 0


def _option(options: argparse.Namespace) -> SHDOption:
    own = {name: getattr(options, name) for name in ("bandwidth", "shells") if getattr(options, name) is not None}
    if "bandwidth" in own:
        check.bandwidth(own["bandwidth"], "--bandwidth")
    return dataclasses.replace(SHD_OPTIONS[options.option](), **own)


def _files(options: argparse.Namespace) -> tuple[list[str], list[dict[str, str]], list[str]]:
    """Return the files to describe, folders that cannot be listed, and what was passed over in folders, a line each."""
    files: list[str] = []
    failed, others = [], []
    for path in options.inputs:
        if not is_folder(path):
            files.append(path)
            continue
        scan = scan_library(path)
        files += scan.files
        failed += [{"path": one.path, "reason": one.reason} for one in scan.not_listed]
        others += [f"{path}: {line}" for line in passed_over(scan)]
        if not scan.files and not scan.not_listed:
            failed.append({"path": path, "reason": "no meshes or point clouds in this folder"})
    return list(dict.fromkeys(files)), failed, others
