"""The JSON of a glTF file: every look-up in it is checked, and what it requires is known or refused."""

from __future__ import annotations

import json
import re
from typing import Any, cast

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source

_VERSION = 2  # major; files of glTF 1 are built differently
_UNDERSTOOD = {
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
}
# What these add is seen, heard, known or simulated, but leaves every vertex where it is.
_WITHOUT_EFFECT = re.compile(
    r"(KHR|EXT|ADOBE|NV|VRMC)_materials_\w+|KHR_techniques_webgl|(KHR|EXT|MSFT)_texture_\w+|MSFT_packing_\w+|"
    r"(KHR|EXT)_lights_\w+|KHR_xmp(_json_ld)?|KHR_animation_pointer|KHR_audio\w*|KHR_interactivity|"
    r"KHR_node_(hover|select)ability|KHR_(physics_rigid_bodies|collision_shapes|implicit_shapes)|"
    r"EXT_(mesh|instance)_features|EXT_structural_metadata|EXT_mesh_manifold|CESIUM_primitive_outline|MSFT_lod|"
    r"FB_geometry_metadata|VRMC_(vrm|springBone)"
)


class GltfDocument:
    """The JSON of a glTF file, and what came with it."""

    def __init__(self, source: Source, text: bytes, binary: memoryview | None) -> None:
        """Parse and check.

        Args:
            source: The file.
            text: The JSON.
            binary: The data chunk of a .glb.

        Raises:
            GeometryReadError: It is not glTF 2, or requires what is not understood.
        """
        self.source = source
        self.tree = _tree(text)
        self.binary = binary
        self._require_version()
        self.required = {name for name in self.entries("extensionsRequired") if isinstance(name, str)}
        unknown = sorted(name for name in self.required - _UNDERSTOOD if not _WITHOUT_EFFECT.fullmatch(name))
        if unknown:
            shown = ", ".join(name[:60] for name in unknown[:5])
            raise GeometryReadError(f"it requires glTF extensions that are not understood: {shown}")

    def entries(self, kind: str) -> list[Any]:
        """Return a top-level list, empty where it is missing."""
        return listed(self.tree, kind)

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """Return entry ``index`` of a top-level list."""
        found = self.entries(kind)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(found):
            raise GeometryReadError(f"damaged: there is no entry {str(index)[:20]!r} in {kind}")
        if not isinstance(found[index], dict):
            raise GeometryReadError(f"damaged: entry {index} of {kind} is not an object")
        return cast(dict[str, Any], found[index])

    def _require_version(self) -> None:
        asset = self.tree.get("asset", {})
        stated = asset.get("version", "2.0") if isinstance(asset, dict) else "2.0"
        # In glTF 1 the collections are objects with names, not lists.
        if "asset" not in self.tree and any(isinstance(self.tree.get(kind), dict) for kind in ("nodes", "meshes")):
            stated = "1.0"
        major = re.match(r"\d{1,9}", str(stated))
        if major and int(major[0]) != _VERSION:
            raise GeometryReadError(f"glTF version {str(stated)[:20]} is not read, only {_VERSION}")


def extension(entry: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Return what an extension says of an entry; None where it says nothing."""
    found = entry.get("extensions")
    content = found.get(name) if isinstance(found, dict) else None
    return content if isinstance(content, dict) else None


def listed(entry: dict[str, Any], name: str) -> list[Any]:
    """Return a list of an entry, empty where it is missing."""
    found = entry.get(name, [])
    if not isinstance(found, list):
        raise GeometryReadError(f"damaged: {name} is not a list")
    return found


def natural(entry: dict[str, Any], name: str, default: int | None = None) -> int:
    """Return a whole number >= 0 of an entry."""
    value = entry.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
        raise GeometryReadError(f"damaged: {name} must be a number >= 0")
    return value


def _tree(text: bytes) -> dict[str, Any]:
    try:
        tree = json.loads(text)
    except RecursionError:
        raise GeometryReadError("damaged: the JSON is nested too deeply") from None
    except ValueError as error:
        raise GeometryReadError(f"truncated or damaged JSON ({str(error)[:80]})") from None
    if not isinstance(tree, dict):
        raise GeometryReadError("the JSON is not a glTF document")
    return tree
