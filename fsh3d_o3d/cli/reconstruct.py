"""``fsh3d reconstruct``: a file in, the mesh of its spherical harmonic representation out."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d.adapters.geometry import MeshArrays, PointArrays, open3d_mesh
from fsh3d_o3d.adapters.mesh_measures import measure_mesh
from fsh3d_o3d.adapters.reading import read_geometry_arrays
from fsh3d_o3d.adapters.repair import repair_mesh
from fsh3d_o3d.adapters.surface_error import SurfaceError, surface_error, vertex_distances
from fsh3d_o3d.adapters.writing import WRITABLE_MESH_FORMATS, atomic_write_bytes, write_geometry
from fsh3d_o3d.cli._console import Progress, add_output_options, point_or_name, print_json
from fsh3d_o3d.shapes import RadialShape, ShellShape
from fsh3d_o3d.sphere import degree_energies, heat_filter


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "reconstruct",
        help="represent a mesh or point cloud by spherical harmonics and write the mesh that comes back",
        description="Represent a mesh or point cloud by spherical harmonics, write the mesh that comes back, and say "
        "how far it is from the original.",
    )
    parser.add_argument("input", help="mesh or point cloud")
    parser.add_argument("output", help=f"mesh to write: {' '.join(WRITABLE_MESH_FORMATS)}")
    parser.add_argument(
        "--method",
        choices=["radial", "shells"],
        default="radial",
        help="radial: distance from a center, for star-shaped surfaces (default); shells: a field on concentric "
        "spheres, for any topology",
    )
    parser.add_argument(
        "--bandwidth", type=int, metavar="B", help="degrees 0 … B-1, B² numbers a function (radial 64, shells 32)"
    )
    parser.add_argument("--shells", type=int, metavar="S", help="number of shells (default: twice the bandwidth)")
    parser.add_argument(
        "--center",
        type=point_or_name,
        metavar="X,Y,Z",
        help="center; for radial also 'centroid' or 'best' (default: what sees most)",
    )
    parser.add_argument(
        "--behaviour",
        choices=["error", "outermost", "innermost"],
        default="error",
        help="radial: where the surface is met several times in one direction (default: error)",
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="first weld, clean, close and orient the mesh (MeshLab), and say what changed",
    )
    parser.add_argument("--smooth", type=float, metavar="T", help="smooth with the heat kernel exp(-T l(l+1))")
    parser.add_argument(
        "--resolution", type=int, metavar="N", help="radial: about how many vertices; shells: cells a side"
    )
    parser.add_argument("--save", metavar="FILE.npz", help="also write the coefficients")
    parser.add_argument("--picture", metavar="FILE.png", help="also write a picture: original, reconstruction, error")
    parser.add_argument(
        "--report", metavar="FILE.html", help="also write a page with interactive 3D that works offline"
    )
    add_output_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    default = 64 if options.method == "radial" else 32
    b = check.bandwidth(default if options.bandwidth is None else options.bandwidth, "--bandwidth")
    targets = _checked_targets(options)
    with Progress(6, not options.quiet) as progress:
        progress.step("reading")
        original = read_geometry_arrays(options.input)
        source = _repaired(original) if options.repair else original
        progress.step("sampling, transforming")
        started = time.perf_counter()
        shape = _encoded(source, b, options)
        if options.smooth is not None:
            shape = shape.filtered(heat_filter(b, options.smooth))
        progress.step("decoding")
        mesh, normals = shape.mesh_arrays(options.resolution)
        seconds = time.perf_counter() - started
        progress.step("measuring the error")
        error = surface_error(original, mesh)
        progress.step("writing")
        write_geometry(options.output, open3d_mesh(mesh, normals=normals))
        if options.save:
            shape.save(options.save)
        progress.step("drawing")
        figures = _figures(shape, mesh, error)
        if options.picture or options.report:
            _draw(options, original, mesh, shape, figures)
    if options.json:
        print_json({"method": options.method, "bandwidth": b, **figures})
    else:
        print(_summary(options, original, shape, error, seconds, targets))
    return 0


def _checked_targets(options: argparse.Namespace) -> list[str]:
    """What will be written; refused before any work if two are the same file or one cannot be written."""
    targets = {
        "output": (options.output, WRITABLE_MESH_FORMATS),
        "--save": (options.save, (".npz",)),
        "--picture": (options.picture, (".png",)),
        "--report": (options.report, (".html", ".htm")),
    }
    seen: dict[str, str] = {os.path.realpath(options.input): "the input"}
    for name, (target, suffixes) in targets.items():
        if not target:
            continue
        path = Path(target)
        if path.suffix.lower() not in suffixes:
            raise ValueError(f"{name} must end in {' or '.join(suffixes)}, got {target!r}")
        if not path.parent.is_dir():
            raise ValueError(f"{name}: there is no folder {str(path.parent)!r}")
        if path.is_dir():
            raise ValueError(f"{name}: {target!r} is a folder")
        real = os.path.realpath(target)
        if real in seen:
            raise ValueError(f"{name} and {seen[real]} are the same file {target!r}")
        seen[real] = name
    return [target for target, _ in targets.values() if target]


def _repaired(geometry: MeshArrays | PointArrays) -> MeshArrays:
    if isinstance(geometry, PointArrays):
        raise ValueError("--repair takes a mesh, not a point cloud")
    repair = repair_mesh(geometry)
    before, after = repair.before, repair.after
    print(
        f"repaired: {len(geometry.triangles)} to {len(repair.mesh.triangles)} triangles, "
        f"{'closed' if before.closed else 'not closed'} to {'closed' if after.closed else 'not closed'}, "
        f"genus {before.genus} to {after.genus}, area changed by {100 * (after.area / before.area - 1):.3g} %",
        file=sys.stderr,
    )
    return repair.mesh


def _encoded(original: MeshArrays | PointArrays, b: int, options: argparse.Namespace) -> RadialShape | ShellShape:
    if options.method == "radial":
        if options.shells is not None:
            raise ValueError("--shells goes with --method shells")
        return RadialShape.from_geometry(
            original, b, options.center, behaviour=options.behaviour, threads=options.threads
        )
    if isinstance(options.center, str):
        raise ValueError(f"--center must be X,Y,Z with --method shells, got {options.center!r}")
    return ShellShape.from_geometry(
        original,
        b,
        2 * b if options.shells is None else options.shells,
        "signed_distance",
        center=options.center,
        threads=options.threads,
    )


def _figures(shape: RadialShape | ShellShape, mesh: MeshArrays, error: SurfaceError) -> dict[str, Any]:
    relative, measures = error.relative(), measure_mesh(mesh)
    return {
        "rmse": relative.rmse,
        "mae": relative.mae,
        "max": relative.maximum,
        "volume_error": relative.volume_error,
        "diagonal": error.diagonal,
        "closed": measures.closed,
        "genus": measures.genus,
        "coefficients": shape.coefficients.size,
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "center": shape.center.tolist(),
    }


def _summary(
    options: argparse.Namespace,
    original: MeshArrays | PointArrays,
    shape: RadialShape | ShellShape,
    error: SurfaceError,
    seconds: float,
    targets: list[str],
) -> str:
    source = (
        f"{len(original.triangles)} triangles" if isinstance(original, MeshArrays) else f"{len(original.points)} points"
    )
    relative = error.relative()
    volume = "" if relative.volume_error is None else f", volume {100 * relative.volume_error:.3g} %"
    if isinstance(original, PointArrays):
        volume = " (all points to the surface, outliers included)"
    return "\n".join(
        [
            f"{options.input}: {source}, {options.method}, {shape.coefficients.size} coefficients in {seconds:.2f} s",
            f"  error in % of the diagonal {error.diagonal:.6g}: RMSE {100 * relative.rmse:.3g}, "
            f"MAE {100 * relative.mae:.3g}, maximum {100 * relative.maximum:.3g}{volume}",
            *(f"  wrote {target}" for target in targets),
        ]
    )


def _draw(
    options: argparse.Namespace,
    original: MeshArrays | PointArrays,
    mesh: MeshArrays,
    shape: RadialShape | ShellShape,
    figures: dict[str, Any],
) -> None:
    # Imported here: plotting libraries take time that other runs need not spend.
    from fsh3d_o3d.report.page import reconstruction_picture, write_reconstruction_page
    from fsh3d_o3d.report.thumbnail import encode_png

    distances = vertex_distances(mesh, original)
    if options.picture:
        atomic_write_bytes(options.picture, encode_png(reconstruction_picture(original, mesh, distances)))
    if options.report:
        write_reconstruction_page(
            options.report,
            title=Path(options.input).name,
            original=original,
            reconstruction=mesh,
            errors=distances,
            energies=np.sqrt((np.atleast_2d(degree_energies(shape.coefficients)) ** 2).sum(axis=0)),
            figures={
                "method": options.method,
                "bandwidth": shape.bandwidth,
                **figures,
                "center": "({:.6g}, {:.6g}, {:.6g})".format(*shape.center),
            },
            options={
                "behaviour": options.behaviour,
                "smoothing": "none" if options.smooth is None else f"heat kernel, t = {options.smooth:g}",
            },
        )
