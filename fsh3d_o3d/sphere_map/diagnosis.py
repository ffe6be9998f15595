"""Whether a mesh can be mapped to the sphere, what stands in the way, and the mesh made ready where nothing does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import EdgeTable, MeshArrays, MeshMeasures, measure_mesh, oriented, weld_map, without_collapsed

__all__ = ["mapping_obstacles"]

_REMEDY = "prepare_closed makes a closed surface of genus 0 of it (fsh3d reconstruct --repair)"


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed manifold of one component and genus 0, oriented outwards, without unused vertices."""

    mesh: MeshArrays
    """The surface."""
    source_vertices: IntArray
    """(n,) the input's vertex that each vertex was; the first of those that were merged."""


def mapping_obstacles(mesh: MeshArrays) -> tuple[str, ...]:
    """Return what keeps a mesh from being mapped to the sphere, a phrase each; empty where nothing does.

    Only topology does: bad triangles and any orientation are fine. Bit-identical vertices count as one, unless the mesh
    is a closed surface of genus 0 only as indexed, as where it touches itself in a point.

    Raises:
        GeometryError: The mesh has no extent or no area.
    """
    surface = _closed_surface(mesh)
    return () if isinstance(surface, ClosedSurface) else surface


def closed_surface(mesh: MeshArrays) -> ClosedSurface:
    """Return the mesh welded and turned outwards.

    Raises:
        GeometryError: It is not a closed manifold of one component and genus 0; says in which respects and what helps.
    """
    surface = _closed_surface(mesh)
    if isinstance(surface, ClosedSurface):
        return surface
    raise GeometryError(
        "only closed manifold surfaces of one component and genus 0 map to the sphere, but this mesh "
        f"{'; '.join(surface)}. {_REMEDY}"
    )


def _closed_surface(mesh: MeshArrays) -> ClosedSurface | tuple[str, ...]:
    welded, source = weld_map(mesh)
    welded, kept = welded.compact()  # vertices of triangles that collapsed may be left over
    source = source[kept]
    measures = _measured(welded)
    if measures.genus == 0:
        return ClosedSurface(_outward(welded, measures), source)
    if np.count_nonzero(mesh.used) > len(welded.vertices):  # there was something to weld: without, it may hold together
        compact, source = without_collapsed(mesh).compact()
        as_indexed = _measured(compact)
        if as_indexed.genus == 0:
            return ClosedSurface(_outward(compact, as_indexed), source)
    return _obstacles(welded, measures)


def _measured(mesh: MeshArrays) -> MeshMeasures:
    measures = measure_mesh(mesh)
    if measures.degenerate_triangles == len(mesh.triangles):
        raise GeometryError("the mesh has no area: all its triangles are degenerate")
    return measures


def _outward(mesh: MeshArrays, measures: MeshMeasures) -> MeshArrays:
    if measures.outward:
        return mesh
    turned = oriented(mesh)
    return mesh if turned is None else turned  # None cannot be: a genus is known only of orientable surfaces


def _obstacles(mesh: MeshArrays, measures: MeshMeasures) -> tuple[str, ...]:
    table = EdgeTable(mesh.triangles)
    found = []
    boundary = int(np.count_nonzero(table.faces == 1))
    crowded = int(np.count_nonzero(table.faces > 2))
    if boundary:
        found.append(f"is open: {_counted(boundary, 'edge')} with one triangle only")
    if crowded:
        text = f"is not manifold: {_counted(crowded, 'edge')} with more than two triangles"
        repeated = len(mesh.triangles) - len(np.unique(np.sort(mesh.triangles, axis=1), axis=0))
        found.append(text + (f", {_counted(repeated, 'triangle')} given more than once" if repeated else ""))
    elif not measures.vertex_manifold:
        pinched = table.fans() - len(mesh.vertices)
        found.append(f"is not manifold: it touches itself at vertices, {pinched} of which must be split off")
    if measures.edge_manifold and not measures.orientable:
        found.append("is one-sided, like a Klein bottle or a Möbius band")
    if measures.components > 1:
        found.append(f"has {measures.components} components")
    if measures.genus:
        found.append(f"has genus {measures.genus}: {_counted(measures.genus, 'handle')}")
    return tuple(found)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
