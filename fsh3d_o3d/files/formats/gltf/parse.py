"""glTF 2.0: .gltf and .glb as one mesh, or one cloud where they hold points alone, in scene coordinates.

Buffers are embedded or lie in the same folder; nothing else is ever opened. What a scene does is what glTF's nodes,
instances, morph targets and skins say while no animation plays.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.accessors import GltfAccessors
from fsh3d_o3d.files.formats.gltf.container import glb_chunks
from fsh3d_o3d.files.formats.gltf.document import GltfDocument
from fsh3d_o3d.files.formats.gltf.meshes import GltfMeshes, Piece, Shape, require_size
from fsh3d_o3d.files.formats.gltf.scene import GltfScene, PlacedMesh
from fsh3d_o3d.files.formats.gltf.transforms import mirrors, placed, turned_normals
from fsh3d_o3d.files.formats.result import VertexValues, cloud_of, mesh_of
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.geometry import MeshArrays, PointArrays


def parse_glb(source: Source) -> MeshArrays | PointArrays:
    """Return a binary glTF file in scene coordinates."""
    return _geometry(GltfDocument(source, *glb_chunks(source)))


def parse_gltf(source: Source) -> MeshArrays | PointArrays:
    """Return a glTF file in scene coordinates."""
    return _geometry(GltfDocument(source, source.data, None))


def _geometry(document: GltfDocument) -> MeshArrays | PointArrays:
    accessors = GltfAccessors(document)
    scene = GltfScene(document, accessors)
    meshes = GltfMeshes(document, accessors, scene)
    shapes: Counter[Shape] = Counter()
    for placement in scene.placed:
        shapes.update(meshes.shapes(placement.mesh))
    if not shapes["triangles"] and not shapes["points"]:
        if shapes["lines"]:
            raise GeometryReadError("no surface: there are no triangles, only lines")
        raise GeometryReadError("no surface: the scene places no triangles and no points")
    kept: Shape = "triangles" if shapes["triangles"] else "points"
    passed = [shape for shape in ("points", "lines") if shapes[shape] and shape != kept]
    if passed:
        document.source.note(f"{' and '.join(passed)} beside the {kept} were passed over")
    pieces = _pieces(scene, meshes, kept)
    if kept == "triangles":
        return mesh_of(document.source, *_surface(scene, pieces), _values(document.source, scene, pieces))
    return _cloud(document.source, scene, pieces)


def _pieces(scene: GltfScene, meshes: GltfMeshes, shape: Shape) -> list[tuple[PlacedMesh, int, Piece]]:
    """What is placed how often, once it is known that there is room for all."""
    pieces: list[tuple[PlacedMesh, int, Piece]] = []
    vertices = triangles = 0
    for placement in scene.placed:
        piece, copies = meshes.piece(placement, shape), scene.count(placement)
        vertices += copies * len(piece.vertices)
        triangles += copies * len(piece.triangles)
        require_size(vertices, triangles, "the scene places")
        if len(piece.vertices):
            pieces.append((placement, copies, piece))
    return pieces


def _surface(scene: GltfScene, pieces: list[tuple[PlacedMesh, int, Piece]]) -> tuple[Float64Array, IntArray]:
    vertices = np.empty((sum(copies * len(piece.vertices) for _, copies, piece in pieces), 3))
    triangles = np.empty((sum(copies * len(piece.triangles) for _, copies, piece in pieces), 3), dtype=np.int64)
    vertex = triangle = 0
    for placement, copies, piece in pieces:
        stop, size = vertex + copies * len(piece.vertices), copies * len(piece.triangles)
        corners = piece.triangles + (vertex + len(piece.vertices) * np.arange(copies))[:, None, None]
        if placement.skin is None:
            transforms = scene.placements(placement)
            inside_out = mirrors(transforms)
            corners[inside_out] = corners[inside_out, :, ::-1]
            vertices[vertex:stop] = placed(transforms, piece.vertices).reshape(-1, 3)
        else:
            vertices[vertex:stop] = np.tile(piece.vertices, (copies, 1))
        triangles[triangle : triangle + size] = corners.reshape(-1, 3)
        vertex, triangle = stop, triangle + size
    return vertices, triangles


def _values(source: Source, scene: GltfScene, pieces: list[tuple[PlacedMesh, int, Piece]]) -> VertexValues:
    """What all vertices have besides their places, in the order of the vertices."""
    normals: list[Float64Array | None] = []
    for placement, _, piece in pieces:
        if piece.normals is None or placement.skin is not None:
            normals.append(None)
        else:
            normals.append(turned_normals(scene.placements(placement), piece.normals).reshape(-1, 3))
    colors = [None if piece.colors is None else np.tile(piece.colors, (copies, 1)) for _, copies, piece in pieces]
    uvs = [None if piece.uvs is None else np.tile(piece.uvs, (copies, 1)) for _, copies, piece in pieces]
    return VertexValues(
        _common(source, "normals", normals),
        _common(source, "colours", colors),
        _common(source, "texture coordinates", uvs),
    )


def _cloud(source: Source, scene: GltfScene, pieces: list[tuple[PlacedMesh, int, Piece]]) -> PointArrays:
    points: list[Float64Array] = [np.empty((0, 3))]
    normals: list[Float64Array | None] = []
    colors: list[Float64Array | None] = []
    for placement, copies, piece in pieces:
        still = placement.skin is not None  # the skin has placed it
        transforms = np.tile(np.eye(3, 4), (copies, 1, 1)) if still else scene.placements(placement)
        points.append(placed(transforms, piece.vertices).reshape(-1, 3))
        normals.append(None if piece.normals is None else turned_normals(transforms, piece.normals).reshape(-1, 3))
        colors.append(None if piece.colors is None else np.tile(piece.colors, (copies, 1)))
    both = _common(source, "normals", normals), _common(source, "colours", colors)
    return cloud_of(source, np.concatenate(points), *both)


def _common(source: Source, name: str, parts: list[Float64Array | None]) -> Float64Array | None:
    """Attributes of all parts; none where some have none."""
    given = [part for part in parts if part is not None]
    if given and len(given) < len(parts):
        source.note(f"only some have {name}; they were left out")
    return np.concatenate(given) if given and len(given) == len(parts) else None
