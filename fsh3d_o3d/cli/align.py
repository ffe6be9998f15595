"""``fsh3d align``: the source in the place, direction and size of the target."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.cli.console import Progress, fields, print_json, say
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.files import WRITABLE_CLOUD_FORMATS, WRITABLE_MESH_FORMATS, read_geometry_arrays, write_geometry
from fsh3d_o3d.geometry import MeshArrays, PointArrays, transformed
from fsh3d_o3d.registration import SphericalRegistrationOption, SphericalRegistrationResult, registration_spherical

_OF_CANDIDATES = ("transformation", "correlation", "fitness", "inlier_rmse")
_OF_RESULT = (
    *_OF_CANDIDATES,
    "scale",
    "reflected",
    "max_correspondence_distance",
    "overlap",
    "confidence",
    "ambiguity",
    "ambiguous_axis",
)
_TRUSTED = 0.2  # confidence, a choice: below it the answer is as likely as not another rotation; exit code 1
_WHOLE = 0.9  # share of either surface on the other; less is said to be a part


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "align",
        help="turn, move and scale a mesh or point cloud onto another, from any position",
        description="Turn, move and scale the source onto the target, wherever both lie, and write it there. Either "
        "may be a part of the other; the confidence tells how far to trust the answer, and the exit code is 1 "
        "where it is below 0.2.",
    )
    parser.add_argument("source", help="mesh or point cloud that moves")
    parser.add_argument("target", help="mesh or point cloud that stays")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="file for the aligned source")
    parser.add_argument(
        "--scale",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="also scale the source (default); --no-scale where both are in the same units",
    )
    parser.add_argument(
        "--polish",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="bring the surfaces closer by their closest points in the end (default)",
    )
    parser.add_argument("--reflections", action="store_true", help="also try the source mirrored")
    parser.add_argument("--transformation", metavar="T.txt", help="also write the 4 × 4 matrix from source to target")
    parser.add_argument("--picture", metavar="FILE.png", help="also write a picture: target, source before and after")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    option = SphericalRegistrationOption(
        with_scaling=options.scale, polish=options.polish, reflections=options.reflections
    )
    formats = tuple(dict.fromkeys(WRITABLE_MESH_FORMATS + WRITABLE_CLOUD_FORMATS))
    targets = checked_targets(
        {
            "output": (options.output, formats),
            "--transformation": (options.transformation, (".txt",)),
            "--picture": (options.picture, (".png",)),
        },
        {"the target": options.target, "the source": options.source},
    )
    with Progress(4, not options.quiet) as progress:
        progress.step("reading")
        source, target = read_geometry_arrays(options.source), read_geometry_arrays(options.target)
        _check_format(options.output, source)
        progress.step("aligning")
        result = registration_spherical(source, target, option)
        aligned = transformed(source, result.transformation)
        progress.step("drawing")
        picture = _picture(source, target, aligned) if options.picture else b""
        progress.step("writing")
        write_geometry(options.output, aligned)
        if options.transformation:
            atomic_write_bytes(options.transformation, _matrix_text(result.transformation))
        if options.picture:
            atomic_write_bytes(options.picture, picture)
    if options.json:
        candidates = [fields(one, *_OF_CANDIDATES) for one in result.candidates]
        print_json({**fields(result, *_OF_RESULT), "candidates": candidates})
    else:
        say(*_summary(options, result, targets))
    if result.confidence < _TRUSTED:
        say(
            f"fsh3d: the confidence is below {_TRUSTED:g}: the shapes may differ, or several poses fit alike; look at "
            "--picture and --json",
            error=True,
        )
        return 1
    return 0


def _check_format(output: str, source: MeshArrays | PointArrays) -> None:
    what, formats = ("mesh", WRITABLE_MESH_FORMATS)
    if isinstance(source, PointArrays):
        what, formats = ("point cloud", WRITABLE_CLOUD_FORMATS)
    if Path(output).suffix.lower() not in formats:
        raise ValueError(f"the source is a {what}: the output must end in {' or '.join(formats)}, got {output!r}")


def _summary(options: argparse.Namespace, result: SphericalRegistrationResult, targets: list[str]) -> list[str]:
    caveat = ""
    if result.ambiguity != "none":
        caveat = ": other poses fit about as well"
    elif result.confidence < _TRUSTED:
        caveat = ": the shapes differ, or share too little"
    elif min(result.overlap) < _WHOLE:
        on_target, on_source = (round(100 * share) for share in result.overlap)
        caveat = f": {on_target} % of the source lies on the target, {on_source} % of that on the source"
    mirrored = ", mirrored" if result.reflected else ""
    return [
        f"{options.source} onto {options.target}: confidence {result.confidence:.2f}{caveat}",
        f"  scale {result.scale:.6g}{mirrored}, {100 * result.fitness:.3g} % of the source within "
        f"{result.max_correspondence_distance:.3g} of the target, RMSE of those {result.inlier_rmse:.3g}",
        *(f"  wrote {target}" for target in targets),
    ]


def _matrix_text(transformation: Float64Array) -> bytes:
    """Four rows of four numbers, which read back to the last bit."""
    return "".join(" ".join(format(value, ".17g") for value in row) + "\n" for row in transformation).encode("ascii")


def _picture(
    source: MeshArrays | PointArrays, target: MeshArrays | PointArrays, aligned: MeshArrays | PointArrays
) -> bytes:
    # Imported here: drawing takes time to load that other runs need not spend.
    from fsh3d_o3d.report import alignment_picture, encode_png

    return encode_png(alignment_picture(source, target, aligned))
