"""glTF 2.0: binary .glb, and .gltf with embedded buffers or the files beside it."""

from __future__ import annotations

from fsh3d_o3d.files.formats.gltf.parse import parse_glb, parse_gltf

__all__ = [
    "parse_glb",
    "parse_gltf",
]
