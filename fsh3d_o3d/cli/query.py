"""``fsh3d query``: the models of an index that are most like a file."""

from __future__ import annotations

import argparse
import base64
import dataclasses
import os
from collections.abc import Sequence
from typing import Any

from fsh3d_o3d.cli.console import error_line, fields, print_json, say
from fsh3d_o3d.cli.passed_over import in_brackets
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.index import Hit, LibraryScan, ShapeIndex, is_folder, scan_library

_Found = list[tuple[str, MeshArrays | PointArrays, tuple[Hit, ...]]]


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "query",
        help="find the models of an index that are most like a file",
        description="Find the models of an index that are most like a mesh or a point cloud, whatever their pose, size "
        "and triangulation, or the models that are almost the same as others of the index.",
    )
    parser.add_argument("index", metavar="INDEX", help="made by fsh3d index")
    parser.add_argument("input", metavar="FILE_OR_FOLDER", nargs="?", help="what to look for; a folder: all its files")
    parser.add_argument("--top", type=int, default=10, metavar="K", help="how many to show (10)")
    parser.add_argument(
        "--rerank",
        type=int,
        default=100,
        metavar="K",
        help="align this many candidates and rank them anew (100; 0: none)",
    )
    parser.add_argument(
        "--near-duplicates", action="store_true", help="compare the models of the index with each other"
    )
    parser.add_argument(
        "--limit", type=float, default=0.05, metavar="D", help="distance of near duplicates at most (0.05)"
    )
    parser.add_argument("--report", metavar="PAGE.html", help="write a page with pictures and 3D")
    parser.add_argument("--json", action="store_true", help="print one JSON object a query")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Search and print: 0 if all was answered, 1 if some files of a folder could not be read."""
    if options.near_duplicates == (options.input is not None):
        raise ValueError("give either a file or folder to look for, or --near-duplicates")
    _check_report(options)
    index = ShapeIndex.open(options.index)
    if options.near_duplicates:
        return _near_duplicates(index, options)
    single = not is_folder(options.input)
    scan = LibraryScan([options.input]) if single else _scan(options)
    found: _Found = []
    failed = len(scan.not_listed)
    for path in scan.files:
        try:
            geometry = read_geometry_arrays(path)
            hits = index.query(geometry, top=options.top, rerank=options.rerank)
        except (ValueError, OSError, MemoryError) as error:
            if single:
                raise
            failed += 1
            say(f"fsh3d: failed: {path}: {error_line(error)}", error=True)
            continue
        _print(path, hits, options)
        if options.report:
            found.append((path, geometry, hits))
    if options.report and found:
        _write_report(options.report, found)
    return 0 if not failed else 1 if failed < len(scan.files) + len(scan.not_listed) else 2


def _scan(options: argparse.Namespace) -> LibraryScan:
    scan = scan_library(options.input, leave_out=options.index)
    for folder in scan.not_listed:
        say(f"fsh3d: failed: {folder.path}: {folder.reason}", error=True)
    if not scan.files:
        raise ValueError(f"{options.input}: no meshes or point clouds in this folder{in_brackets(scan)}")
    return scan


def _print(path: str, hits: Sequence[Hit], options: argparse.Namespace) -> None:
    if options.json:
        print_json({"query": path, "hits": [_as_json(hit) for hit in hits]})
        return
    say(f"{path}:")
    for hit in hits:
        say(f"{hit.rank:>5}  {hit.distance:.4f}  {hit.path}")


def _as_json(hit: Hit) -> dict[str, Any]:
    """All that a hit holds, the thumbnail, a PNG, in base 64."""
    values = fields(hit, *(field.name for field in dataclasses.fields(hit)))
    return {**values, "thumbnail": base64.b64encode(hit.thumbnail).decode("ascii")}


def _near_duplicates(index: ShapeIndex, options: argparse.Namespace) -> int:
    pairs = index.near_duplicates(options.limit)
    if options.json:
        found = [fields(pair, "first", "second", "distance", "mirrored") for pair in pairs]
        print_json({"models": len(index), "limit": options.limit, "pairs": found})
        return 0
    for pair in pairs:
        say(f"{pair.distance:.4f}  {pair.first}  {pair.second}{'  mirrored' if pair.mirrored else ''}")
    count = sum(pair.mirrored for pair in pairs)
    only = f", {count} of them mirror images" if count else ""
    say(f"{len(pairs)} pairs within {options.limit:g} among {len(index)} models{only}", error=True)
    return 0


def _check_report(options: argparse.Namespace) -> None:
    """Refuse before the work a page that cannot be written."""
    if not options.report:
        return
    if options.near_duplicates:
        raise ValueError("--report shows the results of a query, not --near-duplicates")
    checked_targets({"--report": (options.report, (".html", ".htm"))}, {"the query": options.input})


def _write_report(target: str, found: _Found) -> None:
    from fsh3d_o3d.report import SearchResult, write_search_page  # Pillow, not needed otherwise

    results = [SearchResult(os.path.basename(path), geometry, hits) for path, geometry, hits in found]  # noqa: PTH119
    write_search_page(target, results)
