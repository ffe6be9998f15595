"""The ways to a shape that suit a mesh, best first: what its measurements say."""

from __future__ import annotations

import functools

from fsh3d_o3d.closing import prepare_closed
from fsh3d_o3d.geometry import EdgeTable, MeshArrays, MeshMeasures, weld
from fsh3d_o3d.radial import ACCEPTED_DIRECTIONS, HIDDEN_AREA, StarReport, star_center
from fsh3d_o3d.reconstruction.attempts import Made, Way
from fsh3d_o3d.reconstruction.sizes import Sizes
from fsh3d_o3d.shapes import ConformalShape, RadialShape, ShellShape

_ENOUGH_RADIAL = (
    2.5e-3  # RMSE, relative, a choice: a conformal shape, of three times the numbers, may leave a tenth of it
)
_ENOUGH = 5e-3  # RMSE, relative: other ways seldom halve it
_PROMISING = 0.7  # of the area, a choice: seen so much from the centroid, an open surface may be nearly star-shaped
_WIDTH = 1.2  # distances of shells, a choice: of narrower Gaussians sheets have gaps, wider ones are thicker


def is_star_shaped(star: StarReport) -> bool:
    """Return whether a centre sees the whole surface, or all but what is let pass as a small fold."""
    few = max(star.missed, star.multiple) <= ACCEPTED_DIRECTIONS and 1 - star.visible_area <= HIDDEN_AREA
    return star.exact or few


def star_of(welded: MeshArrays, measures: MeshMeasures) -> StarReport:
    """Return the report on the centre that a radial shape starts from.

    The best centre is not looked for where the surface is open and its centroid sees little of it: it takes a second.
    """
    report = star_center(welded, "centroid")
    if report.exact or (not measures.closed and report.visible_area < _PROMISING):
        return report
    return star_center(welded, "best")


def mesh_ways(
    mesh: MeshArrays,
    measures: MeshMeasures,
    star: StarReport,
    obstacles: tuple[str, ...],
    sizes: Sizes,
    threads: int | None,
) -> tuple[tuple[Way, ...], str]:
    """Return the ways in the order in which they are to be tried, and what speaks for the first.

    Args:
        mesh: The mesh.
        measures: Of the welded mesh.
        star: How star-shaped it is.
        obstacles: What keeps it from being mapped to the sphere as it is.
        sizes: Bandwidths.
        threads: Number of threads.
    """
    radial = Way("radial", functools.partial(_radial, mesh, star, sizes, threads), _ENOUGH_RADIAL)
    conformal = Way("conformal", functools.partial(_conformal, mesh, sizes, threads), _ENOUGH)
    shells = Way("shells", functools.partial(_shells, mesh, sizes, threads), _ENOUGH)
    closed = Way("conformal, closed", functools.partial(_closed, mesh, sizes, threads), _ENOUGH)
    gaussian = Way("shells, Gaussian", functools.partial(_gaussian, mesh, sizes, threads), _ENOUGH)
    first: tuple[Way, ...] = ()
    reason = ""
    if is_star_shaped(star):
        first, reason = (radial,), "star-shaped" if star.exact else "nearly star-shaped"
    if not obstacles:
        return (*first, conformal, shells), reason or "closed, of genus 0, and not star-shaped"
    if EdgeTable(weld(mesh).triangles).balanced:
        reason = reason or f"it {', '.join(obstacles)}, and bounds a solid: shells take any topology"
        return (*first, shells, closed, gaussian), reason
    reason = reason or f"it {', '.join(obstacles)}: to be closed first, then mapped to the sphere"
    return (*first, closed, gaussian, shells), reason


def _radial(mesh: MeshArrays, star: StarReport, sizes: Sizes, threads: int | None) -> Made:
    return Made(RadialShape.from_geometry(mesh, sizes.surface, star.center, threads=threads), "radial", "radial")


def _conformal(mesh: MeshArrays, sizes: Sizes, threads: int | None) -> Made:
    return Made(ConformalShape.from_geometry(mesh, sizes.surface, threads=threads), "conformal", "conformal")


def _closed(mesh: MeshArrays, sizes: Sizes, threads: int | None) -> Made:
    closing = prepare_closed(mesh)
    shape = ConformalShape.from_geometry(closing.mesh, sizes.surface, threads=threads)
    way = "conformal" if closing.method == "as given" else f"conformal, {closing.method}"
    return Made(shape, "conformal", way, closing.changed)


def _shells(mesh: MeshArrays, sizes: Sizes, threads: int | None) -> Made:
    shape = ShellShape.from_geometry(mesh, sizes.shell, sizes.shells, "signed_distance", threads=threads)
    return Made(shape, "shells", "shells")


def _gaussian(mesh: MeshArrays, sizes: Sizes, threads: int | None) -> Made:
    width = _WIDTH / sizes.shells
    shape = ShellShape.from_geometry(mesh, sizes.shell, sizes.shells, "gaussian_distance", width=width, threads=threads)
    note = f"gave the surface a thickness of {100 * width:.2g} % of its radius to either side"
    return Made(shape, "shells", "shells, Gaussian", (note,))
