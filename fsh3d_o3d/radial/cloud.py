"""The radial function of a point cloud: noise, outliers, holes and uneven density are what it is made for."""

from __future__ import annotations

from math import isqrt

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import CoverageError, GeometryError
from fsh3d_o3d.geometry import PointArrays
from fsh3d_o3d.radial.angular_cells import AngularCells, largest_empty_cap
from fsh3d_o3d.radial.cloud_center import cloud_center
from fsh3d_o3d.radial.scattered_fit import fit_scattered
from fsh3d_o3d.sphere import evaluate, fibonacci_grid

__all__ = ["CloudFit", "cloud_center", "fit_radial_cloud", "usable_bandwidth"]


_FARTHEST = 1e3  # medians; radii beyond are outliers, however far, and are cut to it so that squares do not overflow
_FIRST_LOOK = 50_000  # points, a degree apart on a sphere: far below the holes that are to be found
_USUAL = 64  # bandwidth beyond which nobody asks how much more there could be; a choice
_NEAREST = 1e-9  # of the median; of smaller radii float64 keeps less than seven digits of the direction


@value
class CloudFit:
    """The radial function fitted to a point cloud, and what the fit found besides."""

    coefficients: Float64Array
    """(b²,) of r(ω), in the units of the points."""
    center: Float64Array
    """(3,) where radii start."""
    scale: float
    """Robust standard deviation of the points' radii about the function, in the units of the points."""
    inliers: float
    """Fraction of the points that the fit did not reject, in [0, 1]."""
    empty_cap: float
    """Angular radius in degrees of the largest cap without a point that counts; the function is a guess there."""
    empty_direction: Float64Array
    """(3,) unit vector, the centre of that cap."""
    smoothness: float
    """Weight λ of the bending energy, given or chosen; 0 where none was needed."""
    iterations: int
    """Rounds of reweighting at the full bandwidth."""
    converged: bool
    """Whether the last round changed the function by no more than a small part of its standard error."""


def fit_radial_cloud(
    cloud: PointArrays,
    bandwidth: int,
    center: object,
    *,
    smoothness: float | None = None,
    max_hole: float = 60.0,
    threads: int | None = None,
) -> CloudFit:
    """Fit the distance r(ω) from a centre to the surface that a cloud samples, as a function of degree < b.

    The coefficients are fitted to all points at once, with Tukey's biweight against outliers and a penalty
    λ Σ (l(l+1))^q c², which bends the function least where there are no points. Points are judged against their
    neighbours as well, so that edges too sharp for the bandwidth are kept.

    Args:
        cloud: Points; normals are not used.
        bandwidth: b; the points must lie in at least about 2b² directions.
        center: (3,) where radii start, inside the surface; see ``cloud_center``.
        smoothness: λ of the bending energy (q = 2) in units of the squared samples' mean; 1e-8 … 1e-6 bridges holes. If
            not given, λ and q are those under which the cloud is most likely, judged by the energy at each degree.
        max_hole: Largest angular radius, in degrees, of a cap without points that is filled, in (0, 90].
        threads: Number of threads, or None for all that the process may use. Does not change the result.

    Raises:
        CoverageError: A cap larger than ``max_hole`` has no points, or only outliers.
        GeometryError: Points too few for the bandwidth, coinciding, or all at the centre; or a fitted radius that is
            not positive.
        TypeError, ValueError: Another argument is of the wrong type, out of range or misshapen.
    """
    if not isinstance(cloud, PointArrays):
        raise TypeError(f"cloud must be PointArrays, got {type(cloud).__name__}; see geometry_arrays")
    b = check.bandwidth(bandwidth)
    middle = check.point(center, "center")
    if smoothness is not None:
        smoothness = check.number(smoothness, "smoothness", minimum=0.0)
    max_hole = check.number(max_hole, "max_hole", minimum=0.0, maximum=90.0, exclusive=True)
    if threads is not None:
        check.integer(threads, "threads", minimum=1, maximum=1024)
    directions, radii, unit = _polar(cloud.points, middle)
    # Where a part of the points leaves no hole too large, all of them leave none.
    if np.degrees(largest_empty_cap(directions[:: 1 + len(directions) // _FIRST_LOOK])[0]) > max_hole:
        _check_coverage(directions, max_hole, "points")
    _check_number(directions, b)
    check.memory(8.0 * 40 * len(radii) + 8.0 * 60 * 24 * b * b, f"the fit of {len(radii)} points at bandwidth {b}")
    fit = fit_scattered(directions, radii, b, smoothness=smoothness, threads=threads)
    kept = directions[fit.weights > 0]
    cap, direction = _check_coverage(kept, max_hole, "points but outliers")
    lowest = float(np.min(evaluate(fit.coefficients, fibonacci_grid(4 * b * b), threads=threads)))
    if not lowest > 0:
        raise GeometryError(
            f"the fitted radius falls to {lowest * unit:.3g} seen from the center {_text(middle)}: it is not a point "
            "well inside of the surface, or holes are too large for the bandwidth; try cloud_center, a lower bandwidth "
            "or more smoothness"
        )
    if unit >= np.finfo(np.float64).max / (16 * float(np.abs(fit.coefficients).max())):
        raise GeometryError(f"radii of about {unit:.3g} are too large for float64 coefficients; scale the points down")
    coefficients = fit.coefficients * unit
    for array in (coefficients, middle, direction):
        array.setflags(write=False)
    return CloudFit(
        coefficients,
        middle,
        fit.scale * unit,
        len(kept) / len(cloud.points),
        cap,
        direction,
        fit.smoothness,
        fit.iterations,
        fit.converged,
    )


def _polar(points: Float64Array, center: Float64Array) -> tuple[Float64Array, Float64Array, float]:
    """Directions (n, 3), radii (n,) in units of their median, and that unit; points at the centre are left out."""
    if len(points) > 1 and not (points != points[0]).any():
        raise GeometryError(f"all {len(points)} points coincide at {_text(points[0])}: there is no surface")
    # Quarters, and each point by its own largest coordinate: nothing overflows, and no far outlier drowns the rest.
    relative = points / 4 - center / 4
    largest = np.abs(relative).max(axis=1)
    typical = float(np.median(largest)) or float(largest.max())
    if typical == 0:
        raise GeometryError(f"all {len(points)} points lie at the center {_text(center)}: they have no direction")
    away = largest > _NEAREST * typical
    if not away.all():
        relative, largest = relative[away], largest[away]
    relative /= largest[:, None]
    length = np.sqrt(np.einsum("ij,ij->i", relative, relative))
    radii = length * np.minimum(largest / typical, 2 * _FARTHEST)
    unit = float(np.median(radii))
    return relative / length[:, None], np.minimum(radii / unit, _FARTHEST), 4 * unit * typical


def usable_bandwidth(cloud: PointArrays, center: Float64Array) -> int:
    """Return the largest bandwidth, 0 … 64, that a cloud has points enough for, seen from a centre (3,)."""
    directions = _polar(cloud.points, center)[0]
    return min(_USUAL, isqrt(min(len(directions), 2 * _distinct(directions, _USUAL)) // 2))


def _distinct(directions: Float64Array, b: int) -> int:
    """In how many cells directions lie that are finer than a bandwidth tells apart."""
    return len(AngularCells.of(directions, 16.0 * max(b * b, 12)).count)


def _check_number(directions: Float64Array, b: int) -> None:
    """Refuse points in too few different directions; copies of a point say nothing new."""
    distinct = _distinct(directions, b)
    usable = min(len(directions), 2 * distinct)  # two may share a cell
    if usable < 2 * b * b:
        largest = isqrt(usable // 2)
        places = "" if distinct > len(directions) // 2 else f" in only about {distinct} different directions"
        advice = f"use at most bandwidth {largest}" if largest > 0 else "there are too few for any bandwidth"
        raise GeometryError(
            f"{len(directions)} points{places} are too few for bandwidth {b}, which takes 2b² = {2 * b * b}; {advice}"
        )


def _check_coverage(directions: Float64Array, max_hole: float, what: str) -> tuple[float, Float64Array]:
    """Return the largest empty cap in degrees and its centre."""
    if len(directions) == 0:
        raise CoverageError(f"there are no {what}: the whole sphere is empty")
    radius, direction = largest_empty_cap(directions)
    cap = float(np.degrees(radius))
    if cap > max_hole:
        raise CoverageError(
            f"the cloud covers too little of the sphere: a cap of {cap:.1f} degrees about the direction "
            f"{_text(direction)} has no {what}, and caps up to {max_hole:g} degrees are filled; of a scan from one "
            "side, fsh3d reconstruct without --method (fsh.reconstruct) makes the open surface of what was seen; for a "
            "whole body give a center inside of it"
        )
    return cap, direction


def _text(vector: Float64Array) -> str:
    return "({:.6g}, {:.6g}, {:.6g})".format(*vector)
