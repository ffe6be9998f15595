"""Meshes of a glTF file: from primitives to triangles and points."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count as count_from
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.accessors import GltfAccessors, unit_range
from fsh3d_o3d.files.formats.gltf.deform import Skin
from fsh3d_o3d.files.formats.gltf.document import GltfDocument, extension, listed, natural
from fsh3d_o3d.files.formats.gltf.draco import DRACO, DracoMesh, decode_draco, draco_available
from fsh3d_o3d.files.formats.gltf.scene import GltfScene, PlacedMesh

# Triangles or vertices, 2.4 GB of either; a choice. A file may place one mesh many times: this bounds what it grows to.
_MAXIMUM_TRIANGLES = 100_000_000
_POINTS, _TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6  # modes of a primitive, OpenGL's numbers
Shape = Literal["points", "lines", "triangles"]
_SHAPES: tuple[Shape, ...] = ("points", "lines", "lines", "lines", "triangles", "triangles", "triangles")  # by mode
_VECTOR = ("VEC3",)
_TYPE_BY_WIDTH = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}  # numbers in an item


@dataclass(frozen=True, eq=False)
class Piece:
    """The triangles of a mesh, or its points, before it is placed."""

    vertices: Float64Array
    """(v, 3) positions; those of a mesh with a skin are where they belong already."""
    triangles: IntArray
    """(t, 3) vertex indices; none for points."""
    normals: Float64Array | None = None
    """(v, 3), where all have them."""
    colors: Float64Array | None = None
    """(v, 3) in [0, 1], where all have them."""
    uvs: Float64Array | None = None
    """(v, 2) texture coordinates, where all have them."""


def require_size(vertices: int, triangles: int, what: str) -> None:
    """Refuse what is too large; ``what`` is the beginning of the sentence."""
    if max(vertices, triangles) > _MAXIMUM_TRIANGLES:
        raise GeometryReadError(f"{what} more than {_MAXIMUM_TRIANGLES} triangles or vertices")


class GltfMeshes:
    """The meshes of a file."""

    def __init__(self, document: GltfDocument, accessors: GltfAccessors, scene: GltfScene) -> None:
        self._document = document
        self._accessors = accessors
        self._scene = scene
        self._skins: dict[int, Skin] = {}

    def shapes(self, index: int) -> Counter[Shape]:
        """Return how many primitives of a mesh are points, lines and triangles."""
        return Counter(shape for shape, _ in self._primitives(index))

    def piece(self, placed: PlacedMesh, shape: Shape) -> Piece:
        """Return all triangles of a mesh, or all its points.

        Raises:
            GeometryReadError: They are damaged, or too many.
        """
        pieces = [Piece(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))]
        vertices = triangles = 0
        for found, primitive in self._primitives(placed.mesh):
            if found == shape:
                piece = self._primitive(placed, primitive, vertices)
                pieces.append(piece)
                vertices += len(piece.vertices)
                triangles += len(piece.triangles)
                require_size(vertices, triangles, f"mesh {placed.mesh} has")
        given = {
            name: [getattr(piece, name) for piece in pieces[1:]]
            for name in ("normals", "colors", "uvs")
            if len(pieces) > 1
        }
        return Piece(
            np.concatenate([piece.vertices for piece in pieces]),
            np.concatenate([piece.triangles for piece in pieces]),
            **{name: _all_or_none(values) for name, values in given.items()},
        )

    def _primitives(self, index: int) -> Iterator[tuple[Shape, dict[str, Any]]]:
        for primitive in listed(self._document.entry("meshes", index), "primitives"):
            if not isinstance(primitive, dict) or not isinstance(primitive.get("attributes"), dict):
                raise GeometryReadError(f"damaged: a primitive of mesh {index} has no attributes")
            mode = natural(primitive, "mode", _TRIANGLES)
            if mode >= len(_SHAPES):
                raise GeometryReadError(f"damaged: a primitive of mesh {index} has the unknown mode {mode}")
            if "POSITION" not in primitive["attributes"]:  # the format has it passed over
                self._document.source.note(f"a primitive of mesh {index} has no positions; it was passed over")
                continue
            yield _SHAPES[mode], primitive

    def _primitive(self, placed: PlacedMesh, primitive: dict[str, Any], offset: int) -> Piece:
        """One primitive; its triangles count from ``offset``."""
        source = _Attributes(self._document, self._accessors, primitive)
        mode, count = primitive.get("mode", _TRIANGLES), source.count()
        flat = source.indices(count)
        if len(flat) and flat.max() >= count:
            raise GeometryReadError(f"a face names vertex {flat.max()} of {count}")
        rows: IntArray | None = None
        if mode == _POINTS:
            rows = np.unique(flat)  # each point once
        elif len(flat) < count:
            # Some vertices are not used, perhaps because many primitives share them: not all of them for each.
            rows, flat = np.unique(flat, return_inverse=True)
        triangles = np.empty((0, 3), dtype=np.int64) if mode == _POINTS else _faces(flat, mode if source.listed else 4)
        weights = placed.weights
        if weights is None:
            weights = _weights(self._document.entry("meshes", placed.mesh))
        vertices = self._morphed(source, "POSITION", weights, rows)
        normals = colors = uvs = None
        with self._dispensable(mode):
            normals = self._morphed(source, "NORMAL", weights, rows) if source.has("NORMAL") else None
        with self._dispensable(mode):
            colors = self._colors(source, rows) if source.has("COLOR_0") else None
        with self._dispensable(mode):
            uvs = source.numbers("TEXCOORD_0", ("VEC2",), rows) if source.has("TEXCOORD_0") else None
        if placed.skin is not None:
            normals = None
            vertices, mirrored = self._skinned(source, placed.skin, vertices, rows)
            triangles = triangles[:, ::-1] if mirrored else triangles
        return Piece(vertices, triangles + offset, normals, colors, uvs)

    @contextlib.contextmanager
    def _dispensable(self, mode: int) -> Iterator[None]:
        """What a surface can do without is left out with a note where it is damaged; of points, it is damage."""
        try:
            yield
        except GeometryReadError as error:
            if mode == _POINTS:
                raise
            self._document.source.note(f"{str(error).removeprefix('damaged: ')}; it was left out")

    def _morphed(
        self, source: _Attributes, name: str, weights: tuple[float, ...], rows: IntArray | None
    ) -> Float64Array:
        """Positions or normals with those of the morph targets that have a weight."""
        result = source.numbers(name, _VECTOR, rows)
        for weight, target in zip(weights, listed(source.primitive, "targets"), strict=False):
            if weight == 0 or not isinstance(target, dict) or name not in target:
                continue
            if self._accessors.count(target[name]) != source.count():
                raise GeometryReadError(f"damaged: a morph target does not have {source.count()} vertices")
            result += weight * self._accessors.numbers(target[name], _VECTOR, rows)
        return result

    def _colors(self, source: _Attributes, rows: IntArray | None) -> Float64Array:
        colors = source.numbers("COLOR_0", ("VEC3", "VEC4"), rows, fractions=True)[:, :3]
        if ((colors < 0) | (colors > 1)).any():
            self._document.source.note("some colours lie outside 0 … 1; they were moved to its ends")
        return np.clip(colors, 0, 1)

    def _skinned(
        self, source: _Attributes, index: int, points: Float64Array, rows: IntArray | None
    ) -> tuple[Float64Array, bool]:
        """Points moved by a skin, and whether their triangles are to be turned."""
        if index not in self._skins:
            self._skins[index] = Skin.of(self._document, self._accessors, self._scene, index)
        skin = self._skins[index]
        if source.has("JOINTS_0") and source.has("WEIGHTS_0"):
            sets = []
            for number in count_from():
                if not source.has(f"JOINTS_{number}") or not source.has(f"WEIGHTS_{number}"):
                    break
                sets.append(number)
            named = np.hstack([source.numbers(f"JOINTS_{number}", ("VEC4",), rows) for number in sets])
            weighed = np.hstack([source.numbers(f"WEIGHTS_{number}", ("VEC4",), rows) for number in sets])
            joints, weights = skin.influences(self._document, named, weighed)
        else:
            self._document.source.note("vertices with a skin but without weights follow its first joint")
            joints, weights = np.zeros((len(points), 1), dtype=np.int64), np.ones((len(points), 1))
        return skin.moved(points, joints, weights), skin.mirrors(joints, weights)


class _Attributes:
    """What a primitive says of its vertices, in accessors or in a compressed stream."""

    def __init__(self, document: GltfDocument, accessors: GltfAccessors, primitive: dict[str, Any]) -> None:
        self.primitive = primitive
        self._accessors = accessors
        self._named = cast(dict[str, Any], primitive["attributes"])
        self._arrays: dict[str, NDArray[Any]] = {}
        self._draco = self._decompressed(document)

    @property
    def listed(self) -> bool:
        """Whether the mode says how indices make triangles; a compressed stream always lists them."""
        return self._draco is None

    def has(self, name: str) -> bool:
        return name in self._named

    def count(self) -> int:
        """Vertices, held against what there is."""
        return len(self._stored("POSITION", _VECTOR))

    def indices(self, count: int) -> IntArray:
        if self._draco is not None:
            return self._draco.triangles.ravel()
        if "indices" in self.primitive:
            return self._accessors.indices(self.primitive["indices"])
        return np.arange(count)

    def numbers(
        self, name: str, kinds: tuple[str, ...], rows: IntArray | None, *, fractions: bool = False
    ) -> Float64Array:
        """Return an attribute as (n, width) numbers; ``fractions``: integers are normalised in any case."""
        stored = self._stored(name, kinds)
        if len(stored) != self.count():
            raise GeometryReadError(f"damaged: {name[:20]} has {len(stored)} items for {self.count()} vertices")
        normalized = fractions or self._accessors.normalized(self._named[name])
        return unit_range(stored if rows is None else stored[rows], normalized)

    def _stored(self, name: str, kinds: tuple[str, ...]) -> NDArray[Any]:
        if name not in self._arrays:
            if self._draco is None or name not in self._draco.attributes:
                self._arrays[name] = self._accessors.raw(self._named.get(name), kinds)
            else:
                self._arrays[name] = array = self._draco.attributes[name]
                if array.ndim != 2 or _TYPE_BY_WIDTH.get(array.shape[1]) not in kinds:
                    raise GeometryReadError(f"damaged: the compressed {name[:20]} is not {' or '.join(kinds)}")
        return self._arrays[name]

    def _decompressed(self, document: GltfDocument) -> DracoMesh | None:
        content = extension(self.primitive, DRACO)
        if content is None:
            return None
        needed = [self._named.get("POSITION"), *([self.primitive["indices"]] if "indices" in self.primitive else [])]
        if not draco_available() and all(self._accessors.embedded(accessor) for accessor in needed):
            return None  # the file holds it without compression as well
        attributes = content.get("attributes")
        identifiers = attributes if isinstance(attributes, dict) else {}
        if "POSITION" not in identifiers or not all(type(number) is int for number in identifiers.values()):
            raise GeometryReadError(f"damaged: {DRACO} does not say where the vertices are")
        data, _ = self._accessors.buffers.view(content.get("bufferView"))
        return decode_draco(bytes(data), identifiers)


def _weights(mesh: dict[str, Any]) -> tuple[float, ...]:
    weights = listed(mesh, "weights")
    if not all(type(weight) in (int, float) and abs(weight) < 1e100 for weight in weights):
        raise GeometryReadError("damaged: weights of a mesh must be numbers")
    return tuple(map(float, weights))


def _all_or_none(values: list[Float64Array | None]) -> Float64Array | None:
    given = [value for value in values if value is not None]
    return np.concatenate(given) if len(given) == len(values) else None


def _faces(flat: IntArray, mode: int) -> IntArray:
    if mode == _TRIANGLES:
        if len(flat) % 3:
            raise GeometryReadError(f"damaged: {len(flat)} indices are not triangles")
        return flat.reshape(-1, 3)
    a, b, c = (np.full(max(0, len(flat) - 2), flat[0]) if mode == _FAN else flat[:-2]), flat[1:-1], flat[2:]
    if mode == _FAN:
        return np.stack([a, b, c], axis=1)
    odd = np.arange(len(a)) % 2 == 1
    strip = np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)
    return cast(IntArray, strip[(a != b) & (b != c) & (a != c)])
