"""``fsh3d index``: a folder of meshes and point clouds into an index that ``fsh3d query`` searches."""

from __future__ import annotations

import argparse
import time
from typing import Any

from fsh3d_o3d.cli.console import fields, print_json, say
from fsh3d_o3d.cli.describe import SHD_OPTIONS
from fsh3d_o3d.cli.passed_over import in_brackets, other_formats, passed_over
from fsh3d_o3d.index import ShapeIndex, real_folder, scan_library
from fsh3d_o3d.jobs import FailedInput


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "index",
        help="index a folder of meshes and point clouds for searching",
        description="Describe all meshes and point clouds below a folder and keep what is needed to find them again. "
        "May be stopped at any moment and run again: what is indexed already and has not changed is skipped.",
    )
    parser.add_argument("library", metavar="LIBRARY", help="folder of files; links in it are not followed")
    parser.add_argument("index", metavar="INDEX", help="folder of the index; made where there is none")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: all this process may use)")
    parser.add_argument("--engine", choices=("local", "ray"), default="local", help="where files are described (local)")
    parser.add_argument("--address", metavar="A", help="Ray cluster (default: one started on this machine)")
    parser.add_argument("--timeout", type=float, default=300.0, metavar="S", help="seconds a file may take (300)")
    parser.add_argument("--prune", action="store_true", help="remove models whose files are gone from LIBRARY")
    parser.add_argument("--moved-from", metavar="OLD", help="where LIBRARY was before, if its content does not tell")
    parser.add_argument("--remove", action="store_true", help="forget LIBRARY (also a file) instead, there or not")
    parser.add_argument("--retry-failed", action="store_true", help="try again what failed before")
    parser.add_argument("--option", choices=tuple(SHD_OPTIONS), help="descriptor of a new index (default: best)")
    parser.add_argument("--no-thumbnails", action="store_true", help="draw no pictures")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Index what is new: 0 if nothing failed, 1 if something did."""
    start = time.perf_counter()
    if options.remove:
        return _remove(options)
    scan = scan_library(real_folder(options.library), leave_out=options.index)
    for folder in scan.not_listed:
        _print_failed(folder)
    if not scan.files:
        raise ValueError(f"{options.library}: no meshes or point clouds in this folder{in_brackets(scan)}")
    option = None if options.option is None else SHD_OPTIONS[options.option]()
    index = ShapeIndex.open(options.index, create=True, option=option)
    update = index.add_files(
        scan.files,
        options.workers,
        timeout=options.timeout,
        retry_failed=options.retry_failed,
        thumbnail=None if options.no_thumbnails else _thumbnail(),
        progress=not options.quiet,
        engine=options.engine,
        address=options.address,
        library=options.library,
        moved_from=options.moved_from,
    )
    kept: list[FailedInput] = []
    removed = update.gone + (index.prune(options.library, on_kept=kept.append) if options.prune else 0)
    known = {folder.path for folder in scan.not_listed}
    failed = [*update.failed, *(folder for folder in kept if folder.path not in known)]
    for one in failed:
        _print_failed(one)
    failed = [*scan.not_listed, *failed]
    seconds = time.perf_counter() - start
    figures = {"models": len(index), **fields(update, "added", "moved", "unchanged"), "removed": removed}
    if options.json:
        failures = [fields(one, "path", "reason") for one in failed]
        moves = [fields(move, "old", "new") for move in update.libraries]
        passed = {"other_formats": other_formats(scan), "links": scan.links, "seconds": seconds}
        print_json({"index": options.index, **figures, "failed": failures, "libraries_moved": moves, **passed})
    else:
        rest = ", ".join(f"{count} {name}" for name, count in list(figures.items())[1:])
        say(f"{options.index}: {figures['models']} models ({rest}, {len(failed)} failed), {seconds:.1f} s")
        for move in update.libraries:
            say(f"{move.old} is now {move.new}: its models moved along")
        for line in passed_over(scan):
            say(line)
    return 1 if failed else 0


def _remove(options: argparse.Namespace) -> int:
    start = time.perf_counter()
    if options.prune or options.moved_from:
        raise ValueError("--remove forgets all of LIBRARY: give neither --prune nor --moved-from with it")
    index = ShapeIndex.open(options.index)
    removed = index.remove([options.library])
    if not removed:
        raise ValueError(f"{options.library}: the index {options.index} holds no models of it")
    models, seconds = len(index), time.perf_counter() - start
    if options.json:
        print_json({"index": options.index, "models": models, "removed": removed, "seconds": seconds})
    else:
        say(f"{options.index}: {models} models ({removed} removed), {seconds:.1f} s")
    return 0


def _print_failed(one: FailedInput) -> None:
    say(f"fsh3d: failed: {one.path}: {one.reason}", error=True)


def _thumbnail() -> Any:
    from fsh3d_o3d.report import library_thumbnail  # Pillow is not needed otherwise

    return library_thumbnail
