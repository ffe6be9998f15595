"""Geometry of several parts: components, scans, labels, put together and still told apart."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.result import cloud_of, mesh_of
from fsh3d_o3d.files.formats.source import Part, Source, counted
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_MOST_PARTS = 1000  # that are told apart, a choice: with their names they fit into the header of an answer
_LONGEST_NAME = 60  # characters, a choice
_MOST_POINTS = 2**28  # vertices of all parts together, a choice: 6.4 GB, more than the reader is allowed by default


class Assembly:
    """Parts of one file, in order."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._names: list[str] = []
        self._meshes: list[MeshArrays] = []
        self._clouds: list[PointArrays] = []
        self._points = 0

    def add_mesh(
        self, name: str, vertices: Float64Array, triangles: IntArray, placement: Float64Array | None = None
    ) -> None:
        """Add a surface, placed by a (3, 4) transform; one that mirrors turns the triangles over.

        Raises:
            GeometryError: There are no triangles, they are out of range, or use what is not finite.
        """
        mesh = mesh_of(self._source, vertices, triangles)
        if placement is not None:
            moved = mesh.vertices @ placement[:, :3].T + placement[:, 3]
            mirrored = np.linalg.det(placement[:, :3]) < 0
            mesh = mesh_of(self._source, moved, mesh.triangles[:, ::-1] if mirrored else mesh.triangles)
        self._count(name, len(mesh.vertices))
        self._meshes.append(mesh)

    def add_cloud(
        self, name: str, points: Float64Array, normals: Float64Array | None = None, colors: Float64Array | None = None
    ) -> None:
        """Add a cloud.

        Raises:
            GeometryError: No point is left without those that are not finite.
        """
        cloud = cloud_of(self._source, points, normals, colors)
        self._count(name, len(cloud.points))
        self._clouds.append(cloud)

    def result(self) -> MeshArrays | PointArrays:
        """Return all surfaces as one, or all clouds where there are no surfaces, and tell the file's parts.

        Raises:
            GeometryReadError: There is nothing.
        """
        if self._meshes and self._clouds:
            self._source.note(f"{counted(len(self._clouds), 'cloud')} of points beside the surfaces passed over")
        if not self._meshes and not self._clouds:
            raise GeometryReadError("no surface and no points")
        sizes = [(len(mesh.vertices), len(mesh.triangles)) for mesh in self._meshes]
        sizes = sizes or [(len(cloud.points), 0) for cloud in self._clouds]
        if len(sizes) <= _MOST_PARTS:
            self._source.parts = [Part(name, *size) for name, size in zip(self._names, sizes, strict=True)]
        else:
            self._source.note(f"its {len(sizes)} parts are not told apart: they are more than {_MOST_PARTS}")
        return self._joined_meshes() if self._meshes else self._joined_clouds()

    def _count(self, name: str, points: int) -> None:
        self._points += points
        if self._points > _MOST_POINTS:
            raise GeometryReadError(f"its parts unfold to more than {_MOST_POINTS} vertices")
        self._names.append(name[:_LONGEST_NAME])

    def _joined_meshes(self) -> MeshArrays:
        if len(self._meshes) == 1:
            return self._meshes[0]
        first = np.cumsum([0] + [len(mesh.vertices) for mesh in self._meshes])
        return MeshArrays(
            np.concatenate([mesh.vertices for mesh in self._meshes]),
            np.concatenate([mesh.triangles + start for mesh, start in zip(self._meshes, first[:-1], strict=True)]),
        )

    def _joined_clouds(self) -> PointArrays:
        if len(self._clouds) == 1:
            return self._clouds[0]

        def joined(name: str) -> Float64Array | None:
            arrays = [getattr(cloud, name) for cloud in self._clouds]
            return None if any(array is None for array in arrays) else np.concatenate(arrays)

        points = joined("points")
        assert points is not None
        return PointArrays(points, joined("normals"), joined("colors"))
