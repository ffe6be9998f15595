"""Repair of broken meshes with MeshLab, for callers who ask for it; nothing in the package repairs unasked."""

from __future__ import annotations

from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._value import value
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.geometry.given import geometry_arrays
from fsh3d_o3d.geometry.measures import MeshMeasures, measure_mesh, oriented, weld
from fsh3d_o3d.geometry.open3d_objects import GeometryKind, chosen_kind, open3d_mesh
from fsh3d_o3d.geometry.rays import UnitCube
from fsh3d_o3d.geometry.transfer import with_values_of

__all__ = ["Repair", "repair_mesh"]


@value
class Repair:
    """A repaired mesh, and what it was before and after."""

    mesh: MeshArrays
    """The mesh."""
    before: MeshMeasures
    """Of the welded input."""
    after: MeshMeasures
    """Of the result."""
    kind: GeometryKind = "legacy"
    """Which Open3D objects it becomes unless told otherwise: those it came from."""

    def to_triangle_mesh(self, *, kind: GeometryKind | None = None) -> Any:
        """Return ``mesh`` as an Open3D ``TriangleMesh``, ``"legacy"`` or ``"tensor"``; like the input if not given."""
        return open3d_mesh(self.mesh, chosen_kind(kind, self.kind))


def repair_mesh(mesh: Any, *, largest_hole: int = 1000) -> Repair:
    """Weld, clean, close and orient a mesh.

    Equal vertices become one; repeated, degenerate and non-manifold triangles are removed or split apart; holes of up
    to ``largest_hole`` edges are closed; faces are wound alike and outward. What MeshLab cannot mend stays, as
    ``after`` tells.

    Args:
        mesh: Any triangle mesh, as ``from_any`` takes it.
        largest_hole: Most boundary edges of a hole that is closed; 0 closes none.

    Raises:
        TypeError: Not a triangle mesh.
        GeometryError: The mesh has no extent, or nothing of it is left.
        ValueError: ``largest_hole`` is negative or not an integer.

    Example:
        >>> directions, triangles = fsh.icosphere(4)
        >>> repair = fsh.repair_mesh(fsh.MeshArrays(directions, triangles[1:]))  # a triangle is missing
        >>> repair.before.closed, repair.after.closed
        (False, True)
        >>> repair.to_triangle_mesh().is_watertight()
        True
    """
    # Imported here: half a second, for those who repair.
    pymeshlab = import_installed("pymeshlab")

    edges = check.integer(largest_hole, "largest_hole", minimum=0, maximum=10**6)
    given, kind = geometry_arrays(mesh)
    if not isinstance(given, MeshArrays):
        raise TypeError("a point cloud has no surface to repair: repair_mesh takes triangle meshes")
    welded = weld(given)
    cube = UnitCube.around(welded.vertices)  # MeshLab stores float32 in places
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(cube.to_unit(welded.vertices), welded.triangles.astype(np.int32)))
    try:
        meshes.meshing_remove_duplicate_faces()
        meshes.meshing_remove_null_faces()
        meshes.meshing_repair_non_manifold_edges(method="Remove Faces")
        meshes.meshing_repair_non_manifold_vertices(vertdispratio=0)
        meshes.meshing_re_orient_faces_coherently()  # or the rims of holes do not join
        if edges > 0:
            meshes.meshing_close_holes(maxholesize=edges, newfaceselected=False, selfintersection=False)
        meshes.meshing_remove_unreferenced_vertices()
    except pymeshlab.PyMeshLabException as error:
        if meshes.current_mesh().face_number() > 0:
            raise GeometryError(f"MeshLab cannot repair the mesh: {' '.join(str(error).split())}") from None
    result = meshes.current_mesh()
    if result.face_number() == 0:
        raise GeometryError("nothing is left of the mesh after repair: all its triangles were degenerate or repeated")
    vertices = np.asarray(result.vertex_matrix(), dtype=np.float64)
    repaired = MeshArrays(cube.from_unit(vertices), np.asarray(result.face_matrix(), dtype=np.int64))
    turned = oriented(repaired)
    final = with_values_of(given, repaired if turned is None else turned)
    return Repair(final, measure_mesh(welded), measure_mesh(final), kind)
