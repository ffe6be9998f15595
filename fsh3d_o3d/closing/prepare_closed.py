"""A closed genus-0 surface for any mesh: as it is, repaired, or carved anew; what was changed and how far it is off."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import scipy

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.closing.carving import carve
from fsh3d_o3d.closing.enclosure import Enclosure, enclose
from fsh3d_o3d.closing.kuhn_grid import between, structure
from fsh3d_o3d.closing.snapping import fit
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import (
    BoolArray,
    EdgeTable,
    GeometryKind,
    MeshArrays,
    MeshMeasures,
    PointArrays,
    UnitCube,
    UnitScene,
    area_samples,
    chosen_kind,
    component_areas,
    geometry_arrays,
    largest_component,
    measure_mesh,
    open3d_mesh,
    oriented,
    repair_mesh,
    vertex_distances,
    weld,
    with_values_of,
)

__all__ = ["Closing", "ClosingMethod", "Parts", "prepare_closed"]

ClosingMethod = Literal["as given", "repaired", "carved"]
"""How a closed surface was made."""
Parts = Literal["all", "largest"]
"""Which components of a mesh are wanted."""

_SAMPLES = (
    20_000  # points of either surface that distances are taken at, a choice: their RMS is good to about a percent
)
_NO_AREA = 1e-14  # of the unit cube: thinner than float64 tells from a line
_DEBRIS = 1e-3  # of the area, a choice: parts that add up to no more than this are left out
_REPAIRABLE = 0.2  # of the edges, a choice: with more of them open or shared by three triangles, a mesh is a soup
_LARGEST_CAP = 0.25  # of the area, a choice: larger openings belong to the shape and are not capped by a repair
_LARGEST_LOSS = 1e-3  # RMS in the unit cube, a choice: a repair that takes away more is not used
_CLEARANCE = 0.15  # of an edge of the grid, a choice; see ``between``
_LIFT = 0.05  # cells, a choice, between a sheet and either side of the surface around it
# Around the mesh, in cells: room to carve in, and no plane of a usual model at a plane of the grid.
_MARGIN = np.array([3.13, 3.27, 3.41])
_NODE_BYTES = 80  # bytes of memory a vertex of the grid takes, measured: distances, labels and ranks at once


@value
class Closing:
    """A closed genus-0 surface, how it was made from a mesh, and how far the two are apart."""

    mesh: MeshArrays
    """Closed, manifold, of one component and genus 0, wound outward, every vertex in use."""
    method: ClosingMethod
    """``"as given"`` (equal vertices merged and triangles turned at most), ``"repaired"`` or ``"carved"``."""
    problems: tuple[str, ...]
    """What kept the mesh from being a closed genus-0 surface, readable; empty when nothing did."""
    changed: tuple[str, ...]
    """What was done, readable, in order; empty when the mesh came back as it was."""
    rms: float
    """RMS distance from points of the original to the result: what was lost. In units of the original's diagonal."""
    rms_outer: float
    """The same over the part of the original that is not ``hidden``."""
    rms_back: float
    """RMS distance from points of the result to the original, same units: what was added."""
    hausdorff: float
    """Largest distance met from the original to the result, same units."""
    hausdorff_back: float
    """Largest distance met from the result to the original, same units; membranes and caps make it large."""
    hidden: float
    """Share of the original's area that lies out of reach from outside: behind walls whose openings, if any, are
    narrower than some two cells, or closed by repair. An outer surface has none of it."""
    cells_per_side: int | None
    """Cells along the longest side of the bounding box; None where nothing was carved."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    def to_triangle_mesh(self, *, kind: GeometryKind | None = None) -> Any:
        """Return ``mesh`` as an Open3D ``TriangleMesh``, ``"legacy"`` or ``"tensor"``; like the input if not given."""
        return open3d_mesh(self.mesh, chosen_kind(kind, self.kind))


def prepare_closed(mesh: Any, *, cells_per_side: int = 64, repair: bool = True, parts: Parts = "all") -> Closing:
    """Return a closed genus-0 surface for a mesh, changing as little as possible.

    What is closed, manifold, of one component and genus 0 once equal vertices are merged is returned so. What is nearly
    that is repaired by MeshLab: debris dropped, holes closed, non-manifold places split. What then still has handles or
    several components, and every soup of polygons, is rebuilt: the solid is put on a grid and carved out of a box in a
    way that keeps it a ball (``carving``), and its surface drawn onto the original. It is an outer surface: cavities
    are filled, what is inside a closed part is gone, sheets become thin bodies, a membrane closes every
    handle, and threads join what hangs apart.

    Args:
        mesh: Triangle mesh, as ``from_any`` takes it.
        cells_per_side: Cells along the longest side of the bounding box where the mesh is carved, 8 … 1024. What is
            thinner than a cell keeps its place but not its thickness; gaps narrower than a cell may close.
        repair: Whether to try a repair before carving.
        parts: ``"all"``: every component, joined by threads, but for debris of a thousandth of the area;
            ``"largest"``: the component of the most area, such as a scan without the specks around it. Distances are
            measured from the whole original in both cases.

    Raises:
        TypeError: Not a mesh.
        ValueError: Another argument is out of range.
        GeometryError: Empty, not finite, or without area.
        MemoryEstimateError: The grid is too large for the memory at hand.

    Example:
        >>> knot = fsh.read_geometry("samples/trefoil_knot.ply")  # closed, but of genus 1
        >>> closing = fsh.prepare_closed(knot, cells_per_side=16)
        >>> closing.method
        'carved'
        >>> fsh.ConformalShape.from_geometry(closing.to_triangle_mesh(), bandwidth=8).to_triangle_mesh(1000)
        TriangleMesh with 1002 points and 2000 triangles.
    """
    cells = check.integer(cells_per_side, "cells_per_side", minimum=8, maximum=1024)
    check.choice(parts, "parts", ("all", "largest"))
    given, kind = geometry_arrays(mesh)
    if isinstance(given, PointArrays):
        raise TypeError("a closed surface needs a mesh, got a point cloud; reconstruct a surface from it first")
    welded = weld(given)
    cube = UnitCube.around(welded.vertices)
    unit = MeshArrays(
        cube.to_unit(welded.vertices), welded.triangles
    )  # bare, and where squares of lengths do not overflow
    measures = measure_mesh(unit)
    if measures.area <= _NO_AREA:
        raise GeometryError("the mesh has no area: all its triangles are degenerate")
    changed = _weld_notes(given, welded)
    problems = _problems(measures)
    if not problems:
        turned = oriented(welded)
        assert turned is not None
        if turned is not welded:
            changed += ("turned triangles to face outward",)
        return Closing(turned if changed else given, "as given", (), changed, *6 * (0.0,), None, kind)
    main, others = largest_component(unit) if parts == "largest" else (unit, 0)
    before = measure_mesh(main) if others else measures
    if others:
        changed += (f"kept the largest of {others + 1} components",)
    source, notes = _repaired(main, before) if repair else (main, ())
    changed += notes
    method: ClosingMethod = "repaired"
    closed, outer = source, None
    after = before if source is main else measure_mesh(source)
    points = area_samples(unit, _SAMPLES)[0]
    if _problems(after) or not after.outward:
        closed, outer, notes = _carved(source, cells, points)
        method, changed = "carved", changed + notes
    there, back = _distances(points, closed), _distances(area_samples(closed, _SAMPLES)[0], unit)
    reached = there if outer is None or not outer.any() else there[outer]
    return Closing(
        mesh=with_values_of(given, MeshArrays(cube.from_unit(closed.vertices), closed.triangles)),
        method=method,
        problems=problems,
        changed=changed,
        rms=_rms(there) / unit.diagonal,
        rms_outer=_rms(reached) / unit.diagonal,
        rms_back=_rms(back) / unit.diagonal,
        hausdorff=float(there.max()) / unit.diagonal,
        hausdorff_back=float(back.max()) / unit.diagonal,
        hidden=1 - len(reached) / len(there),
        cells_per_side=cells if method == "carved" else None,
        kind=kind,
    )


def _weld_notes(given: MeshArrays, welded: MeshArrays) -> tuple[str, ...]:
    used = int(np.count_nonzero(np.bincount(given.triangles.ravel(), minlength=len(given.vertices))))
    counts = (
        (used - len(welded.vertices), "merged {} repeated vertices"),
        (len(given.vertices) - used, "left out {} vertices that no triangle uses"),
        (len(given.triangles) - len(welded.triangles), "left out {} triangles with a repeated corner"),
    )
    return tuple(text.format(count) for count, text in counts if count)


def _problems(measures: MeshMeasures) -> tuple[str, ...]:
    """What keeps a welded mesh from being a closed genus-0 surface."""
    found = (
        (measures.degenerate_triangles > 0, f"{measures.degenerate_triangles} triangles without area"),
        (measures.components > 1, f"{measures.components} components"),
        (not measures.edge_manifold, "edges with more than two triangles"),
        (not measures.closed and measures.edge_manifold, "open: edges with one triangle"),
        (not measures.vertex_manifold, "vertices where several sheets touch"),
        (measures.edge_manifold and not measures.orientable, "not orientable"),
        (bool(measures.genus), f"genus {measures.genus}"),
    )
    return tuple(text for wrong, text in found if wrong)


def _repaired(mesh: MeshArrays, measures: MeshMeasures) -> tuple[MeshArrays, tuple[str, ...]]:
    """A closed surface that keeps to the mesh, and what was done; the mesh itself where repair would do it harm."""
    main, dropped = _without_debris(mesh) if measures.components > 1 else (mesh, 0)
    notes: tuple[str, ...] = (f"left out {dropped} small components",) if dropped else ()
    before = measure_mesh(main) if dropped else measures
    if before.closed and before.vertex_manifold and before.orientable and not before.degenerate_triangles:
        return oriented(main) or main, notes  # nothing that MeshLab could mend
    table = EdgeTable(main.triangles)
    if np.count_nonzero(table.faces != 2) > _REPAIRABLE * len(table.faces):
        return mesh, ()
    try:
        result = repair_mesh(main)
    except GeometryError:
        return mesh, ()
    mended, after = result.mesh, result.after
    if after.degenerate_triangles:
        # Holes that touch are split apart at the vertex and then closed as one, by triangles without area between the
        # copies. Now that they are closed, the copies can be one again. Elsewhere this would undo the splits.
        mended = weld(mended)
        after = measure_mesh(mended)
    if (
        not after.closed
        or after.area > (1 + _LARGEST_CAP) * before.area
        or _rms(_distances(area_samples(main, _SAMPLES)[0], mended)) > _LARGEST_LOSS
    ):
        return mesh, ()
    counts = f"{len(main.triangles)} triangles became {len(mended.triangles)}"
    notes += (f"closed holes, split non-manifold places and removed repeated triangles with MeshLab: {counts}",)
    return mended, notes


def _without_debris(mesh: MeshArrays) -> tuple[MeshArrays, int]:
    """The largest component and the number of others, or the whole where the others are more than debris."""
    area = component_areas(mesh)[1]
    return (mesh, 0) if area.max() < (1 - _DEBRIS) * area.sum() else largest_component(mesh)


def _carved(mesh: MeshArrays, cells: int, points: Float64Array) -> tuple[MeshArrays, BoolArray, tuple[str, ...]]:
    """The surface of the body carved around a mesh, which of some points outside reaches, and what was done."""
    low, extent = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    step = float(extent.max()) / cells
    nx, ny, nz = (np.ceil(extent / step + 2 * _MARGIN).astype(np.int64) + 1).tolist()
    check.memory(_NODE_BYTES * nx * ny * nz, f"carving a grid of {nx} × {ny} × {nz} vertices")
    scene = UnitScene((mesh.vertices - low) / step + _MARGIN, mesh.triangles)
    solid = enclose(scene, (nx, ny, nz))
    body = carve(solid.kept)
    added = body & ~solid.kept
    values = np.where(solid.thin | added, 0.0, solid.distance)
    surface, ends = between(body, values, _CLEARANCE)
    owner = ends[:, 0]
    held, lift = added.ravel()[owner], np.where(solid.thin.ravel()[owner], _LIFT, 0.0)
    fitted = MeshArrays(fit(surface.vertices, surface.triangles, scene, held, lift), surface.triangles)
    after = measure_mesh(fitted)
    # Drawn onto a sheet that has no thickness a surface may lose its volume; as cut from the grid it has one.
    final = fitted if after.outward and after.degenerate_triangles == 0 else surface
    result = MeshArrays((final.vertices - _MARGIN) * step + low, final.triangles)
    reached = _reached(~solid.kept | solid.thin, (points - low) / step + _MARGIN)
    return result, reached, _carving_notes(solid, added)


def _carving_notes(solid: Enclosure, added: BoolArray) -> tuple[str, ...]:
    grid = " × ".join(map(str, added.shape))
    parts, fillings = (
        int(scipy.ndimage.label(solid.kept, structure())[1]),
        int(scipy.ndimage.label(added, structure())[1]),
    )
    notes: tuple[str, ...] = (f"rebuilt as the surface of a solid carved on a grid of {grid} vertices",)
    if solid.thin.any():
        notes += ("gave sheets and wires a thickness",)
    if parts > 1:
        notes += (f"joined {parts} parts by threads",)
    if fillings > max(parts - 1, 0):
        notes += (f"put about {fillings - parts + 1} membranes across openings",)
    return notes


def _reached(outside: BoolArray, points: Float64Array) -> BoolArray:
    """Which points (n, 3) are in a cell of the grid with a corner outside."""
    corners = points.astype(np.int64)[:, None] + np.array(list(np.ndindex(2, 2, 2)))
    return np.asarray(outside[tuple(np.moveaxis(corners, -1, 0))].any(axis=1))


def _distances(points: Float64Array, target: MeshArrays) -> Float64Array:
    return vertex_distances(PointArrays(points), target)


def _rms(distances: Float64Array) -> float:
    return float(np.sqrt(np.square(distances).mean()))
