"""The radial function of a mesh: how far from a centre the surface lies in each direction."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import KDTree

from fsh3d_o3d._validation import Float64Array, IntArray, choice, number, point
from fsh3d_o3d._validation import directions as checked_directions
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError, NotStarShapedError
from fsh3d_o3d.geometry import MeshArrays, UnitCube, UnitScene
from fsh3d_o3d.radial.star import SAME_HIT, visible_area
from fsh3d_o3d.sphere_map import mapping_obstacles

Behaviour = Literal["error", "outermost", "innermost"]

ACCEPTED_DIRECTIONS = 0.01
"""Fraction of directions that may meet a surface never, or several times, for it to count as nearly star-shaped:
small folds pass, such as the ears of a portrait."""
HIDDEN_AREA = 0.02
"""Fraction of its area that the centre may then not see: an ear like a hare's takes few directions, but more area."""
_FILL_NEIGHBORS = 8  # directions whose mean fills one: its ring on the grid, and a few; a choice
_PARITY_RAYS = 512  # to tell whether the centre is inside, by their majority: a few may graze edges


@value
class RadialSamples:
    """Distances from a centre to a surface."""

    radii: Float64Array
    """(n,) positive distances along the directions; filled smoothly from their neighbours where ``hit`` is False."""
    hit: NDArray[np.bool_]
    """(n,) whether the direction meets the surface."""
    several: NDArray[np.bool_]
    """(n,) whether its first and last meeting with the surface differ."""
    center: Float64Array
    """(3,) where the rays start."""

    @property
    def missed(self) -> float:
        """Fraction of directions that never meet the surface."""
        return float(1 - self.hit.mean())

    @property
    def multiple(self) -> float:
        """Fraction of directions that meet the surface more than once."""
        return float(self.several.mean())


def sample_radial(
    mesh: MeshArrays,
    directions: Float64Array,
    center: Float64Array,
    *,
    behaviour: Behaviour = "error",
    accepted: float = ACCEPTED_DIRECTIONS,
    hidden: float = HIDDEN_AREA,
    fillable: float = 0.1,
    same: float = SAME_HIT,
) -> RadialSamples:
    """Sample the distance from a centre to a mesh along directions.

    Rays choose the triangle in float32, in the unit cube about the centre; the distance is then that to
    the triangle's plane in float64, unless the ray grazes it.

    Args:
        mesh: Any triangle mesh; its orientation does not matter.
        directions: (n, 3) unit vectors.
        center: (3,) where the rays start, inside the surface.
        behaviour: What to do with directions that meet the surface more than once: ``"error"`` raises unless they are
            few and then takes the outermost meeting; ``"outermost"`` and ``"innermost"`` take that one.
        accepted: For ``"error"``, the largest fraction of directions with no meeting, and that with several, in
            [0, 1].
        hidden: For ``"error"``, the largest fraction of the area that the centre may not see, in [0, 1]; looked at
            where some direction has no meeting or several. The defaults let pass what is star-shaped but for small
            folds, such as ears of a portrait; an ear like a hare's takes few directions but much area.
        fillable: For the other two, the largest fraction of directions without a meeting that is filled, in [0, 1].
            Filled radii are harmonic over a graph of nearest directions, thus within the range of those around the
            hole.
        same: Two meetings closer than this are one, in units of the largest coordinate of a vertex seen from the
            centre (rounded up to a power of two).

    Raises:
        NotStarShapedError: Too many directions without a meeting or with several; says how far from star-shaped the
            surface is, whether the centre is outside, and which methods fit.
        GeometryError: The mesh has no extent or no area.
        ValueError: Another argument is out of range or misshapen.
    """
    rays = checked_directions(directions)
    middle = point(center, "center")
    choice(behaviour, "behaviour", ("error", "outermost", "innermost"))
    number(accepted, "accepted", minimum=0, maximum=1)
    number(hidden, "hidden", minimum=0, maximum=1)
    number(fillable, "fillable", minimum=0, maximum=1)
    number(same, "same", minimum=0, maximum=1)
    vertices = mesh.gathered_vertices
    cube = UnitCube.around(vertices, center=middle)
    scene = UnitScene(cube.to_unit(vertices), mesh.triangles)
    near, far = scene.radii(rays)
    samples = RadialSamples(
        radii=(near if behaviour == "innermost" else far) * cube.scale,
        hit=~np.isnan(near),
        several=far - near > same,
        center=middle,
    )
    worst = max(samples.missed, samples.multiple)
    if behaviour == "error":
        refused = worst > accepted or (worst > 0 and 1 - _visible(mesh, middle) > hidden)
    else:
        refused = samples.missed > fillable
    if refused or not samples.hit.any():
        raise NotStarShapedError(_explanation(mesh, scene, rays, samples, behaviour, fillable))
    if not samples.hit.all():
        samples.radii[~samples.hit] = filled(rays, samples.radii / cube.scale, samples.hit) * cube.scale
    for array in (samples.radii, samples.hit, samples.several, samples.center):
        array.setflags(write=False)
    return samples


def filled(directions: Float64Array, radii: Float64Array, hit: NDArray[np.bool_]) -> Float64Array:
    """Return radii for the directions not hit: each the mean of its nearest directions, hit or filled."""
    missing = np.flatnonzero(~hit)
    known = np.flatnonzero(hit)
    nearest = KDTree(directions[known]).query(directions[missing])[1]
    fallback = radii[known[nearest]]
    count = min(_FILL_NEIGHBORS + 1, len(directions))
    found: IntArray = KDTree(directions).query(directions[missing], k=count)[1].reshape(len(missing), count)
    weight = (found != missing[:, None]).astype(np.float64)
    weight /= weight.sum(axis=1)[:, None]
    place = np.cumsum(~hit) - 1
    rows = np.broadcast_to(np.arange(len(missing))[:, None], found.shape)
    open_ = ~hit[found]
    inner = csr_array((weight[open_], (rows[open_], place[found[open_]])), shape=(len(missing), len(missing)))
    outer = np.where(open_, 0.0, weight * np.where(hit[found], radii[found], 0.0)).sum(axis=1)
    # The slight pull to the nearest known radius keeps the system regular where directions coincide.
    pull = 1e-9
    solution = spsolve(((1 + pull) * eye_array(len(missing)) - inner).tocsc(), outer + pull * fallback)
    return np.asarray(solution)


def _explanation(
    mesh: MeshArrays,
    scene: UnitScene,
    directions: Float64Array,
    samples: RadialSamples,
    behaviour: str,
    fillable: float,
) -> str:
    x, y, z = samples.center
    some = directions[:: max(1, len(directions) // _PARITY_RAYS)]
    outside = (scene.count(np.zeros(3), some) % 2).mean() < 0.5
    where = f"({x:.6g}, {y:.6g}, {z:.6g})" + (", which lies outside of it" if outside else "")
    text = (
        f"the surface is not star-shaped seen from the center {where}: "
        f"{_percent(samples.missed)} of directions never meet it, {_percent(samples.multiple)} more than once, "
        f"and {_percent(_visible(mesh, samples.center))} of its area is visible"
    )
    remedies = ['method="shells" (ShellShape), which takes any topology']
    if _maps_to_the_sphere(mesh):
        remedies.insert(0, 'method="conformal" (ConformalShape), which takes closed surfaces of genus 0')
    if behaviour == "error" and samples.missed <= fillable:
        remedies.append('behaviour="outermost", which keeps what is seen from outside')
    if outside:
        remedies.insert(0, "another center")
    return f"{text}; use {', or '.join(remedies)}"


def _maps_to_the_sphere(mesh: MeshArrays) -> bool:
    try:
        return not mapping_obstacles(mesh)
    except GeometryError:  # no area
        return False


def _visible(mesh: MeshArrays, center: Float64Array) -> float:
    try:
        return visible_area(mesh, center)
    except GeometryError:  # no area
        return 0.0


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.3g} %"
