"""``fsh3d reconstruct``: a file in, the mesh of its spherical harmonic representation out."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.cli.console import Progress, add_output_options, print_json, say
from fsh3d_o3d.cli.methods import Encoded, add_method_options, checked_bandwidth, encoded, repaired
from fsh3d_o3d.cli.targets import checked_targets, level_path
from fsh3d_o3d.files import WRITABLE_MESH_FORMATS, read_geometry_arrays, write_geometry
from fsh3d_o3d.geometry import (
    MeshArrays,
    PointArrays,
    SurfaceError,
    measure_mesh,
    surface_error,
    vertex_distances,
)
from fsh3d_o3d.reconstruction import choose, redecoded
from fsh3d_o3d.shapes import ConformalShape, Shape
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
    add_method_options(parser)
    parser.add_argument("--smooth", type=float, metavar="T", help="smooth with the heat kernel exp(-T l(l+1))")
    parser.add_argument(
        "--resolution",
        type=int,
        metavar="N",
        help="radial, conformal: about how many vertices; shells: points a side of the grid",
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
    b = checked_bandwidth(options)
    if options.smooth is not None:
        heat_filter(b, options.smooth)  # refused before the work
    targets = checked_targets(
        {
            "output": (options.output, WRITABLE_MESH_FORMATS),
            **{f"level {b}": (level_path(options.output, b), WRITABLE_MESH_FORMATS) for b in options.levels},
            "--save": (options.save, (".npz",)),
            "--picture": (options.picture, (".png",)),
            "--report": (options.report, (".html", ".htm")),
        },
        {"the input": options.input},
    )
    with Progress(6, not options.quiet) as progress:
        progress.step("reading")
        original = read_geometry_arrays(options.input)
        source, changes = repaired(original, options) if options.repair else (original, {})
        progress.step("sampling, transforming")
        if options.method == "auto":
            done = _chosen(original, options, progress)
        else:
            done = _as_told(source, original, b, options, progress)
        shape, mesh = done.result.shape, done.mesh
        progress.step("writing")
        write_geometry(options.output, replace(mesh, normals=done.normals))
        if isinstance(shape, ConformalShape):
            for bandwidth, level in shape.level_of_detail(options.levels).items():
                write_geometry(level_path(options.output, bandwidth), level)
        if options.save:
            shape.save(options.save)
        progress.step("drawing")
        figures = {**_figures(shape, mesh, done.error), **done.result.figures, **changes}
        if options.picture or options.report:
            _draw(options, original, done, figures)
    if options.json:
        print_json({"method": done.method, "bandwidth": shape.bandwidth, **figures})
    else:
        say(*_summary(options, original, done, targets))
    return 0


@dataclass(frozen=True, eq=False)
class _Done:
    """A surface that came back, and how."""

    result: Encoded
    method: str
    mesh: MeshArrays
    normals: Float64Array
    error: SurfaceError
    seconds: float
    said: tuple[str, ...] = ()


def _as_told(
    source: MeshArrays | PointArrays,
    original: MeshArrays | PointArrays,
    b: int,
    options: argparse.Namespace,
    progress: Progress,
) -> _Done:
    """Carry out the method that was asked for."""
    started = time.perf_counter()
    result = encoded(source, b, options)
    shape = _smoothed(result.shape, options)
    progress.step("decoding")
    mesh, normals = shape.mesh_arrays(options.resolution)
    seconds = time.perf_counter() - started
    progress.step("measuring the error")
    error = surface_error(original, mesh)
    return _Done(Encoded(shape, result.figures, result.options), options.method, mesh, normals, error, seconds)


def _chosen(original: MeshArrays | PointArrays, options: argparse.Namespace, progress: Progress) -> _Done:
    """Try which method leaves least error."""
    found = choose(
        original,
        bandwidth=options.bandwidth,
        parts=options.parts or "all",
        threads=options.threads,
        told=lambda way: progress.rename(f"trying {way}"),
    )
    progress.step("decoding")
    if options.smooth is not None:
        found = redecoded(found, original, _smoothed(found.shape, options))
    progress.step("measuring the error")
    for text in found.warnings:
        say(f"fsh3d: warning: {text}", error=True)
    mesh, normals = found.surface()
    figures = {
        "way": found.way,
        "reason": found.reason,
        "notes": list(found.notes),
        "warnings": list(found.warnings),
        "unseen": 0.0 if found.unseen is None else float(found.unseen.mean()),
    }
    said = (f"  {found.way}: {found.reason}", *(f"  {note}" for note in found.notes))
    return _Done(Encoded(found.shape, figures), found.method, mesh, normals, found.error, found.seconds, said)


def _smoothed(shape: Shape, options: argparse.Namespace) -> Shape:
    return shape if options.smooth is None else shape.filtered(heat_filter(shape.bandwidth, options.smooth))


def _figures(shape: Shape, mesh: MeshArrays, error: SurfaceError) -> dict[str, Any]:
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
    done: _Done,
    targets: list[str],
) -> list[str]:
    error = done.error
    source = (
        f"{len(original.triangles)} triangles" if isinstance(original, MeshArrays) else f"{len(original.points)} points"
    )
    relative = error.relative()
    volume = "" if relative.volume_error is None else f", volume {100 * relative.volume_error:.3g} %"
    if isinstance(original, PointArrays):
        volume = " (all points to the surface, outliers included)"
    return [
        f"{options.input}: {source}, {done.method}, {done.result.shape.coefficients.size} coefficients in "
        f"{done.seconds:.2f} s",
        *done.said,
        f"  error in % of the diagonal {error.diagonal:.6g}: RMSE {100 * relative.rmse:.3g}, "
        f"MAE {100 * relative.mae:.3g}, maximum {100 * relative.maximum:.3g}{volume}",
        *(f"  wrote {target}" for target in targets),
    ]


def _draw(
    options: argparse.Namespace,
    original: MeshArrays | PointArrays,
    done: _Done,
    figures: dict[str, Any],
) -> None:
    # Imported here: plotting libraries take time that other runs need not spend.
    from fsh3d_o3d.report import encode_png, reconstruction_picture, write_reconstruction_page

    shape, mesh = done.result.shape, done.mesh
    shown = {name: figure for name, figure in figures.items() if not isinstance(figure, list)}
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
            energies=_energies(shape),
            figures={
                "method": done.method,
                "bandwidth": shape.bandwidth,
                **shown,
                "center": "({:.6g}, {:.6g}, {:.6g})".format(*shape.center),
            },
            options={
                **done.result.options,
                "smoothing": "none" if options.smooth is None else f"heat kernel, t = {options.smooth:g}",
            },
        )


def _energies(shape: Shape) -> Any:
    """Energy of each degree, over all functions; the position of a conformal shape is not its form."""
    energies = np.hypot.reduce(np.atleast_2d(degree_energies(shape.coefficients)), axis=0)
    if isinstance(shape, ConformalShape):
        energies[0] = 0
    return energies
