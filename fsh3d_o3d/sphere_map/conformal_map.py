"""Maps of closed genus-0 surfaces to the sphere: conformal, or balanced between angles and areas."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import MeshArrays, UnitCube, geometry_arrays
from fsh3d_o3d.sphere import single_threaded_blas
from fsh3d_o3d.sphere_map.balance import AREA_WEIGHT, balance, balance_level
from fsh3d_o3d.sphere_map.diagnosis import closed_surface
from fsh3d_o3d.sphere_map.embedding import Relax, embed
from fsh3d_o3d.sphere_map.flow import harmonic_start, mean_curvature_flow, placed, pole_triangle
from fsh3d_o3d.sphere_map.laplacian import PinnedLaplacian, laplacian, lumped_mass
from fsh3d_o3d.sphere_map.mobius import aligned
from fsh3d_o3d.sphere_map.relaxation import relax
from fsh3d_o3d.sphere_map.spherical_map import MapMethod, SphericalMap
from fsh3d_o3d.sphere_map.untangle import untangled
from fsh3d_o3d.sphere_map.validity import degree, distortion, is_valid, orientations

__all__ = ["ConformalMapOption", "conformal_map"]

_RECOVERY_STEPS = 50  # Newton steps towards the conformal map after a fallback, a bound: it ends where little is left
_FLOW_TOLERANCE = 0.02  # of what is left: the next step would change the mean distortion in the third digit


@value(kw_only=True)
class ConformalMapOption:
    """How a surface is mapped to the sphere.

    Raises:
        ValueError: A field is out of range.
        TypeError: A field is not of its type.

    Example:
        >>> star = fsh.read_geometry("samples/spiky_star.glb")
        >>> conformal = fsh.conformal_map(star, fsh.ConformalMapOption(area_weight=0))  # angles alone
        >>> balanced = fsh.conformal_map(star)
        >>> balanced.area_distortion < conformal.area_distortion
        True
    """

    area_weight: float = AREA_WEIGHT
    """α ≥ 0 of the term α·log²(area ratio) that is weighed against conformal distortion. 0: the conformal map, which
    leaves limbs a vanishing share of the sphere. The default reconstructs best."""
    max_iterations: int = 20
    """For the conformal map, most steps of the mean-curvature flow; 0 keeps its stereographic start."""
    balance_iterations: int | None = None
    """Most Newton steps of the optimisation of the whole map at its end. None: none for a balanced map, which is
    balanced level by level already, and 50 for a conformal map that the flow alone could not make."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "area_weight", check.number(self.area_weight, "area_weight", minimum=0))
        for name, largest in (("max_iterations", 1000), ("balance_iterations", 10000)):
            if getattr(self, name) is not None or name == "max_iterations":
                object.__setattr__(self, name, check.integer(getattr(self, name), name, minimum=0, maximum=largest))


def conformal_map(mesh: Any, option: ConformalMapOption | None = None) -> SphericalMap:
    """Map a closed surface of genus 0 to the unit sphere, one to one.

    A balanced map is built from coarse to fine: the surface is decimated to a tetrahedron, and its vertices return in
    batches, each into the kernel of its star, while angles and areas are weighed against each other on every level. It
    is valid by construction (after Praun and Hoppe, 2003, and Hu, Fu and Liu, 2018).

    For the conformal map, ``area_weight`` 0, a stereographic harmonic map and some steps of the conformalised
    mean-curvature flow of Kazhdan, Solomon and Ben-Chen (2012) are centred by a Möbius transformation. Where triangles
    are flipped, their surroundings are laid out evenly; where that does not do, as on long tubes, the map is built from
    coarse to fine as well, and brought back towards the conformal one.

    Every step is made of lengths and angles of the surface, and the result is turned to agree best with the vertices:
    the map turns with the surface, but for rounding, and for surfaces so symmetric that several turns agree as well.
    The same input and option give the same bytes.

    Args:
        mesh: Triangle mesh, as ``from_any`` takes it. Equal vertices are merged and the surface is
            turned outwards first; triangles without area are mapped like others.
        option: See ``ConformalMapOption``.

    Returns:
        The map, with no triangle flipped and covering the sphere once.

    Raises:
        GeometryError: The mesh is not a closed manifold of one component and genus 0: open, not manifold, in several
            parts, with handles, or one-sided. The message counts what is wrong and names what helps. Or it is so
            stretched that float64 has no room for its triangles on the sphere.
        MemoryEstimateError: The mesh is too large.
        TypeError: Not a triangle mesh.

    Example:
        >>> star = fsh.read_geometry("samples/spiky_star.glb")
        >>> surface = fsh.conformal_map(star)
        >>> surface.positions.shape, surface.flipped
        ((32, 3), 0)
        >>> np.allclose(np.linalg.norm(surface.positions, axis=1), 1)
        True
    """
    chosen = ConformalMapOption() if option is None else option
    if not isinstance(chosen, ConformalMapOption):
        raise TypeError(f"option must be a ConformalMapOption, got {type(chosen).__name__}")
    arrays, kind = geometry_arrays(mesh)
    if not isinstance(arrays, MeshArrays):
        raise TypeError("a point cloud has no surface to map: conformal_map takes triangle meshes")
    check.memory(_memory(len(arrays.triangles), chosen), f"mapping {len(arrays.triangles)} triangles to the sphere")
    surface = closed_surface(arrays)
    triangles = np.array(surface.mesh.triangles)
    with single_threaded_blas():
        vertices = _normalised(surface.mesh)
        start = _valid_map(vertices, triangles, chosen)
        sphere, balance_iterations = _optimised(vertices, triangles, start, chosen)
    measured = distortion(vertices, triangles, sphere)
    source = surface.source_vertices
    source.setflags(write=False)
    return SphericalMap(
        mesh=surface.mesh,
        positions=sphere,
        source_vertices=source,
        flipped=int(np.count_nonzero(orientations(sphere, triangles) <= 0)),
        degree=degree(sphere, triangles),
        distortion_mean=measured.mean,
        distortion_99=measured.percentile_99,
        area_distortion=measured.area,
        iterations=start.iterations,
        balance_iterations=balance_iterations,
        method=start.method,
        kind=kind,
    )


@dataclass(frozen=True, eq=False)
class _Start:
    """A valid map and what made it."""

    sphere: Float64Array
    iterations: int
    method: MapMethod


def _valid_map(vertices: Float64Array, triangles: IntArray, option: ConformalMapOption) -> _Start:
    """Return the balanced embedding, or for a conformal map the first that is valid of flow, untangled and embedded."""
    if option.area_weight > 0:
        evened = functools.partial(balance_level, area_weight=option.area_weight)
        return _embedded(vertices, triangles, evened, 0)
    start = _flowed(vertices, triangles, option)
    if is_valid(start.sphere, triangles):
        return start
    if degree(start.sphere, triangles) == 1:
        sphere = untangled(start.sphere, triangles)
        if is_valid(sphere, triangles):
            return replace(start, sphere=sphere, method="untangled")
    return _embedded(vertices, triangles, relax, start.iterations)


def _embedded(vertices: Float64Array, triangles: IntArray, relaxed: Relax, iterations: int) -> _Start:
    """Return the coarse-to-fine map, relaxed on every level, in the surface's pose."""
    try:
        sphere = embed(vertices, triangles, relax=relaxed)
    except ArithmeticError as error:
        raise GeometryError(
            f"float64 has no room on the sphere for the triangles of this mesh ({error}); a remeshed or decimated "
            "surface maps"
        ) from error
    turned = aligned(sphere, vertices, lumped_mass(vertices, triangles))
    return _Start(turned if is_valid(turned, triangles) else sphere, iterations, "embedding")


def _flowed(vertices: Float64Array, triangles: IntArray, option: ConformalMapOption) -> _Start:
    """Return the flow's map, centred and turned to the surface's pose, with flipped triangles or even NaN."""
    # A flow that collapses divides by zero, or fails to factorise; that its map is not valid says all.
    with np.errstate(all="ignore"):
        try:
            pole = pole_triangle(vertices, triangles)
            matrix = PinnedLaplacian(laplacian(vertices, triangles), pin=int(pole[0]))
            start = harmonic_start(vertices, triangles, pole, matrix)
            flow = mean_curvature_flow(
                vertices, triangles, start, matrix, steps=option.max_iterations, tolerance=_FLOW_TOLERANCE
            )
            return _Start(placed(flow.sphere, vertices, triangles), flow.iterations, "flow")
        except (RuntimeError, np.linalg.LinAlgError):  # SuperLU's word for a singular matrix; NumPy's for NaN
            return _Start(np.full_like(vertices, np.nan), 0, "flow")


def _optimised(
    vertices: Float64Array, triangles: IntArray, start: _Start, option: ConformalMapOption
) -> tuple[Float64Array, int]:
    """Return the map optimised as a whole, where that is asked for or a fallback led away, and the steps."""
    conformal = option.area_weight == 0
    steps = option.balance_iterations
    if steps is None:
        steps = _RECOVERY_STEPS if conformal else 0
    if steps == 0 or (conformal and start.method == "flow"):
        return start.sphere, 0
    balanced = balance(
        vertices,
        triangles,
        start.sphere,
        area_weight=option.area_weight,
        max_iterations=steps,
    )
    if not conformal:  # a Möbius transformation now would undo the balance
        return balanced.sphere, balanced.iterations
    centered = placed(balanced.sphere, vertices, triangles)
    return centered if is_valid(centered, triangles) else balanced.sphere, balanced.iterations


def _normalised(mesh: MeshArrays) -> Float64Array:
    """Return the vertices scaled to area 4π, about the middle of their box."""
    cube = UnitCube.around(mesh.vertices)
    vertices = cube.to_unit(mesh.vertices)
    return vertices * math.sqrt(4 * math.pi / float(lumped_mass(vertices, mesh.triangles).sum()))


def _memory(triangles: int, option: ConformalMapOption) -> float:
    """Return the bytes that the factors of the largest system take: measured to have 3–4 log₂ t entries a triangle."""
    entries = 4 * math.log2(max(triangles, 2)) * triangles
    if option.area_weight > 0 and not option.balance_iterations:
        return 3000.0 * triangles  # no system; the levels of the hierarchy
    return 16 * entries * (1 if option.balance_iterations == 0 else 4)  # one or two unknowns for each vertex
