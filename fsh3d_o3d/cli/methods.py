"""The methods of ``fsh3d reconstruct``: their options, and how each makes a shape of a geometry."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d.cli.console import point_or_name, say
from fsh3d_o3d.closing import Parts, prepare_closed
from fsh3d_o3d.geometry import MeshArrays, PointArrays, largest_component, repair_mesh, weld
from fsh3d_o3d.radial import Behaviour
from fsh3d_o3d.shapes import ConformalShape, RadialShape, Shape, ShellShape
from fsh3d_o3d.sphere_map import ConformalMapOption, conformal_map


@dataclass(frozen=True, eq=False)
class Encoded:
    """A shape and figures about how it was found."""

    shape: Shape
    """The shape."""
    figures: dict[str, Any] = field(default_factory=dict)
    """Figures of the method by name."""
    options: dict[str, str | float] = field(default_factory=dict)
    """How it was done, for people."""


def add_method_options(parser: argparse.ArgumentParser) -> None:
    """--method and the options that go with some of them."""
    parser.add_argument(
        "--method",
        choices=["auto", *_METHODS],
        default="auto",
        help="auto: what leaves least error, tried, with repair or closing where needed (default); radial: distance "
        "from a center, for star-shaped surfaces; shells: a field on concentric spheres, for any topology; conformal: "
        "position over a map onto the sphere, for closed surfaces of genus 0",
    )
    parser.add_argument(
        "--bandwidth",
        type=int,
        metavar="B",
        help="degrees 0 … B-1, B² numbers a function (radial and conformal 64, shells 32; auto: shells half of it)",
    )
    parser.add_argument(
        "--center",
        type=point_or_name,
        metavar="X,Y,Z",
        help="radial, shells: center; for radial also 'centroid' or 'best' (default: what sees most)",
    )
    parser.add_argument(
        "--behaviour",
        choices=["error", "outermost", "innermost"],
        help="radial: where the surface is met several times in one direction (default: error)",
    )
    parser.add_argument("--shells", type=int, metavar="S", help="shells: how many (default: twice the bandwidth)")
    parser.add_argument(
        "--area-weight",
        type=float,
        metavar="A",
        help="conformal: how much the map keeps areas beside angles; 0: angles only (default: what reconstructs best)",
    )
    parser.add_argument(
        "--levels",
        type=_bandwidths,
        default=(),
        metavar="B,B,…",
        help="conformal: also write the levels of detail of these bandwidths, such as 4,8,16, as OUT.b4.ply, …",
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="first weld, clean, close and orient the mesh, for conformal also make it one piece of genus 0, and say "
        "what changed (auto repairs where that helps)",
    )
    parser.add_argument(
        "--parts",
        choices=["all", "largest"],
        help="auto, or with --repair: keep all pieces of the mesh (default), or the largest, such as a scan without "
        "the specks around it",
    )


def checked_bandwidth(options: argparse.Namespace) -> int:
    """Return the bandwidth, after refusing options that do not go with the method or with each other."""
    belongs = {
        "--center": (options.center is not None, ("radial", "shells")),
        "--behaviour": (options.behaviour is not None, ("radial",)),
        "--shells": (options.shells is not None, ("shells",)),
        "--area-weight": (options.area_weight is not None, ("conformal",)),
        "--levels": (bool(options.levels), ("conformal",)),
        "--repair": (options.repair, tuple(_METHODS)),
        "--resolution": (options.resolution is not None, tuple(_METHODS)),
    }
    for name, (given, methods) in belongs.items():
        if given and options.method not in methods:
            raise ValueError(f"{name} goes with --method {' or '.join(methods)}")
    if options.parts and not options.repair and options.method != "auto":
        raise ValueError("--parts goes with --method auto or with --repair")
    if options.method == "shells" and isinstance(options.center, str):
        raise ValueError(f"--center must be X,Y,Z with --method shells, got {options.center!r}")
    default = 32 if options.method == "shells" else 64
    b = check.bandwidth(default if options.bandwidth is None else options.bandwidth, "--bandwidth")
    if options.levels and max(options.levels) > b:
        raise ValueError(f"--levels must not exceed the bandwidth {b}, got {max(options.levels)}")
    return b


def encoded(geometry: MeshArrays | PointArrays, b: int, options: argparse.Namespace) -> Encoded:
    """Return the shape of a geometry."""
    return _METHODS[options.method](geometry, b, options)


def repaired(geometry: MeshArrays | PointArrays, options: argparse.Namespace) -> tuple[MeshArrays, dict[str, Any]]:
    """Return the mesh repaired as the method needs it and figures about that; say on standard error what changed."""
    if isinstance(geometry, PointArrays):
        raise ValueError("--repair takes a mesh, not a point cloud")
    parts: Parts = options.parts or "all"
    if options.method == "conformal":
        return _closed(geometry, parts)
    kept, others = largest_component(weld(geometry)) if parts == "largest" else (geometry, 0)
    if others:
        say(f"kept the largest of {others + 1} components", error=True)
    repair = repair_mesh(kept)
    before, after = repair.before, repair.after
    say(
        f"repaired: {len(geometry.triangles)} to {len(repair.mesh.triangles)} triangles, "
        f"{'closed' if before.closed else 'not closed'} to {'closed' if after.closed else 'not closed'}, "
        f"genus {before.genus} to {after.genus}, area changed by {100 * (after.area / before.area - 1):.3g} %",
        error=True,
    )
    return repair.mesh, {}


def _closed(mesh: MeshArrays, parts: Parts) -> tuple[MeshArrays, dict[str, Any]]:
    closing = prepare_closed(mesh, parts=parts)
    rms, farthest = max(closing.rms, closing.rms_back), max(closing.hausdorff, closing.hausdorff_back)
    if not closing.changed:
        say("repaired: there was nothing to change", error=True)
    else:
        why = f" ({', '.join(closing.problems)})" if closing.problems else ""
        say(
            f"{closing.method}{why}: {'; '.join(closing.changed)}; {100 * rms:.3g} % of the diagonal RMS from the "
            f"original, {100 * farthest:.3g} % at most",
            error=True,
        )
    return closing.mesh, {"repair": closing.method, "repair_rms": rms, "repair_max": farthest}


def _radial(geometry: MeshArrays | PointArrays, b: int, options: argparse.Namespace) -> Encoded:
    behaviour: Behaviour = options.behaviour or "error"
    shape = RadialShape.from_geometry(geometry, b, options.center, behaviour=behaviour, threads=options.threads)
    return Encoded(shape, options={"behaviour": behaviour})


def _shells(geometry: MeshArrays | PointArrays, b: int, options: argparse.Namespace) -> Encoded:
    shells = 2 * b if options.shells is None else options.shells
    shape = ShellShape.from_geometry(
        geometry, b, shells, "signed_distance", center=options.center, threads=options.threads
    )
    return Encoded(shape, options={"shells": len(shape.radii)})


def _conformal(geometry: MeshArrays | PointArrays, b: int, options: argparse.Namespace) -> Encoded:
    if isinstance(geometry, PointArrays):
        raise ValueError("--method conformal takes a mesh, not a point cloud")
    weight = options.area_weight
    option = ConformalMapOption() if weight is None else ConformalMapOption(area_weight=weight)
    surface = conformal_map(geometry, option)
    shape = ConformalShape.from_map(surface, b, threads=options.threads)
    figures = {
        "flipped": surface.flipped,
        "distortion_mean": surface.distortion_mean,
        "distortion_99": surface.distortion_99,
        "area_distortion": surface.area_distortion,
    }
    return Encoded(shape, figures, {"map": surface.method, "area weight": option.area_weight})


_METHODS: dict[str, Callable[[MeshArrays | PointArrays, int, argparse.Namespace], Encoded]] = {
    "radial": _radial,
    "shells": _shells,
    "conformal": _conformal,
}


def _bandwidths(text: str) -> tuple[int, ...]:
    """Bandwidths on the command line: B,B,… in rising order."""
    try:
        return tuple(sorted({check.bandwidth(int(part), "a level") for part in text.split(",")}))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of bandwidths: {error}") from None
