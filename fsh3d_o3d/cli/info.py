"""``fsh3d info``: what a file holds, and which method fits it."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any

from fsh3d_o3d.cli.console import Progress, add_output_options, print_json, say
from fsh3d_o3d.cli.describe import SHD_OPTIONS
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import read_geometry_file
from fsh3d_o3d.geometry import MeshArrays, PointArrays, measure_mesh, weld
from fsh3d_o3d.index import ShapeIndex, is_folder
from fsh3d_o3d.radial import cloud_center, fit_radial_cloud, star_center
from fsh3d_o3d.reconstruction import choose
from fsh3d_o3d.sphere_map import mapping_obstacles

_COARSE_BANDWIDTH = 8  # of a fit that only tells how many points lie on one radius; quick, a choice


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "info",
        help="say what a file holds and which method fits it",
        description="Say what a file holds: size, topology, how star-shaped it is, and which method fits it and why; "
        "or how many models an index holds, and of which libraries.",
    )
    parser.add_argument("file", help="mesh, point cloud, or index of a library")
    parser.add_argument("--export", metavar="OUT", help="write the features of an index to .npz or .parquet")
    add_output_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the description."""
    if is_folder(options.file):
        return _run_index(options)
    if options.export:
        raise ValueError(f"--export writes the features of an index, and {options.file} is none")
    with Progress(2, not options.quiet) as progress:
        progress.step("reading")
        found = read_geometry_file(options.file)
        progress.step("measuring")
        facts = describe(found.geometry)
    if options.json:
        print_json({"file": os.fspath(options.file), **facts, "notes": list(found.notes)})
    else:
        _print_facts(options.file, facts, [("note", note) for note in found.notes])
    return 0


def _run_index(options: argparse.Namespace) -> int:
    if options.export:
        checked_targets({"--export": (options.export, (".npz", ".parquet"))}, {"the index": options.file})
    index = ShapeIndex.open(options.file)
    about = dataclasses.asdict(index.summary())
    names = {make().fingerprint: name for name, make in SHD_OPTIONS.items()}
    facts = {"kind": "index", "option": names[index.option.fingerprint], **about}
    if options.export:
        facts["exported"] = index.export_features(options.export)
    if options.json:
        print_json({"index": options.file, **facts})
        return 0
    libraries = facts.pop("libraries")
    searchable, models = facts.pop("searchable"), facts["models"]
    facts["search"] = f"{searchable} of {models} models in an inverted file" if searchable else "compares every model"
    facts["size"] = f"{facts.pop('bytes_on_disk') / 10**6:.1f} MB"
    _print_facts(options.file, facts, [("library", f"{folder}: {count} models") for folder, count in libraries.items()])
    return 0


def _print_facts(title: str, facts: Mapping[str, Any], more: Sequence[tuple[str, str]]) -> None:
    """In two columns; of ``more`` several may have the same name."""
    width = max(map(len, facts))
    rows = [(name.replace("_", " "), _shown(value)) for name, value in (*facts.items(), *more)]
    say(title, *(f"  {name:<{width}}  {text}" for name, text in rows))


def describe(geometry: MeshArrays | PointArrays) -> dict[str, Any]:
    """What is known of a geometry, by name; the last two are the method that fits and why."""
    if isinstance(geometry, PointArrays):
        return _describe_cloud(geometry)
    return _describe_mesh(geometry)


def _describe_cloud(cloud: PointArrays) -> dict[str, Any]:
    if cloud.diagonal == 0:
        raise GeometryError(f"all {len(cloud.points)} points are the same")
    facts: dict[str, Any] = {
        "kind": "point cloud",
        "points": len(cloud.points),
        "normals": cloud.normals is not None,
        "colors": cloud.colors is not None,
        "diagonal": cloud.diagonal,
    }
    with contextlib.suppress(GeometryError):  # not all around, or too few for it: the recommendation says so
        fit = fit_radial_cloud(cloud, _COARSE_BANDWIDTH, cloud_center(cloud))
        facts |= {
            "center": fit.center.tolist(),
            "largest_hole_degrees": fit.empty_cap,
            "inliers": fit.inliers,
            "spread": fit.scale,
        }
    return facts | _recommended(cloud)


def _describe_mesh(mesh: MeshArrays) -> dict[str, Any]:
    welded = weld(mesh)
    measures = measure_mesh(welded)
    facts: dict[str, Any] = {
        "kind": "triangle mesh",
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "duplicate_vertices": len(mesh.vertices) - len(welded.vertices),
        "diagonal": measures.diagonal,
        "area": measures.area,
        "volume": measures.volume,
        "closed": measures.closed,
        "manifold": measures.edge_manifold and measures.vertex_manifold,
        "oriented": measures.consistently_oriented,
        "components": measures.components,
        "euler_number": measures.euler_number,
        "genus": measures.genus,
    }
    if measures.area == 0:
        raise GeometryError("the mesh has no area: all its triangles are degenerate")
    star = star_center(welded, "best")
    return {
        **facts,
        "center": star.center.tolist(),
        "star_shaped": star.exact,
        "visible_area": star.visible_area,
        "directions_missed": star.missed,
        "directions_multiple": star.multiple,
        "maps_to_the_sphere": not mapping_obstacles(mesh),
        **_recommended(mesh),
    }


def _recommended(geometry: MeshArrays | PointArrays) -> dict[str, Any]:
    """The method that ``fsh3d reconstruct`` takes, found as it does, and why; none where no surface comes back."""
    try:
        found = choose(geometry)
    except GeometryError as error:
        return {"method": None, "reason": str(error)}
    relative = found.error.relative()
    remarks = {"remarks": [*found.notes, *found.warnings]} if found.notes or found.warnings else {}
    return {"rmse": relative.rmse, "max": relative.maximum, **remarks, "method": found.method, "reason": found.reason}


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and value and isinstance(value[0], str):
        return "; ".join(value)
    if isinstance(value, list):
        return "(" + ", ".join(f"{v:.6g}" for v in value) + ")"
    return str(value)
