"""The scene of a glTF file: which meshes it places, how often and where."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.accessors import GltfAccessors
from fsh3d_o3d.files.formats.gltf.document import GltfDocument, extension, listed
from fsh3d_o3d.files.formats.gltf.transforms import composed, instance_transforms, local_transforms

_INSTANCING = "EXT_mesh_gpu_instancing"
_INSTANCED_BY = {"TRANSLATION": ("VEC3",), "ROTATION": ("VEC4",), "SCALE": ("VEC3",)}


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh in one form, and the nodes that place it."""

    mesh: int
    """Its index."""
    weights: tuple[float, ...] | None
    """Weights of its morph targets, where nodes state others than the mesh."""
    skin: int | None
    """The skin that places its vertices; then the nodes do not."""
    nodes: list[int] = field(default_factory=list)
    """Nodes that place it once."""
    instanced: list[int] = field(default_factory=list)
    """Nodes that place it several times."""


class GltfScene:
    """The nodes of the scene, walked level by level: neither deep chains nor a million roots take long."""

    def __init__(self, document: GltfDocument, accessors: GltfAccessors) -> None:
        """Find what is placed.

        Raises:
            GeometryReadError: The nodes are damaged or do not form a tree.
        """
        self._document = document
        self._accessors = accessors
        self._position: dict[int, int] = {}
        self._transforms = np.empty((0, 3, 4))
        self._parents: dict[int, int] | None = None
        self._elsewhere: dict[int, Float64Array] = {}
        if document.entries("nodes"):
            self.placed = self._walk(self._roots())
        else:
            meshes = range(len(document.entries("meshes")))
            self.placed = [PlacedMesh(index, None, None, nodes=[-1]) for index in meshes]
            self._position, self._transforms = {-1: 0}, np.eye(3, 4)[None]

    def transforms(self, nodes: list[int]) -> Float64Array:
        """Return the transforms of nodes to the scene, (n, 3, 4); they need not belong to it themselves."""
        return np.array([self._transform(node) for node in nodes]).reshape(-1, 3, 4)

    def count(self, placed: PlacedMesh) -> int:
        """Return how often a mesh is placed, without placing it."""
        return len(placed.nodes) + sum(self._instances(node) for node in placed.instanced)

    def placements(self, placed: PlacedMesh) -> Float64Array:
        """Return the transforms (k, 3, 4) that place a mesh."""
        own = self._transforms[[self._position[node] for node in placed.nodes]]
        return np.concatenate([own, *(self._instanced(node) for node in placed.instanced)])

    def _roots(self) -> list[Any]:
        document = self._document
        scenes = document.entries("scenes")
        if scenes:
            chosen = document.tree.get("scene", 0)
            if len(scenes) > 1:
                document.source.note(f"of {len(scenes)} scenes only scene {chosen} was read")
            return listed(document.entry("scenes", chosen), "nodes")
        nodes = range(len(document.entries("nodes")))
        below = self._parent_of()
        return [index for index in nodes if index not in below]

    def _walk(self, level: list[Any]) -> list[PlacedMesh]:
        found: list[dict[str, Any]] = []
        parents: list[int] = []  # positions in the walk
        ends: list[int] = []
        above, hidden = [-1] * len(level), 0
        visible: list[bool] = []
        while level:
            begin = len(found)
            for index, parent in zip(level, above, strict=True):
                node = self._document.entry("nodes", index)
                if index in self._position:  # the format asks for a tree; else a small file could unfold without end
                    raise GeometryReadError(f"damaged: node {index} has two parents")
                self._position[index] = len(found)
                shown = (extension(node, "KHR_node_visibility") or {}).get("visible") is not False
                visible.append(shown and (parent < 0 or visible[parent]))
                found.append(node)
                parents.append(parent)
            ends.append(len(found))
            families = [(position, listed(found[position], "children")) for position in range(begin, len(found))]
            level = [child for _, children in families for child in children]
            above = [position for position, children in families for _ in children]
        self._transforms = local_transforms(self._document.source, found)
        for begin, end in pairwise(ends):
            outer = self._transforms[parents[begin:end]]
            self._transforms[begin:end] = composed(outer, self._transforms[begin:end])
        placed: dict[tuple[Any, ...], PlacedMesh] = {}
        for index, position in self._position.items():
            if "mesh" in found[position]:
                if visible[position]:
                    self._place(placed, index, found[position])
                else:
                    hidden += 1
        if hidden:
            self._document.source.note(f"hidden nodes were left out: {hidden} with a mesh")
        return list(placed.values())

    def _place(self, placed: dict[tuple[Any, ...], PlacedMesh], index: int, node: dict[str, Any]) -> None:
        mesh, skin, weights = node["mesh"], node.get("skin"), node.get("weights")
        self._document.entry("meshes", mesh)
        if skin is not None:
            self._document.entry("skins", skin)
        key = (mesh, skin, None if weights is None else tuple(map(_number, listed(node, "weights"))))
        if key not in placed:
            placed[key] = PlacedMesh(mesh, key[2], skin)
        if extension(node, _INSTANCING) is None:
            placed[key].nodes.append(index)
        elif skin is None:
            placed[key].instanced.append(index)
        else:
            self._document.source.note("instances of a mesh with a skin are not defined; it was placed once")
            placed[key].nodes.append(index)

    def _instancing(self, node: int) -> dict[str, Any]:
        content = extension(self._document.entry("nodes", node), _INSTANCING) or {}
        attributes = content.get("attributes")
        return attributes if isinstance(attributes, dict) else {}

    def _instances(self, node: int) -> int:
        """How often a node places its mesh: as often as each of its attributes has items."""
        counts = {self._accessors.count(accessor) for accessor in self._instancing(node).values()}
        if len(counts) > 1:
            raise GeometryReadError(f"damaged: the instances of node {node} have attributes of different length")
        return counts.pop() if counts else 1

    def _instanced(self, node: int) -> Float64Array:
        attributes = self._instancing(node)
        given = {
            name: self._accessors.numbers(attributes[name], kinds) if name in attributes else None
            for name, kinds in _INSTANCED_BY.items()
        }
        inner = instance_transforms(
            self._document.source, self._instances(node), given["TRANSLATION"], given["ROTATION"], given["SCALE"]
        )
        return composed(self._transforms[self._position[node]], inner)

    def _transform(self, node: int) -> Float64Array:
        """One node's; of those that the scene does not reach, parents are looked up until one is known."""
        chain: list[int] = []
        parents = {} if node in self._position else self._parent_of()
        at: int | None = node
        while at is not None and at not in self._position and at not in self._elsewhere:
            chain.append(at)
            at = parents.get(at)
            if len(chain) > len(parents) + 1:
                raise GeometryReadError(f"damaged: node {node} is above itself")
        local = local_transforms(self._document.source, [self._document.entry("nodes", index) for index in chain])
        result = self._known(at)
        for index, inner in zip(chain[::-1], local[::-1], strict=True):
            result = self._elsewhere[index] = composed(result, inner)
        return result

    def _known(self, node: int | None) -> Float64Array:
        if node is None:
            return np.eye(3, 4)
        return self._elsewhere[node] if node in self._elsewhere else self._transforms[self._position[node]]

    def _parent_of(self) -> dict[int, int]:
        """Each node's parent, where it has one, whether or not the scene reaches it."""
        if self._parents is None:
            entries = [self._document.entry("nodes", index) for index in range(len(self._document.entries("nodes")))]
            families = ((index, listed(node, "children")) for index, node in enumerate(entries))
            self._parents = {child: index for index, below in families for child in below if isinstance(child, int)}
        return self._parents


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e100:
        raise GeometryReadError("damaged: weights of a node must be numbers")
    return float(value)
