"""3MF: components and build items, placed as they are to be printed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.encoding import plain_text
from fsh3d_o3d.files.formats.scene_transforms import IDENTITY, composed
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import indices, numbers
from fsh3d_o3d.files.formats.xml_numbers import cut_lists, element_numbers
from fsh3d_o3d.files.formats.xml_tree import XmlElement, xml_root
from fsh3d_o3d.files.formats.zip_parts import ZipParts
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_MODEL = "/3dmodel"  # how the type of the relation ends that leads to the model
# Extensions that add to the core what a surface does not need, or that are read; others change what is meant.
_UNDERSTOOD = ("/core/", "/production/", "/material/", "/slice/", "/trianglesets/")
_DEEPEST = 64  # components one in another, a choice: assemblies have some five
_MOST_PLACED = 65_536  # meshes, a choice: components that hold each other twice would double without end

_Key = tuple[str, str]


@dataclass
class _Object:
    """An object of a model file."""

    name: str
    kind: str
    mesh: tuple[Float64Array, IntArray] | None = None
    components: list[tuple[_Key, Float64Array]] = field(default_factory=list)


def parse_3mf(source: Source) -> MeshArrays | PointArrays:
    """Return what a 3MF file builds: each mesh once for each of its places, in the units of the file."""
    package = _Package(source)
    assembly = Assembly(source)
    items = package.items()
    if not items:
        raise GeometryReadError("it builds nothing: there are no items in its list of what to build")
    placed = supports = 0
    stack = [(key, place, 0) for key, place in items[::-1]]
    while stack:
        key, place, depth = stack.pop()
        found = package.found(key)
        if depth > _DEEPEST:
            raise GeometryReadError(f"damaged: components are nested more than {_DEEPEST} deep, or hold themselves")
        if found.kind in ("support", "solidsupport"):
            supports += 1
            continue
        if found.mesh is not None:
            placed += 1
            if placed > _MOST_PLACED:
                raise GeometryReadError(f"it places more than {_MOST_PLACED} meshes")
            assembly.add_mesh(found.name, *found.mesh, place)
            continue
        if len(stack) > _MOST_PLACED:
            raise GeometryReadError(f"it places more than {_MOST_PLACED} meshes")
        stack += [(inner, composed(place, local), depth + 1) for inner, local in found.components[::-1]]
    if supports:
        source.note(f"{counted(supports, 'support')} of the print left out")
    return assembly.result()


class _Package:
    """The model files of a 3MF package."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._parts = ZipParts(source.data)
        self._objects: dict[_Key, _Object] = {}
        self._loaded: set[str] = set()
        self._root = self._root_name()

    def items(self) -> list[tuple[_Key, Float64Array]]:
        """Return what is built, and where."""
        model = self._load(self._root)
        unit = model.attributes.get("unit", "millimeter")
        if unit != "millimeter":
            self._source.note(f"its coordinates are in the unit '{unit[:20]}', and stay so")
        build = model.find("build")
        return [] if build is None else [self._reference(item, self._root) for item in build.all("item")]

    def found(self, key: _Key) -> _Object:
        """Return an object."""
        if key[0] not in self._loaded:
            self._load(key[0])
        if key not in self._objects:
            raise GeometryReadError(f"damaged: it refers to object {key[1][:20]}, which is not there")
        return self._objects[key]

    def _root_name(self) -> str:
        names = {name.lower(): name for name in self._parts.names}
        relations = names.get("_rels/.rels")
        if relations is None:
            raise GeometryReadError("it is a ZIP file, but no 3MF: '_rels/.rels' is missing")
        for relation in xml_root(self._text(relations), "'_rels/.rels'").all("Relationship"):
            if relation.attributes.get("Type", "").endswith(_MODEL):
                name = relation.attributes.get("Target", "").lstrip("/")
                if name.lower() in names:
                    return names[name.lower()]
                raise GeometryReadError(f"damaged: its model '{name[:80]}' is missing")
        raise GeometryReadError("it is a ZIP file, but no 3MF: it names no model")

    def _text(self, name: str) -> bytes:
        return plain_text(Source(self._parts.content(name)))

    def _load(self, name: str) -> XmlElement:
        self._loaded.add(name)
        skeleton, pieces = cut_lists(self._text(name), ("vertices", "triangles"))
        model = xml_root(skeleton, f"'{name[:80]}'")
        if model.name != "model":
            raise GeometryReadError(f"damaged: '{name[:80]}' holds '{model.name[:20]}' instead of a model")
        for prefix in model.attributes.get("requiredextensions", "").split():
            extension = model.attributes.get(f"xmlns:{prefix}", prefix)
            if not any(known in extension for known in _UNDERSTOOD):
                raise GeometryReadError(f"it requires an extension that is not read: {extension[:100]}")
        resources = model.find("resources")
        for element in [] if resources is None else resources.all("object"):
            number = element.attributes.get("id", "")
            if (name, number) in self._objects:
                raise GeometryReadError(f"damaged: two objects have the number {number[:20]}")
            self._objects[name, number] = self._object(name, number, element, pieces)
        return model

    def _object(self, file: str, number: str, element: XmlElement, pieces: list[bytes]) -> _Object:
        found = _Object(
            element.attributes.get("name") or f"object {number}", element.attributes.get("type", "model").lower()
        )
        mesh, components = element.find("mesh"), element.find("components")
        if mesh is not None:
            if mesh.find("beamlattice") is not None:
                raise GeometryReadError(f"object {number[:20]} is a lattice of beams, which are not read")
            vertices = element_numbers(_piece(mesh, "vertices", pieces), "vertex", ("x", "y", "z"))
            corners = element_numbers(_piece(mesh, "triangles", pieces), "triangle", ("v1", "v2", "v3"))
            found.mesh = vertices, indices(corners, "vertex indices")
        elif components is not None:
            found.components = [self._reference(part, file) for part in components.all("component")]
        return found

    def _reference(self, element: XmlElement, file: str) -> tuple[_Key, Float64Array]:
        path = element.attributes.get("path", "").lstrip("/") or file
        text = element.attributes.get("transform")
        place = IDENTITY if text is None else _transform(text)
        return (path, element.attributes.get("objectid", "")), place


def _piece(mesh: XmlElement, name: str, pieces: list[bytes]) -> bytes:
    element = mesh.find(name)
    number = "" if element is None else element.attributes.get("piece", "")
    if not number.isdecimal() or int(number) >= len(pieces):
        raise GeometryReadError(f"damaged: a mesh has no {name}")
    return pieces[int(number)]


def _transform(text: str) -> Float64Array:
    """Return (3, 4) for the twelve numbers of a transform of rows: the last three move."""
    values = numbers(text.encode("utf-8"))
    if len(values) != 12 or not np.isfinite(values).all():
        raise GeometryReadError(f"damaged: a transform has {len(values)} numbers instead of 12 finite ones")
    return np.ascontiguousarray(values.reshape(4, 3).T)
