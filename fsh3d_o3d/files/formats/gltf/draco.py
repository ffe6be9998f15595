"""Primitives that are compressed with Draco. The decoder is native code, loaded when a file needs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import IntArray
from fsh3d_o3d.errors import GeometryReadError

DRACO = "KHR_draco_mesh_compression"
"""Name of the extension."""


@dataclass(frozen=True, eq=False)
class DracoMesh:
    """A decompressed primitive."""

    triangles: IntArray
    """(t, 3) indices."""
    attributes: dict[str, NDArray[Any]]
    """(v, width) numbers as they were compressed, by the name that glTF gives them."""


def draco_available() -> bool:
    """Return whether the decoder is installed."""
    try:
        import_installed("DracoPy")
    except ImportError:
        return False
    return True


def decode_draco(data: bytes, identifiers: dict[str, Any]) -> DracoMesh:
    """Decompress a primitive.

    Args:
        data: The Draco stream.
        identifiers: Number of each attribute in the stream, by name.

    Raises:
        GeometryReadError: The decoder is not installed, or the stream is damaged.
    """
    try:
        decoder: Any = import_installed("DracoPy")
    except ImportError:
        raise GeometryReadError(
            f"compressed ({DRACO}): install the decoder with 'pip install DracoPy', or save it without compression"
        ) from None
    damaged = f"compressed ({DRACO}), and what is compressed is damaged"
    if data[:5] != b"DRACO":
        raise GeometryReadError(f"{damaged}: it is not a Draco stream")
    try:
        mesh = decoder.decode(data)
        if not isinstance(mesh, decoder.DracoMesh):
            raise GeometryReadError(f"{damaged}: it holds points, not triangles")
        found = {name: mesh.get_attribute_by_unique_id(number) for name, number in identifiers.items()}
        attributes = {name: np.asarray(attribute["data"]) for name, attribute in found.items() if attribute}
        triangles = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except (GeometryReadError, MemoryError):
        raise
    except Exception:  # it has several kinds of its own, and of damage it says no more than that it is no mesh
        raise GeometryReadError(f"{damaged}: the decoder refuses it") from None
    missing = sorted(set(identifiers) - set(attributes))
    if missing:
        raise GeometryReadError(f"{damaged}: there is no attribute {', '.join(missing)[:80]}")
    return DracoMesh(triangles, attributes)
