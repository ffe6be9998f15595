"""FBX from version 7 on: the meshes of its models, where these stand while nothing is animated."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.fbx_tree import FbxRecord, fbx_records
from fsh3d_o3d.files.formats.polygons import cut_polygons
from fsh3d_o3d.files.formats.scene_transforms import IDENTITY, composed, is_finite, rotation, scaling, translation
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.files.formats.text import indices
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_OLDEST = 7000  # version: before, meshes stand inside of their models
_ORDERS = ("xyz", "xzy", "yzx", "yxz", "zxy", "zyx")  # in which axes are turned about, by the number in the file
_AXES = {axis: np.eye(3)[place] for place, axis in enumerate("xyz")}
_DEEPEST = 200  # models one below another, a choice

Properties = dict[str, Float64Array]


def parse_fbx(source: Source) -> MeshArrays | PointArrays:
    """Return the meshes of a file, each once for each model that shows it, in the units and axes of the file."""
    version, root = fbx_records(source.data)
    if version < _OLDEST:
        raise GeometryReadError(f"its version is {version}; those from {_OLDEST} on (FBX 2011) are read: save it anew")
    objects, connections = root.find("Objects"), root.find("Connections")
    if objects is None:
        raise GeometryReadError("it holds no objects")
    unit = _properties(root.find("GlobalSettings") or FbxRecord("")).get("UnitScaleFactor", np.ones(1))
    if unit[0] != 1:
        source.note(f"its coordinates are in units of {unit[0]:g} cm, and stay so")
    by_key = {_key(record): record for record in objects.children if record.name in ("Geometry", "Model")}
    parents: dict[float, list[float]] = {}
    for link in [] if connections is None else connections.children:
        if len(link.values) >= 3 and link.values[0] == "OO" and not isinstance(link.values[2], str):
            parents.setdefault(_number(link.values[1]), []).append(_number(link.values[2]))
    assembly = Assembly(source)
    others = 0
    for key, record in by_key.items():
        if record.name != "Geometry" or record.array("PolygonVertexIndex") is None:
            others += record.name == "Geometry"
            continue
        mesh = _mesh(source, record)
        owners: list[float | None] = [
            one for one in parents.get(key, []) if one in by_key and by_key[one].name == "Model"
        ]
        for owner in owners or [None]:
            place = IDENTITY if owner is None else _placement(owner, by_key, parents)
            name = _name(record if owner is None else by_key[owner])
            assembly.add_mesh(name, *mesh, place)
    if others:
        source.note(f"{counted(others, 'geometry', 'geometries')} that are no meshes passed over")
    return assembly.result()


def _mesh(source: Source, record: FbxRecord) -> tuple[Float64Array, IntArray]:
    places, listed = record.array("Vertices"), record.array("PolygonVertexIndex")
    if places is None or listed is None or len(places) % 3:
        raise GeometryReadError(f"truncated or damaged: the vertices of '{_name(record)}' are not whole")
    corners = indices(listed, "vertex indices")
    ends = np.flatnonzero(corners < 0)  # the last corner of each polygon is kept as −1 − its index
    if not len(ends) or ends[-1] != len(corners) - 1:
        raise GeometryReadError(f"truncated or damaged: the last polygon of '{_name(record)}' has no end")
    starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)
    corners = np.where(corners < 0, -1 - corners, corners)
    vertices = places.reshape(-1, 3)
    return vertices, cut_polygons(source, vertices, corners, starts, ends + 1 - starts)


def _placement(owner: float, by_key: dict[float, FbxRecord], parents: dict[float, list[float]]) -> Float64Array:
    """Return where a model stands, and its geometry in it."""
    own = _properties(by_key[owner])
    result = composed(_turned(own, "Geometric"), IDENTITY)
    at: float | None = owner
    for _ in range(_DEEPEST):
        if at is None:
            break
        result = composed(_local(_properties(by_key[at])), result)
        above = [key for key in parents.get(at, []) if key in by_key and by_key[key].name == "Model"]
        at = above[0] if above else None
    else:
        raise GeometryReadError("damaged: a model is above itself")
    if not is_finite(result):
        raise GeometryReadError("damaged: where a model stands is not finite")
    return result


def _turned(own: Properties, prefix: str) -> Float64Array:
    return composed(
        translation(_vector(own, f"{prefix}Translation")),
        _euler(_vector(own, f"{prefix}Rotation"), "xyz"),
        scaling(_vector(own, f"{prefix}Scaling", 1.0)),
    )


def _local(own: Properties) -> Float64Array:
    """Return the transform of a model to the one above: offsets and pivots of turn and scale among it."""
    active = bool(own.get("RotationActive", np.zeros(1))[0])
    order = int(own.get("RotationOrder", np.zeros(1))[0]) if active else 0
    if not 0 <= order < len(_ORDERS):
        raise GeometryReadError("a model is turned in an order that is not read")
    pivot, scale_pivot = _vector(own, "RotationPivot"), _vector(own, "ScalingPivot")
    none = np.zeros(3)
    after = _euler(_vector(own, "PostRotation") if active else none, "xyz")
    undone = np.hstack([after[:, :3].T, np.zeros((3, 1))])
    return composed(
        translation(_vector(own, "Lcl Translation") + _vector(own, "RotationOffset") + pivot),
        _euler(_vector(own, "PreRotation") if active else none, "xyz"),
        _euler(_vector(own, "Lcl Rotation"), _ORDERS[order]),
        undone,
        translation(_vector(own, "ScalingOffset") + scale_pivot - pivot),
        scaling(_vector(own, "Lcl Scaling", 1.0)),
        translation(-scale_pivot),
    )


def _euler(degrees: Float64Array, order: str) -> Float64Array:
    """Return the turn about the axes in an order, the first one first."""
    turns = [rotation(_AXES[axis], np.radians(degrees["xyz".index(axis)])) for axis in order]
    return composed(*turns[::-1])


def _properties(record: FbxRecord) -> Properties:
    table = record.find("Properties70")
    found: Properties = {}
    for entry in [] if table is None else table.children:
        numbers = [value for value in entry.values[4:] if isinstance(value, (int, float))]
        numbers += [number for value in entry.values[4:] if isinstance(value, np.ndarray) for number in value.tolist()]
        if entry.values and isinstance(entry.values[0], str) and numbers:
            found[entry.values[0]] = np.array(numbers, dtype=np.float64)
    return found


def _vector(own: Properties, name: str, default: float = 0.0) -> Float64Array:
    value = own.get(name)
    if value is None:
        return np.full(3, default)
    if len(value) != 3:
        raise GeometryReadError(f"damaged: '{name}' of a model has {len(value)} numbers")
    return value


def _key(record: FbxRecord) -> float:
    return _number(record.values[0]) if record.values else np.nan


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else np.nan


def _name(record: FbxRecord) -> str:
    text = record.values[1] if len(record.values) > 1 and isinstance(record.values[1], str) else ""
    return text.partition("\0\x01")[0].removeprefix("Model::").removeprefix("Geometry::") or record.name
