"""glTF files put together piece by piece."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from tests.files.mutations import TRIANGLES, VERTICES, pack_glb

_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """A document and its buffer while they grow; the tree may be changed at will."""

    def __init__(self, **tree: Any) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "meshes": []}
        self.tree |= tree
        self.data = bytearray()

    def view(self, content: bytes, **more: Any) -> int:
        """Add bytes to the buffer; return the buffer view."""
        self.data += bytes(-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **more}
        self.tree["bufferViews"].append(view)
        self.data += content
        return len(self.tree["bufferViews"]) - 1

    def array(self, values: Any, dtype: str = "f4", **more: Any) -> int:
        """Add numbers (count, width) or (count,) to the buffer; return the accessor."""
        array = np.asarray(values).astype("<" + dtype)
        array = array.reshape(len(array), -1)
        described = {"bufferView": self.view(array.tobytes()), **self.described(array, dtype), **more}
        return self.accessor(**described)

    def described(self, array: np.ndarray, dtype: str = "f4") -> dict[str, Any]:
        """What an accessor says of numbers (count, width)."""
        return {"componentType": _COMPONENTS[dtype], "count": len(array), "type": _KINDS[array.shape[1]]}

    def accessor(self, **described: Any) -> int:
        """Add an accessor; return it."""
        self.tree["accessors"].append(described)
        return len(self.tree["accessors"]) - 1

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> int:
        """Add a mesh; return it."""
        self.tree["meshes"].append({"primitives": list(primitives), **more})
        return len(self.tree["meshes"]) - 1

    def octahedron(self, **attributes: int) -> dict[str, Any]:
        """Return a primitive of the octahedron, with more attributes or others."""
        named = attributes if "POSITION" in attributes else {"POSITION": self.array(VERTICES), **attributes}
        return {"attributes": named, "indices": self.array(TRIANGLES.ravel(), "u2")}

    def glb(self) -> bytes:
        """Return it as a .glb."""
        return pack_glb({**self.tree, "buffers": [{"byteLength": len(self.data)}]}, bytes(self.data))

    def gltf(self, uri: str | None = None) -> str:
        """Return it as the text of a .gltf, whose buffer is embedded or has a name."""
        if uri is None:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        return json.dumps({**self.tree, "buffers": [{"byteLength": len(self.data), "uri": uri}]})
