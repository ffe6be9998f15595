"""One way to a shape at a time: tried, decoded, and measured against the original."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError, MemoryEstimateError
from fsh3d_o3d.geometry import (
    BoolArray,
    MeshArrays,
    MeshMeasures,
    PointArrays,
    SurfaceError,
    measure_mesh,
    surface_error,
    vertex_distances,
)
from fsh3d_o3d.reconstruction.coverage import unseen_vertices
from fsh3d_o3d.reconstruction.reconstruction import Method, Trial
from fsh3d_o3d.shapes import Shape

SAMPLES = 20_000
"""Points on each surface that errors are measured at, a choice: their RMS is good to a percent."""
_JUDGED = 0.9  # share of a cloud's points, the nearest, that ways are compared by: others may be outliers; a choice


@dataclass(frozen=True, eq=False)
class Made:
    """A shape, and what was done on the way to it."""

    shape: Shape
    """The shape."""
    method: Method
    """Its kind."""
    way: str
    """The method and what was done before it."""
    notes: tuple[str, ...] = ()
    """What was done, readable."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """A way that led to a surface, and how far that is off."""

    made: Made
    """The shape."""
    mesh: MeshArrays
    """The surface that comes back."""
    normals: Float64Array
    """(v, 3) its vertex normals."""
    measures: MeshMeasures
    """Of that surface."""
    error: SurfaceError
    """Between the original and the surface."""
    judged: float
    """RMSE that ways are compared by, in units of the original's diagonal; of clouds without their outliers."""
    unseen: BoolArray | None
    """(v,) vertices where a scan saw nothing, or None."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way that may be tried."""

    name: str
    """For messages."""
    make: Callable[[], Made]
    """Makes the shape, or raises ``GeometryError`` or ``MemoryEstimateError``."""
    enough: float
    """RMSE, relative, at which no other way is tried: the next one seldom leaves less."""


def attempted(
    way: Way,
    original: MeshArrays | PointArrays,
    topology: tuple[int, int] | None,
) -> tuple[Attempt | None, Trial]:
    """Try a way; the attempt is None where it leads nowhere, and the trial says why.

    Args:
        way: What to try.
        original: What it is measured against.
        topology: Parts and Euler number of the original, where it has a closed surface.
    """
    started = time.perf_counter()
    try:
        made = way.make()
        mesh, normals = made.shape.mesh_arrays()
        error = surface_error(original, mesh, samples=SAMPLES)
    except (GeometryError, MemoryEstimateError) as failure:
        reason = " ".join(str(failure).split())
        return None, Trial(way.name, None, None, None, time.perf_counter() - started, reason)
    measures = measure_mesh(mesh)
    judged, unseen = error.rmse / error.diagonal, None
    if isinstance(original, PointArrays):
        distances = np.sort(vertex_distances(original, mesh))[: max(1, int(_JUDGED * len(original.points)))]
        judged = float(np.sqrt(np.square(distances).mean())) / error.diagonal
        unseen = unseen_vertices(original, mesh)
    attempt = Attempt(made, mesh, normals, measures, error, judged, unseen)
    kept = None if topology is None else topology == (measures.components, measures.euler_number)
    maximum = error.maximum / error.diagonal
    return attempt, Trial(made.way, judged, maximum, kept, time.perf_counter() - started, "")
