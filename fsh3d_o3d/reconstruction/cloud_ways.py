"""The ways to a shape that suit a point cloud, best first: points all around, a scan of one side, the rest."""

from __future__ import annotations

import functools

import numpy as np

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import CoverageError, GeometryError
from fsh3d_o3d.geometry import PointArrays, open3d_point_cloud, thinned
from fsh3d_o3d.radial import cloud_center, fit_one_sided, fit_radial_cloud, usable_bandwidth
from fsh3d_o3d.reconstruction.attempts import Made, Way
from fsh3d_o3d.reconstruction.sizes import Sizes
from fsh3d_o3d.shapes import RadialShape, ShellShape

_ENOUGH = 5e-3  # RMS distance of the points, relative, at which no other way is tried: noise of scanners
_COARSE = 8  # bandwidth of a fit that only tells whether points lie all around
_POISSON_POINTS = 100_000  # more than the 256 cells of a Poisson surface tell apart; a choice
_NEIGHBORS = 16  # points to estimate a normal from, and to hand its side on to; a choice


def cloud_ways(cloud: PointArrays, sizes: Sizes, threads: int | None) -> tuple[tuple[Way, ...], str]:
    """Return the ways in the order in which they are to be tried, and what speaks for the first.

    Raises:
        GeometryError: There are too few points for any surface.
    """
    if cloud.diagonal == 0:
        raise GeometryError(f"all {len(cloud.points)} points are the same")
    center = cloud_center(cloud)
    shells = Way("shells", functools.partial(_shells, cloud, sizes, threads), _ENOUGH)
    try:
        b = min(_COARSE, usable_bandwidth(cloud, center))
        if b == 0:
            raise GeometryError(f"{len(cloud.points)} points are too few for a surface: even degree 0 takes two")
        fit = fit_radial_cloud(cloud, b, center, threads=threads)
    except CoverageError:
        side = Way("radial, one side", functools.partial(_one_side, cloud, sizes, threads), _ENOUGH)
        return (side, shells), "points lie on one side only"
    except GeometryError:
        return (shells,), "points lie all around, on no single radius"
    radial = Way("radial", functools.partial(_radial, cloud, center, sizes, threads), _ENOUGH)
    return (radial, shells), f"points lie all around, {100 * fit.inliers:.3g} % on one radius in each direction"


def _radial(cloud: PointArrays, center: np.ndarray, sizes: Sizes, threads: int | None) -> Made:
    b = min(sizes.surface, usable_bandwidth(cloud, center))
    shape = RadialShape.from_geometry(cloud, b, center, threads=threads)
    return Made(shape, "radial", "radial", _fewer(cloud, b, sizes))


def _one_side(cloud: PointArrays, sizes: Sizes, threads: int | None) -> Made:
    fit = fit_one_sided(cloud, sizes.surface, threads=threads)
    shape = RadialShape(fit.coefficients, fit.center)
    return Made(shape, "radial", "radial, one side", _fewer(cloud, shape.bandwidth, sizes))


def _fewer(cloud: PointArrays, b: int, sizes: Sizes) -> tuple[str, ...]:
    return () if b >= sizes.surface else (f"bandwidth {b}, as much as {len(cloud.points)} points tell",)


def _shells(cloud: PointArrays, sizes: Sizes, threads: int | None) -> Made:
    chosen = thinned(cloud.points, _POISSON_POINTS)
    kept, colors = cloud.points[chosen], None if cloud.colors is None else cloud.colors[chosen]
    notes: tuple[str, ...] = ()
    if cloud.normals is None:
        guessed = open3d_point_cloud(PointArrays(kept))
        neighbors = min(_NEIGHBORS, len(kept) - 1)
        guessed.estimate_normals(open3d().geometry.KDTreeSearchParamKNN(neighbors))
        guessed.orient_normals_consistent_tangent_plane(neighbors)
        source = PointArrays(kept, np.asarray(guessed.normals), colors)
        notes = ("estimated normals, and turned them alike",)
    else:
        source = PointArrays(kept, cloud.normals[chosen], colors)
    shape = ShellShape.from_geometry(source, sizes.shell, sizes.shells, "signed_distance", threads=threads)
    return Made(shape, "shells", "shells, Poisson", notes)
