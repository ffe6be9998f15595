"""Named functions that go with a shape, such as colours: checks, and how they are stored."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.geometry import COLORS, TEXTURE_UVS, MeshArrays, PointArrays, bare
from fsh3d_o3d.shapes import storage

_RESERVED = ("positions", "normals", "indices")  # what a mesh already calls its own


def checked_name(name: object) -> str:
    """Return the name of an attribute."""
    if not isinstance(name, str):
        raise TypeError(f"an attribute's name must be text, got {name!r}")
    if not name.isprintable() or not name.strip() or name in _RESERVED:
        raise ValueError(f"an attribute must have a printable name other than {', '.join(_RESERVED)}, got {name!r}")
    return name


def checked_coefficients(attributes: object, shape: tuple[int, ...]) -> Mapping[str, Float64Array]:
    """Return attributes, arrays of the shape of one function's coefficients or (k, …), read-only, by name."""
    if not isinstance(attributes, Mapping):
        raise TypeError(f"attributes must be a mapping of names to arrays, got {type(attributes).__name__}")
    result = {}
    one = "b²" if len(shape) == 1 else "S, b²"
    for key, value in attributes.items():
        name = checked_name(key)
        array = check.real_array(value, f"attribute {name!r}")
        if array.shape[-len(shape) :] != shape or array.ndim > len(shape) + 1 or array.size == 0:
            raise ValueError(
                f"attribute {name!r} must have shape ({one}) or (k, {one}) like the coefficients, got {array.shape}"
            )
        if name == COLORS and array.shape != (3, *shape):
            raise ValueError(f"attribute {name!r} must have shape (3, {one}), got {array.shape}")
        own = np.array(array, dtype=np.float64)
        own.setflags(write=False)
        result[name] = own
    return MappingProxyType(result)


def checked_values(attributes: object, count: int) -> dict[str, Float64Array]:
    """Return attributes as arrays (v,) or (v, k) over ``count`` vertices, by name; None is none."""
    if attributes is None:
        return {}
    if not isinstance(attributes, Mapping):
        raise TypeError(f"attributes must be a mapping of names to arrays, got {type(attributes).__name__}")
    result = {}
    for key, value in attributes.items():
        name = checked_name(key)
        array = check.real_array(value, f"attribute {name!r}")
        if array.ndim not in (1, 2) or len(array) != count or array.size == 0:
            raise ValueError(
                f"attribute {name!r} must have shape (v,) or (v, k) with v = {count}, one row a vertex, "
                f"got {array.shape}"
            )
        if name == COLORS and array.shape != (count, 3):
            raise ValueError(f"attribute {name!r} must have shape (v, 3), got {array.shape}")
        result[name] = array.astype(np.float64)
    return result


def carried_values(geometry: MeshArrays | PointArrays, attributes: object, *, carry: bool) -> MeshArrays | PointArrays:
    """Return a geometry with what a shape of it carries along, as its colours, texture coordinates and attributes.

    Args:
        geometry: With what it has itself, which goes along where ``carry`` is True and it is finite everywhere.
        attributes: Further values (v,) or (v, k) by name, or None; they take the place of its own of the same name.
        carry: Whether its own go along.
    """
    if not isinstance(carry, bool):
        raise TypeError(f"carry must be True or False, got {carry!r}")
    given = checked_values(attributes, len(geometry.vertices if isinstance(geometry, MeshArrays) else geometry.points))
    geometry = _without_gaps(geometry) if carry else bare(geometry)
    if not given:
        return geometry
    changes: dict[str, Any] = {}
    if COLORS in given:
        changes[COLORS] = given.pop(COLORS)
    if TEXTURE_UVS in given and isinstance(geometry, MeshArrays):
        changes[TEXTURE_UVS] = given.pop(TEXTURE_UVS)[geometry.triangles]
    return replace(geometry, attributes={**geometry.attributes, **given}, **changes)


def _without_gaps(geometry: MeshArrays | PointArrays) -> MeshArrays | PointArrays:
    """A geometry without what has no value somewhere, as scanners and simulations mark with NaN."""

    def known(array: Float64Array | None) -> Float64Array | None:
        return array if array is not None and np.isfinite(array).all() else None

    attributes = {name: array for name, array in geometry.attributes.items() if known(array) is not None}
    changes: dict[str, Any] = {"colors": known(geometry.colors), "attributes": attributes}
    if isinstance(geometry, MeshArrays):
        changes["texture_uvs"] = known(geometry.texture_uvs)
    return replace(geometry, **changes)


def shown(name: str, values: Float64Array) -> Float64Array:
    """Return the values of an attribute; colours clipped to [0, 1], which sums of harmonics leave a little."""
    return np.clip(values, 0, 1) if name == COLORS else values


def attribute_of(attributes: Mapping[str, Float64Array], name: str) -> Float64Array:
    """Return the coefficients of an attribute.

    Raises:
        ValueError: There is no such attribute.
    """
    if name not in attributes:
        known = ", ".join(map(repr, attributes)) or "none"
        raise ValueError(f"the shape has no attribute {name!r}; it has {known}")
    return attributes[name]


def attributes_as_arrays(attributes: Mapping[str, Float64Array], axes: int) -> dict[str, Any]:
    """Return attributes as the arrays of a file; none where there are none.

    Args:
        attributes: Coefficients, of the shape of those of one function or (k, …) of such.
        axes: How many axes those of one function have: one, or two where there is a row for each shell.
    """
    if not attributes:
        return {}
    rows = [array.reshape(-1, array.shape[-1]) for array in attributes.values()]
    return {
        "attribute_names": np.array(list(attributes)),
        # Functions of each attribute; 0 for a single one without an axis of its own.
        "attribute_sizes": np.array([0 if array.ndim == axes else len(array) for array in attributes.values()]),
        "attribute_coefficients": np.vstack(rows),
    }


def attributes_from_arrays(
    path: str | os.PathLike[str], arrays: Mapping[str, Any], shells: int | None
) -> dict[str, Float64Array]:
    """Return attributes from the arrays of a file.

    Args:
        path: The file.
        arrays: What it holds.
        shells: Rows of coefficients that each function has where it has one for each shell; None: a single one.

    Raises:
        GeometryReadError, ValueError: They are malformed.
    """
    if not any(name.startswith("attribute_") for name in arrays):
        return {}
    rows = storage.field(path, arrays, "attribute_coefficients", 2)
    sizes, names = arrays.get("attribute_sizes"), arrays.get("attribute_names")
    if names is None or names.ndim != 1 or names.dtype.kind != "U" or len(set(names.tolist())) != len(names):
        raise ValueError("attribute_names is malformed")
    if sizes is None or sizes.shape != names.shape or sizes.dtype.kind not in "iu" or sizes.min() < 0:
        raise ValueError("attribute_sizes is malformed")
    ends = np.cumsum(np.maximum(sizes, 1)) * (1 if shells is None else shells)
    if ends[-1] != len(rows):
        raise ValueError(f"attribute_coefficients has {len(rows)} rows where attribute_sizes ask for {ends[-1]}")
    one: tuple[int, ...] = (rows.shape[1],) if shells is None else (shells, rows.shape[1])
    parts = zip(names.tolist(), sizes.tolist(), np.split(rows, ends[:-1]), strict=True)
    return {name: part.reshape(one if size == 0 else (size, *one)) for name, size, part in parts}
