"""COLLADA (.dae): the meshes of its scene, placed by its nodes, in metres with y or z up as the file has them."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.polygons import cut_polygons
from fsh3d_o3d.files.formats.scene_transforms import IDENTITY, composed, is_finite, rotation, scaling, translation
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import indices, numbers
from fsh3d_o3d.files.formats.xml_tree import XmlElement, xml_root
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_SIZES = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9, "skew": 7}
_MOST_PLACED = 65_536  # geometries, a choice: nodes that hold each other twice would double without end
_DEEPEST = 100  # nodes one in another, a choice


def parse_dae(source: Source) -> MeshArrays | PointArrays:
    """Return the scene of a COLLADA file: each geometry once for each of its places, in the units of the file."""
    return _Document(source, xml_root(source.data)).scene()


class _Document:
    """A file, and what of it is known by its ids."""

    def __init__(self, source: Source, root: XmlElement) -> None:
        if root.name != "COLLADA":
            raise GeometryReadError(f"it holds '{root.name[:30]}', not COLLADA")
        self._source, self._root = source, root
        self._by_id = {element.attributes["id"]: element for element in root.below() if "id" in element.attributes}
        self._meshes: dict[str, list[tuple[Float64Array, IntArray]]] = {}
        self._skins = 0

    def scene(self) -> MeshArrays | PointArrays:
        """Return what the scene places; where there is no scene, each geometry as it is."""
        unit = next((e for e in self._root.below() if e.name == "unit"), None)
        meter = "1" if unit is None else unit.attributes.get("meter", "1")
        if meter.strip() not in ("1", "1.0"):
            self._source.note(f"its coordinates are in units of {meter[:20]} m, and stay so")
        assembly = Assembly(self._source)
        placed = self._placed()
        for key, place in placed:
            for vertices, triangles in self._mesh(key):
                assembly.add_mesh(self._by_id[key].attributes.get("name") or key, vertices, triangles, place)
        if self._skins:
            self._source.note(f"{counted(self._skins, 'skin')} read in the shape that it has without its bones")
        return assembly.result()

    def _placed(self) -> list[tuple[str, Float64Array]]:
        scene = self._root.find("scene")
        instance = None if scene is None else scene.find("instance_visual_scene")
        if instance is None:
            return [(key, IDENTITY) for key, element in self._by_id.items() if element.name == "geometry"]
        top = self._linked(instance)
        found: list[tuple[str, Float64Array]] = []
        stack = [(node, IDENTITY, 0) for node in list(top.all("node"))[::-1]]
        steps = 0
        while stack:
            node, outer, depth = stack.pop()
            steps += 1
            if depth > _DEEPEST or steps > _MOST_PLACED or len(found) > _MOST_PLACED:
                raise GeometryReadError("damaged: its nodes hold themselves, or place far too much")
            place = composed(outer, self._transform(node))
            below = []
            for child in node.children:
                if child.name == "node":
                    below.append((child, place, depth + 1))
                elif child.name == "instance_node":
                    below.append((self._linked(child), place, depth + 1))
                elif child.name == "instance_geometry":
                    found.append((child.attributes.get("url", "").lstrip("#"), place))
                elif child.name == "instance_controller":
                    found.append((self._skinned(self._linked(child)), place))
            stack += below[::-1]
        return found

    def _skinned(self, controller: XmlElement) -> str:
        self._skins += 1
        for _ in range(8):  # a skin of a morph, at most
            part = controller.find("skin") or controller.find("morph")
            key = "" if part is None else part.attributes.get("source", "").lstrip("#")
            found = self._by_id.get(key)
            if found is None:
                break
            if found.name == "geometry":
                return key
            controller = found
        raise GeometryReadError("damaged: a skin has no geometry")

    def _linked(self, element: XmlElement) -> XmlElement:
        key = element.attributes.get("url", "")
        found = self._by_id.get(key[1:])
        if not key.startswith("#") or found is None:
            raise GeometryReadError(f"it refers to '{key[:60]}', which is not in the file")
        return found

    def _transform(self, node: XmlElement) -> Float64Array:
        result = IDENTITY
        for element in node.children:
            if element.name in _SIZES:
                result = composed(result, _local(element))
        if not is_finite(result):
            raise GeometryReadError("damaged: a transform of a node is not finite")
        return result

    def _mesh(self, key: str) -> list[tuple[Float64Array, IntArray]]:
        if key not in self._by_id or self._by_id[key].name != "geometry":
            raise GeometryReadError(f"it places the geometry '{key[:60]}', which is not in the file")
        if key not in self._meshes:
            mesh = self._by_id[key].find("mesh")
            if mesh is None:
                self._source.note(f"geometry '{key[:40]}' is no mesh; it was passed over")
            self._meshes[key] = [] if mesh is None else self._primitives(mesh)
        return self._meshes[key]

    def _primitives(self, mesh: XmlElement) -> list[tuple[Float64Array, IntArray]]:
        """Return the vertices once, with the polygons of all lists; none where there are none."""
        found: dict[str, list[IntArray]] = {}
        for element in mesh.children:
            if element.name in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
                key, polygons, counts = self._polygons(element)
                if not len(counts):
                    continue
                vertices = self._positions(key)
                starts = np.cumsum(counts) - counts
                found.setdefault(key, []).append(cut_polygons(self._source, vertices, polygons, starts, counts))
        return [(self._positions(key), np.concatenate(lists)) for key, lists in found.items()]

    def _polygons(self, element: XmlElement) -> tuple[str, IntArray, IntArray]:
        inputs = [(child.attributes.get("semantic", ""), child) for child in element.all("input")]
        offsets = {name: _number(child, "offset") for name, child in inputs}
        vertex = next((child for name, child in inputs if name == "VERTEX"), None)
        if vertex is None:
            raise GeometryReadError("damaged: a list of polygons has no vertices")
        stride = max(_number(child, "offset") for _, child in inputs) + 1
        lists = [_indices(child) for child in element.all("p")]
        if any(len(listed) % stride for listed in lists):
            raise GeometryReadError(f"truncated or damaged: corners of {stride} numbers break off")
        corners = [listed[offsets["VERTEX"] :: stride] for listed in lists]
        count = _number(element, "count")
        if element.name in ("tristrips", "trifans"):
            parts = [_fanned(part, strip=element.name == "tristrips") for part in corners]
            polygons = np.concatenate([*parts, np.empty(0, dtype=np.int64)])
            counts = np.full(len(polygons) // 3, 3)
        elif element.name == "polygons":
            polygons = np.concatenate([*corners, np.empty(0, dtype=np.int64)])
            counts = np.array([len(part) for part in corners], dtype=np.int64)
        else:
            polygons = np.concatenate([*corners, np.empty(0, dtype=np.int64)])
            listed = element.find("vcount")
            counts = np.full(count, 3) if listed is None else _indices(listed)
            if len(counts) != count or counts.sum() != len(polygons) or (counts < 1).any():
                raise GeometryReadError(
                    f"truncated or damaged: {count} polygons are announced, and {len(polygons)} corners are there"
                )
        return vertex.attributes.get("source", "").lstrip("#"), polygons, counts

    def _positions(self, key: str) -> Float64Array:
        vertices = self._by_id.get(key)
        position = (
            None
            if vertices is None
            else next(
                (child for child in vertices.all("input") if child.attributes.get("semantic") == "POSITION"), None
            )
        )
        found = None if position is None else self._by_id.get(position.attributes.get("source", "").lstrip("#"))
        array = None if found is None else found.find("float_array")
        if found is None or array is None:
            raise GeometryReadError(f"damaged: the positions of '{key[:40]}' are missing")
        values = numbers(array.text.encode("utf-8"))
        if len(values) != _number(array, "count", len(values)) or len(values) % 3:
            raise GeometryReadError(f"truncated or damaged: {len(values)} coordinates of '{key[:40]}'")
        return values.reshape(-1, 3)


def _local(element: XmlElement) -> Float64Array:
    values = numbers(element.text.encode("utf-8"))
    if len(values) != _SIZES[element.name]:
        raise GeometryReadError(f"damaged: '{element.name}' has {len(values)} numbers")
    match element.name:
        case "matrix":
            return values.reshape(4, 4)[:3]
        case "translate":
            return translation(values)
        case "scale":
            return scaling(values)
        case "rotate":
            return rotation(values[:3], np.radians(values[3]))
    raise GeometryReadError(f"a node is placed by '{element.name}', which is not read")


def _fanned(corners: IntArray, *, strip: bool) -> IntArray:
    """Return the triangles of a strip or a fan as one list."""
    place = np.arange(max(0, len(corners) - 2))
    odd = place % 2
    first, second = (place + odd, place + 1 - odd) if strip else (np.zeros_like(place), place + 1)
    return np.asarray(corners[np.stack([first, second, place + 2], axis=1)].ravel())


def _indices(element: XmlElement) -> IntArray:
    return indices(numbers(element.text.encode("utf-8")), "indices")


def _number(element: XmlElement, name: str, default: int = 0) -> int:
    text = element.attributes.get(name, str(default)).strip()
    if not text.isascii() or not text.isdecimal() or len(text) > 15:
        raise GeometryReadError(f"damaged: '{text[:20]}' of '{name}' should be a whole number")
    return int(text)
