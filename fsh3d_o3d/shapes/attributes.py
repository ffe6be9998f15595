"""Named functions that go with a shape, such as colours: checks, and how they are stored."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry import vertex_attributes
from fsh3d_o3d.shapes import storage

COLORS = "colors"
"""The name of the attribute that Open3D draws, (v, 3) in [0, 1]."""
_RESERVED = ("positions", "normals", "indices")  # what a mesh already calls its own


def checked_name(name: object) -> str:
    """Return the name of an attribute."""
    if not isinstance(name, str):
        raise TypeError(f"an attribute's name must be text, got {name!r}")
    if not name.isprintable() or not name.strip() or name in _RESERVED:
        raise ValueError(f"an attribute must have a printable name other than {', '.join(_RESERVED)}, got {name!r}")
    return name


def checked_coefficients(attributes: object, count: int) -> dict[str, Float64Array]:
    """Return attributes as read-only arrays (b²,) or (k, b²) of ``count`` = b² coefficients, by name."""
    if not isinstance(attributes, Mapping):
        raise TypeError(f"attributes must be a mapping of names to arrays, got {type(attributes).__name__}")
    result = {}
    for key, value in attributes.items():
        name = checked_name(key)
        array = check.values_on(value, f"attribute {name!r}", count, "b²")
        if array.ndim > 2 or array.size == 0:
            raise ValueError(f"attribute {name!r} must have shape (b²,) or (k, b²), got {array.shape}")
        if name == COLORS and array.shape != (3, count):
            raise ValueError(f"attribute {name!r} must have shape (3, b²), got {array.shape}")
        own = np.array(array, dtype=np.float64)
        own.setflags(write=False)
        result[name] = own
    return result


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


def vertex_colors(geometry: Any, count: int) -> Float64Array:
    """Return the vertex colours (v, 3) of an Open3D mesh.

    Raises:
        GeometryError: It has none.
    """
    colors = vertex_attributes(geometry)[1]
    if colors is None or colors.shape != (count, 3):
        raise GeometryError("the mesh has no vertex colors to carry along")
    return np.asarray(colors, dtype=np.float64)


def attributes_as_arrays(attributes: Mapping[str, Float64Array]) -> dict[str, Any]:
    """Return attributes as the arrays of a file; none where there are none."""
    if not attributes:
        return {}
    return {
        "attribute_names": np.array(list(attributes)),
        # Functions of each attribute; 0 for a single one without an axis of its own.
        "attribute_sizes": np.array([0 if array.ndim == 1 else len(array) for array in attributes.values()]),
        "attribute_coefficients": np.vstack([np.atleast_2d(array) for array in attributes.values()]),
    }


def attributes_from_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> dict[str, Float64Array]:
    """Return attributes from the arrays of a file.

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
    ends = np.cumsum(np.maximum(sizes, 1))
    if ends[-1] != len(rows):
        raise ValueError(f"attribute_coefficients has {len(rows)} rows where attribute_sizes ask for {ends[-1]}")
    parts = zip(names.tolist(), sizes.tolist(), ends.tolist(), strict=True)
    return {name: rows[end - 1] if size == 0 else rows[end - size : end] for name, size, end in parts}
