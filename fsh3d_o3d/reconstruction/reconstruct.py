"""The choice: ways are tried, best first, until one leaves little error; else the one that leaves least is taken."""

from __future__ import annotations

import time
import warnings as python_warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d.closing import Parts
from fsh3d_o3d.errors import GeometryError, ReconstructionWarning
from fsh3d_o3d.geometry import (
    MeshArrays,
    PointArrays,
    geometry_arrays,
    largest_component,
    measure_mesh,
    surface_error,
    weld,
)
from fsh3d_o3d.reconstruction.attempts import SAMPLES, Attempt, Way, attempted
from fsh3d_o3d.reconstruction.cloud_ways import cloud_ways
from fsh3d_o3d.reconstruction.coverage import unseen_vertices
from fsh3d_o3d.reconstruction.mesh_ways import mesh_ways, star_of
from fsh3d_o3d.reconstruction.reconstruction import Reconstruction, Trial
from fsh3d_o3d.reconstruction.sizes import Sizes
from fsh3d_o3d.shapes import Shape
from fsh3d_o3d.sphere_map import mapping_obstacles

__all__ = ["TOLERANCE", "choose", "reconstruct", "redecoded"]

TOLERANCE = 0.01
"""RMSE, relative to the diagonal, above which a reconstruction is warned of; a choice."""
Told = Callable[[str], object]
"""Told the name of each way before it is tried."""

_GOOD_TOPOLOGY = 5.0  # times the least error, a choice: what keeps parts and handles may leave so much more


@dataclass(frozen=True, eq=False)
class Plan:
    """What is known before anything is tried."""

    ways: tuple[Way, ...]
    """Best first."""
    reason: str
    """What speaks for the first."""
    topology: tuple[int, int] | None
    """Parts and Euler number of the original, where it has a closed surface."""
    opened: str = ""
    """What the original has instead of a closed surface; empty for closed ones and for clouds."""


def reconstruct(
    geometry: Any, *, bandwidth: int | None = None, parts: Parts = "all", threads: int | None = None
) -> Reconstruction:
    """Represent any geometry by spherical harmonics, by the method that leaves least error, and decode it.

    What a mesh measures says which methods suit it: radial where a centre sees all of it, conformal where it is closed
    and of genus 0, shells where it bounds a solid of any topology, and where it is open or not manifold it is repaired
    or closed first. Whether they do is tried: a method is taken at once if it leaves little error, otherwise those that
    remain are tried as well, and of those within 1 % of the diagonal one that keeps parts and handles is preferred.

    Clouds are fitted as seen from inside where points lie all around, as seen from behind or from the front where a
    scan saw one side, and by shells about a Poisson surface otherwise; without normals these are estimated. Where a
    quarter of the surface or more has no points near it, the surface is open there.

    Args:
        geometry: Open3D triangle mesh or point cloud, legacy or tensor, or ``MeshArrays``, ``PointArrays``.
        bandwidth: b of radial and conformal shapes, 64 if not given; shells take half of it on as many shells.
        parts: ``"all"``, or ``"largest"`` for the component of the most area, such as a scan without specks; the error
            is then measured from that.
        threads: Number of threads, or None for all that the process may use. Does not change the result.

    Returns:
        The shape, which method and why, how far it is off, and the surface that comes back.

    Raises:
        GeometryError: Empty, not finite, without extent or area: there is no surface.
        TypeError, ValueError: An argument is of the wrong type or out of range.

    Warns:
        ReconstructionWarning: The error is more than 1 % of the diagonal, or parts or handles are not as many as they
            were; says what would help. The same as ``Reconstruction.warnings``.

    Example:
        >>> horn = fsh.read_geometry("samples/horn.off")  # closed, and no point sees the whole surface
        >>> result = fsh.reconstruct(horn, bandwidth=16)
        >>> result.way, result.error.relative().rmse < 0.01
        ('conformal', True)
    """
    result = choose(geometry, bandwidth=bandwidth, parts=parts, threads=threads)
    for text in result.warnings:
        python_warnings.warn(text, ReconstructionWarning, stacklevel=2)
    return result


def choose(
    geometry: Any,
    *,
    bandwidth: int | None = None,
    parts: Parts = "all",
    threads: int | None = None,
    told: Told | None = None,
) -> Reconstruction:
    """Return what ``reconstruct`` does, without warning of anything; ``told`` hears which way is being tried."""
    started = time.perf_counter()
    sizes = Sizes.of(bandwidth)
    check.choice(parts, "parts", ("all", "largest"))
    if threads is not None:
        check.integer(threads, "threads", minimum=1, maximum=1024)
    arrays, kind = geometry_arrays(geometry)
    notes: tuple[str, ...] = ()
    if isinstance(arrays, PointArrays):
        plan = Plan(*cloud_ways(arrays, sizes, threads), None)
    else:
        arrays, notes = _wanted(arrays, parts)
        plan = _mesh_plan(arrays, sizes, threads)
    attempts, trials = _tried(plan, arrays, told)
    best = _best(attempts, plan.topology)
    shape: Any = best.made.shape
    return Reconstruction(
        shape=replace(shape, kind=kind),
        method=best.made.method,
        way=best.made.way,
        reason=_reason(plan, best, trials),
        error=best.error,
        notes=notes + best.made.notes,
        warnings=tuple(_warnings(plan, best, sizes)),
        mesh=best.mesh,
        normals=best.normals,
        unseen=best.unseen,
        trials=tuple(trials),
        seconds=time.perf_counter() - started,
        kind=kind,
    )


def redecoded(result: Reconstruction, original: MeshArrays | PointArrays, shape: Shape) -> Reconstruction:
    """Return a reconstruction with another shape, such as a smoothed one, decoded and measured anew."""
    mesh, normals = shape.mesh_arrays()
    unseen = unseen_vertices(original, mesh) if isinstance(original, PointArrays) else None
    error = surface_error(original, mesh, samples=SAMPLES)
    return replace(result, shape=shape, mesh=mesh, normals=normals, unseen=unseen, error=error)


def _wanted(mesh: MeshArrays, parts: Parts) -> tuple[MeshArrays, tuple[str, ...]]:
    """The mesh, or its largest component, and a note if that is not all."""
    if parts == "all":
        return mesh, ()
    largest, others = largest_component(weld(mesh))
    return (largest, (f"kept the largest of {others + 1} components",)) if others else (mesh, ())


def _mesh_plan(mesh: MeshArrays, sizes: Sizes, threads: int | None) -> Plan:
    welded = weld(mesh)
    measures = measure_mesh(welded)
    obstacles = mapping_obstacles(mesh)
    ways, reason = mesh_ways(mesh, measures, star_of(welded, measures), obstacles, sizes, threads)
    solid = measures.closed and measures.edge_manifold and measures.vertex_manifold and measures.orientable
    topology = (measures.components, measures.euler_number) if solid else None
    opened = "" if solid else f"the original {'is open' if measures.edge_manifold else 'is not manifold'}"
    return Plan(ways, reason, topology, opened)


def _tried(plan: Plan, original: MeshArrays | PointArrays, told: Told | None) -> tuple[list[Attempt], list[Trial]]:
    attempts: list[Attempt] = []
    trials: list[Trial] = []
    for way in plan.ways:
        if told is not None:
            told(way.name)
        attempt, trial = attempted(way, original, plan.topology)
        trials.append(trial)
        if attempt is not None:
            attempts.append(attempt)
            if _rmse(attempt) <= way.enough and trial.topology_kept is not False:
                break
    if not attempts:
        raise GeometryError("no method leads to a surface: " + "; ".join(f"{t.way}: {t.failure}" for t in trials))
    return attempts, trials


def _best(attempts: list[Attempt], topology: tuple[int, int] | None) -> Attempt:
    """The least error; but parts and handles as they were are worth a few times that, within the tolerance."""
    least = min(attempts, key=_rmse)
    bound = min(TOLERANCE, _GOOD_TOPOLOGY * _rmse(least))
    return min(
        (one for one in attempts if topology == _topology(one) and _rmse(one) <= bound), key=_rmse, default=least
    )


def _rmse(attempt: Attempt) -> float:
    return attempt.judged


def _topology(attempt: Attempt) -> tuple[int, int]:
    return attempt.measures.components, attempt.measures.euler_number


def _reason(plan: Plan, best: Attempt, trials: list[Trial]) -> str:
    if len(trials) == 1:
        return plan.reason
    others = [
        f"{trial.way} {'fails' if trial.rmse is None else f'leaves {100 * trial.rmse:.2g} %'}"
        for trial in trials
        if trial.way != best.made.way
    ]
    return f"{plan.reason}; {', '.join(others)}"


def _warnings(plan: Plan, best: Attempt, sizes: Sizes) -> Iterator[str]:
    rmse = _rmse(best)
    if rmse > TOLERANCE:
        yield (
            f"the RMSE is {100 * rmse:.2g} % of the diagonal, more than {100 * TOLERANCE:g} %: a larger bandwidth than "
            f'{sizes.surface} keeps more, parts="largest" (--parts largest) leaves out what floats about'
        )
    before, after = plan.topology, _topology(best)
    if before is not None and before != after:
        yield (
            f"parts and handles are not as they were: {_counted(before)} became {_counted(after)}, because some are "
            "thinner or nearer to each other than the shape resolves; a larger bandwidth keeps more of them"
        )
    if best.unseen is not None:
        yield (
            f"{100 * best.unseen.mean():.2g} % of the surface was not seen: it is left out, and the surface is open "
            "there; more scans from other sides would close it"
        )
    if plan.opened:
        yield f"{plan.opened} and has become closed: {'; '.join(best.made.notes) or 'openings were filled'}"


def _counted(topology: tuple[int, int]) -> str:
    parts, euler = topology
    handles = parts - euler // 2
    return f"{parts} part{'' if parts == 1 else 's'} with {handles} handle{'' if handles == 1 else 's'}"
