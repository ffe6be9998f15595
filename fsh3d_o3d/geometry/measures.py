"""Area, volume, centroids and topology of triangle meshes; exact welding; consistent orientation; area samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray, integer
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, rearranged, turned_over
from fsh3d_o3d.geometry.rays import UnitCube
from fsh3d_o3d.geometry.topology import EdgeTable, components
from fsh3d_o3d.geometry.triangles import degenerate, even_places, points_at, solid_volume, triangle_areas


@value
class MeshMeasures:
    """What a mesh measures and how it hangs together; vertices that no triangle uses are ignored."""

    area: float
    """Sum of the triangles' areas."""
    volume: float | None
    """Signed enclosed volume, positive when faces wind counter-clockwise seen from outside; None where the surface
    bounds none, that is unless every edge is run through as often in one direction as in the other."""
    area_centroid: Float64Array
    """(3,) centroid of the surface."""
    volume_centroid: Float64Array | None
    """(3,) centroid of the enclosed solid; None where ``volume`` is None or zero."""
    diagonal: float
    """Length of the bounding-box diagonal."""
    degenerate_triangles: int
    """Number of triangles without area: repeated or collinear corners."""
    closed: bool
    """Every edge belongs to exactly two triangles."""
    edge_manifold: bool
    """Every edge belongs to at most two triangles."""
    vertex_manifold: bool
    """The triangles at every vertex form one fan, joined by edges."""
    orientable: bool
    """Edge-manifold, and the triangles can be turned so that neighbours agree (a Möbius band's cannot)."""
    consistently_oriented: bool
    """Edge-manifold, and neighbours already agree."""
    outward: bool
    """Closed, consistently oriented and of positive volume."""
    components: int
    """Number of parts that share no vertex."""
    euler_number: int
    """Vertices − edges + triangles."""
    genus: int | None
    """Number of handles; None unless closed, manifold, orientable and of one component."""


def measure_mesh(mesh: MeshArrays) -> MeshMeasures:
    """Measure a mesh as it is indexed; ``weld`` it first where triangles repeat their vertices (STL).

    Sums run in the unit cube, so neither a far-off origin nor extreme units cost digits. Topology
    counts triangles with a repeated corner as absent.

    Raises:
        GeometryError: The mesh has no extent, or no triangle with three different corners.
    """
    cube, vertices = _in_unit_cube(mesh)
    corners = vertices[mesh.triangles]
    area, area_centroid = _area(corners)
    table = EdgeTable(without_collapsed(mesh).triangles)
    volume, volume_centroid = solid_volume(corners) if table.balanced else (None, None)
    used = int(np.count_nonzero(np.bincount(table.triangles.ravel())))
    closed = bool((table.faces == 2).all())
    edge_manifold = bool((table.faces <= 2).all())
    vertex_manifold = table.fans() == used
    consistent = edge_manifold and bool(table.opposite(table.pairs()).all())
    orientable = edge_manifold and (consistent or table.flips() is not None)
    isolated = len(vertices) - used
    parts = components(table.ends[:, 0], table.ends[:, 1], len(vertices))[0] - isolated
    euler = used - len(table.first) + len(table.triangles)
    simple = closed and vertex_manifold and orientable and parts == 1
    return MeshMeasures(
        area=area * cube.scale * cube.scale,
        volume=None if volume is None else volume * cube.scale * cube.scale * cube.scale,
        area_centroid=_readonly(cube.from_unit(area_centroid)),
        volume_centroid=None if volume_centroid is None else _readonly(cube.from_unit(volume_centroid)),
        diagonal=float(np.linalg.norm([np.ptp(vertices[:, k]) for k in range(3)])) * cube.scale,
        degenerate_triangles=int(np.count_nonzero(degenerate(corners))),
        closed=closed,
        edge_manifold=edge_manifold,
        vertex_manifold=vertex_manifold,
        orientable=orientable,
        consistently_oriented=consistent,
        outward=closed and consistent and volume is not None and volume > 0,
        components=parts,
        euler_number=euler,
        genus=1 - euler // 2 if simple else None,
    )


def weld(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with bit-identical vertices merged, unused ones removed and collapsed triangles left out.

    Vertices and triangles keep their order (a merged vertex stands where its first copy stood).

    Raises:
        GeometryError: No triangle with three different corners is left.
    """
    return weld_map(mesh)[0]


def weld_map(mesh: MeshArrays) -> tuple[MeshArrays, IntArray]:
    """Return what ``weld`` does, and for each of its vertices (w,) the given one: the first of those merged."""
    used = mesh.used
    vertices = mesh.vertices[used] + 0.0  # makes −0 and 0 one
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    new = np.concatenate(([True], (ordered[1:] != ordered[:-1]).any(axis=1)))
    # lexsort is stable, so the first of each group is the copy with the lowest index.
    keeper = order[np.flatnonzero(new)[np.cumsum(new) - 1]]
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = keeper
    kept = first == np.arange(len(vertices))
    index = (np.cumsum(kept) - 1)[first]
    place = np.cumsum(used) - 1
    triangles = index[place[mesh.triangles]]
    whole = _three_corners(triangles)
    source = np.flatnonzero(used)[kept]
    return rearranged(mesh, source, triangles[whole], whole, vertices=vertices[kept]), source


def component_areas(mesh: MeshArrays) -> tuple[IntArray, Float64Array]:
    """Return the component (t,) each triangle belongs to, and the area of each."""
    triangles = mesh.triangles
    number, label = components(triangles.ravel(), triangles[:, (1, 2, 0)].ravel(), len(mesh.vertices))
    part = label[triangles[:, 0]]
    area = np.bincount(part, weights=triangle_areas(mesh.vertices[triangles]), minlength=number)
    return part, area.astype(np.float64, copy=False)


def largest_component(mesh: MeshArrays) -> tuple[MeshArrays, int]:
    """Return the component of the most area, the mesh itself where it is all, and how many others there are."""
    part, area = component_areas(mesh)
    others = int(np.count_nonzero(np.bincount(part, minlength=len(area)))) - 1
    if others == 0:
        return mesh, 0
    return MeshArrays(mesh.vertices, mesh.triangles[part == int(area.argmax())]).compact()[0], others


def oriented(mesh: MeshArrays) -> MeshArrays | None:
    """Return the mesh with neighbouring triangles wound alike and outward, or None where it cannot be oriented.

    Triangles that already agree with the majority of their component keep their winding, and everything turns over if
    the volume between the surface and the centre of its box comes out negative, which decides for open surfaces too.
    Needs shared vertices (``weld``); None where an edge has more than two triangles.
    """
    mesh = without_collapsed(mesh)
    table = EdgeTable(mesh.triangles)
    flips = table.flips() if (table.faces <= 2).all() else None
    if flips is None:
        return None
    turned = mesh.triangles
    if flips.any():
        turned = np.where(flips[:, None], turned[:, (0, 2, 1)], turned)
    if solid_volume(_in_unit_cube(mesh)[1][turned])[0] < 0:
        flips = ~flips
    return turned_over(mesh, flips) if flips.any() else mesh


def enclosed_volume(mesh: MeshArrays) -> float | None:
    """Return the volume (positive) a mesh encloses after welding and orienting it, or None where it is not closed."""
    welded = weld(mesh)
    table = EdgeTable(welded.triangles)
    if not table.balanced:
        turned = oriented(welded) if (table.faces == 2).all() else None
        if turned is None:
            return None
        welded = turned
    cube, vertices = _in_unit_cube(welded)
    return abs(solid_volume(vertices[welded.triangles])[0]) * cube.scale * cube.scale * cube.scale


def area_samples(mesh: MeshArrays, count: int, *, seed: int = 0) -> tuple[Float64Array, IntArray]:
    """Return points (count, 3) spread evenly over the surface's area and the triangle (count,) each lies on.

    One point falls into each of ``count`` equal shares of the area in the order of the triangles; within the triangles
    they follow a Kronecker sequence. The same seed gives the same points.
    """
    count = integer(count, "count", minimum=1)
    cube, vertices = _in_unit_cube(mesh)
    total = np.cumsum(triangle_areas(vertices[mesh.triangles]))
    if total[-1] <= 0:
        raise GeometryError("the mesh has no area: all its triangles are degenerate")
    random = np.random.default_rng(integer(seed, "seed", minimum=0))
    share = (np.arange(count) + random.random(count)) / count
    triangle = np.minimum(np.searchsorted(total, share * total[-1], side="right"), len(total) - 1)
    places = even_places(np.arange(count), random.random(2)[:, None])
    points = points_at(vertices[mesh.triangles[triangle]], places)
    return cube.from_unit(points), triangle.astype(np.int64)


def _in_unit_cube(mesh: MeshArrays) -> tuple[UnitCube, Float64Array]:
    """Return the cube about the vertices in use, and all vertices in it (unused ones at the first one in use)."""
    vertices = mesh.gathered_vertices
    cube = UnitCube.around(vertices)
    return cube, cube.to_unit(vertices)


def without_collapsed(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh without the triangles that repeat a corner; without any others, a ``GeometryError``."""
    whole = _three_corners(mesh.triangles)
    return mesh if whole.all() else rearranged(mesh, np.arange(len(mesh.vertices)), mesh.triangles[whole], whole)


def _three_corners(triangles: IntArray) -> NDArray[np.bool_]:
    """Which triangles (t,) have three different corners; without any, a ``GeometryError``."""
    whole = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    if not whole.any():
        raise GeometryError("the mesh has no area: every triangle repeats a corner")
    return np.asarray(whole)


def _area(corners: Float64Array) -> tuple[float, Float64Array]:
    weight = triangle_areas(corners)
    area = float(weight.sum())
    if area <= 0:
        raise GeometryError("the mesh has no area: all its triangles are degenerate")
    return area, weight @ corners.mean(axis=1) / area


def _readonly(array: Float64Array) -> Float64Array:
    array.setflags(write=False)
    return array
