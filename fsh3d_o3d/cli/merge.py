"""``fsh3d merge``: many scans of one object or scene in one frame, as one cloud."""

from __future__ import annotations

import argparse
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d.cli.console import fields, point_or_name, print_json, say
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import WRITABLE_CLOUD_FORMATS, read_geometry_file, write_geometry
from fsh3d_o3d.registration import ScanRegistrationResult, register_scans

_OF_PAIR = ("source", "target", "transformation", "confidence", "overlap", "inlier_rmse", "used", "reason")
_OF_RESULT = ("poses", "groups", "unplaced", "loop_error")


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "merge",
        help="bring many scans, each in a frame of its own, into one frame and write them as one cloud",
        description="Bring scans of one object or scene, each in a frame of its own and all in the same units, into "
        "one frame, that of the first scan of the largest group that fits together, and write all their points as one "
        "cloud. Scans that do not fit are named and left out (exit code 1).",
    )
    parser.add_argument("scans", nargs="+", metavar="SCAN", help="mesh or point cloud")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="file for the merged cloud")
    parser.add_argument("--voxel", type=float, metavar="SIZE", help="average points in cubes of this edge")
    parser.add_argument(
        "--viewpoint",
        type=point_or_name,
        metavar="X,Y,Z",
        help="where the camera stood in the frame of each scan, often 0,0,0: rules out poses in which one scan stands "
        "before what the camera of another saw",
    )
    parser.add_argument("--picture", metavar="FILE.png", help="also write a picture: the scans, each in a colour")
    parser.add_argument("--json", action="store_true", help="print poses, pairs and figures as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command: 0 if all scans were placed, 1 if some could not be."""
    inputs = {f"scan {number}": path for number, path in enumerate(options.scans, start=1)}
    targets = checked_targets(
        {"the output": (options.output, WRITABLE_CLOUD_FORMATS), "--picture": (options.picture, (".png",))}, inputs
    )
    if isinstance(options.viewpoint, str):
        raise ValueError(f"--viewpoint must be three numbers X,Y,Z, got {options.viewpoint!r}")
    if options.voxel is not None:
        check.number(options.voxel, "--voxel", minimum=0, exclusive=True)
    files = [read_geometry_file(path) for path in options.scans]
    notes = [f"{path}: {note}" for path, file in zip(options.scans, files, strict=True) for note in file.notes]
    for note in notes:
        say(f"fsh3d: warning: {note}", error=True)
    result = _registered(options, [file.geometry for file in files])
    merged = result.merged(options.voxel, kind="legacy")
    picture = _picture(result) if options.picture else b""
    write_geometry(options.output, merged)
    if options.picture:
        atomic_write_bytes(options.picture, picture)
    for scan in result.unplaced:
        say(f"fsh3d: error: {options.scans[scan]}: could not be placed ({_why(result, scan)})", error=True)
    if options.json:
        figures = {"scans": options.scans, **fields(result, *_OF_RESULT), "points": len(merged.points)}
        print_json({**figures, "pairs": [fields(pair, *_OF_PAIR) for pair in result.pairs], "notes": notes})
    else:
        say(*_summary(options, result, len(merged.points)), *(f"  wrote {target}" for target in targets))
    return 1 if result.unplaced else 0


def _registered(options: argparse.Namespace, scans: list[Any]) -> ScanRegistrationResult:
    try:
        return register_scans(scans, viewpoints=options.viewpoint, progress=not options.quiet)
    except GeometryError as error:  # that names a scan by its number
        number, _, reason = str(error).removeprefix("scan ").partition(": ")
        if not number.isdigit():
            raise
        raise GeometryError(f"{options.scans[int(number)]}: {reason}") from None


def _why(result: ScanRegistrationResult, scan: int) -> str:
    """Why a scan was not placed: what became of the most believed of its pairs with scans that were."""
    placed = set(result.groups[0])
    ends = [(pair, {pair.source, pair.target}) for pair in result.pairs]
    pairs = [pair for pair, both in ends if scan in both and both & placed]
    if not pairs:
        return "nothing to compare it with"
    return max(pairs, key=lambda pair: pair.confidence).reason or "touches too little"


def _summary(options: argparse.Namespace, result: ScanRegistrationResult, points: int) -> list[str]:
    used = sum(pair.used for pair in result.pairs)
    before, after = result.loop_error
    lines = [
        f"{options.output}: {len(result.groups[0])} of {len(options.scans)} scans, {points:,} points",
        f"  {used} of {len(result.pairs)} pairs used, loop error {before:.3g}, optimised {after:.3g}",
    ]
    others = [group for group in result.groups[1:] if len(group) > 1]
    lines += [f"  a group of its own: {' '.join(options.scans[scan] for scan in group)}" for group in others]
    return lines


def _picture(result: ScanRegistrationResult) -> bytes:
    # Imported here: drawing takes time to load that other runs need not spend.
    from fsh3d_o3d.report import encode_png, scans_picture

    return encode_png(scans_picture(result.in_one_frame()))
