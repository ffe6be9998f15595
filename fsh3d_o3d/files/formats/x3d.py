"""X3D in XML: the faces of its shapes, placed by their transforms."""

from __future__ import annotations

import re
from collections.abc import Iterator

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

_FACES = (
    "IndexedFaceSet",
    "IndexedTriangleSet",
    "IndexedTriangleStripSet",
    "IndexedTriangleFanSet",
    "IndexedQuadSet",
    "TriangleSet",
    "QuadSet",
)
# Forms that stand for a surface which a reader has to make up.
_MADE_UP = ("Box", "Sphere", "Cylinder", "Cone", "ElevationGrid", "Extrusion", "Text", "NurbsPatchSurface")
_LINES = ("IndexedLineSet", "LineSet")
_GROUPS = ("Scene", "Group", "StaticGroup", "Transform", "Collision", "Anchor", "Billboard", "LOD", "Switch", "Shape")
_SEPARATORS = re.compile(r"[\s,]+")  # between numbers
_MOST_PLACED = 65_536  # shapes, a choice: groups that use each other twice would double without end
_DEEPEST = 150  # groups one in another, a choice


def parse_x3d(source: Source) -> MeshArrays | PointArrays:
    """Return the faces of all shapes of the scene: each once for each of its places."""
    root = xml_root(source.data)
    if root.name != "X3D":
        raise GeometryReadError(f"it holds '{root.name[:30]}', not X3D")
    scene = root.find("Scene")
    if scene is None:
        raise GeometryReadError("truncated or damaged: its scene is missing")
    named = {element.attributes["DEF"]: element for element in scene.below() if "DEF" in element.attributes}
    assembly = Assembly(source)
    passed: dict[str, int] = {}
    for number, (shape, place) in enumerate(_shapes(scene, named)):
        if number > _MOST_PLACED:
            raise GeometryReadError(f"it places more than {_MOST_PLACED} shapes")
        for child in [_used(one, named) for one in shape.children]:
            if child.name in _FACES:
                vertices, triangles = _surface(source, child, named)
                name = shape.attributes.get("DEF") or f"shape {number}"
                assembly.add_mesh(name, vertices, triangles, place)
            elif child.name == "PointSet":
                points = _coordinates(child, named)
                assembly.add_cloud(f"shape {number}", points @ place[:, :3].T + place[:, 3])
            elif child.name in (*_MADE_UP, *_LINES):
                passed[child.name] = passed.get(child.name, 0) + 1
    for kind, count in passed.items():
        source.note(f"{counted(count, 'shape')} of kind {kind} passed over")
    inline = sum(element.name == "Inline" for element in scene.below())
    if inline:
        source.note(f"{counted(inline, 'other file')} that it names passed over")
    return assembly.result()


def _used(element: XmlElement, named: dict[str, XmlElement]) -> XmlElement:
    """Return the element itself, or the one that it uses again."""
    name = element.attributes.get("USE")
    if name is None:
        return element
    if name not in named:
        raise GeometryReadError(f"damaged: it uses '{name[:40]}', which is not defined")
    return named[name]


def _shapes(scene: XmlElement, named: dict[str, XmlElement]) -> Iterator[tuple[XmlElement, Float64Array]]:
    """Yield the shapes of the scene, and where each is placed."""
    stack = [(scene, IDENTITY, 0)]
    steps = 0
    while stack:
        element, place, depth = stack.pop()
        steps += 1
        if depth > _DEEPEST or steps > 4 * _MOST_PLACED:
            raise GeometryReadError("damaged: its groups hold themselves, or place far too much")
        if element.name == "Shape":
            yield element, place
            continue
        if element.name == "Transform":
            place = composed(place, _transform(element))
            if not is_finite(place):
                raise GeometryReadError("damaged: a transform is not finite")
        children = [_used(child, named) for child in element.children if child.name in _GROUPS]
        if element.name in ("LOD", "Switch"):
            chosen = 0 if element.name == "LOD" else int(_vector(element, "whichChoice", "-1", 1)[0])
            children = children[chosen : chosen + 1] if chosen >= 0 else []
        stack += [(child, place, depth + 1) for child in children[::-1]]


def _transform(element: XmlElement) -> Float64Array:
    move = _vector(element, "translation", "0 0 0", 3)
    centre = _vector(element, "center", "0 0 0", 3)
    turn = _vector(element, "rotation", "0 0 1 0", 4)
    scale = _vector(element, "scale", "1 1 1", 3)
    slant = _vector(element, "scaleOrientation", "0 0 1 0", 4)
    return composed(
        translation(move + centre),
        rotation(turn[:3], turn[3]),
        rotation(slant[:3], slant[3]),
        scaling(scale),
        rotation(slant[:3], -slant[3]),
        translation(-centre),
    )


def _surface(source: Source, element: XmlElement, named: dict[str, XmlElement]) -> tuple[Float64Array, IntArray]:
    points = _coordinates(element, named)
    if element.name == "IndexedFaceSet":
        listed = _indices(element, "coordIndex")
        polygons, starts, counts = _between(listed)
    elif element.name in ("TriangleSet", "QuadSet", "IndexedTriangleSet", "IndexedQuadSet"):
        width = 4 if "Quad" in element.name else 3
        polygons = _indices(element, "index") if element.name.startswith("Indexed") else np.arange(len(points))
        if len(polygons) % width:
            raise GeometryReadError(f"truncated or damaged: {len(polygons)} corners of faces of {width}")
        starts, counts = np.arange(0, len(polygons), width), np.full(len(polygons) // width, width)
    else:
        listed = _indices(element, "index")
        corners, begins, sizes = _between(listed)
        each = np.maximum(sizes - 2, 0)
        place = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
        begin = np.repeat(begins, each)
        odd = place % 2
        strip = "Strip" in element.name
        first, second = (begin + place + odd, begin + place + 1 - odd) if strip else (begin, begin + place + 1)
        polygons = corners[np.stack([first, second, begin + place + 2], axis=1)].ravel()
        starts, counts = np.arange(0, len(polygons), 3), np.full(len(polygons) // 3, 3)
    triangles = cut_polygons(source, points, polygons, starts, counts)
    if element.attributes.get("ccw", "true").strip().lower() == "false":
        triangles = triangles[:, ::-1]
    return points, triangles


def _between(listed: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return lists that end with −1, the last one perhaps without: the numbers, where each begins, how many it has."""
    if len(listed) and listed[-1] != -1:
        listed = np.append(listed, -1)
    ends = np.flatnonzero(listed == -1)
    starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)[: len(ends)]
    counts = ends - starts
    filled = counts > 0
    return listed, starts[filled], counts[filled]


def _coordinates(element: XmlElement, named: dict[str, XmlElement]) -> Float64Array:
    for child in [_used(one, named) for one in element.children]:
        if child.name in ("Coordinate", "CoordinateDouble"):
            values = _values(child, "point")
            if len(values) % 3:
                raise GeometryReadError(f"truncated or damaged: {len(values)} coordinates")
            return values.reshape(-1, 3)
    raise GeometryReadError(f"damaged: a shape of kind {element.name} has no coordinates")


def _values(element: XmlElement, name: str) -> Float64Array:
    return numbers(_SEPARATORS.sub(" ", element.attributes.get(name, "")).encode("utf-8"))


def _vector(element: XmlElement, name: str, default: str, size: int) -> Float64Array:
    values = numbers(_SEPARATORS.sub(" ", element.attributes.get(name, default)).encode("utf-8"))
    if len(values) != size:
        raise GeometryReadError(f"damaged: '{name}' has {len(values)} numbers instead of {size}")
    return values


def _indices(element: XmlElement, name: str) -> IntArray:
    return indices(_values(element, name), "indices")
