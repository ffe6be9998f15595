"""Buffers of a glTF file and the parts of them that it names: embedded, beside it, or compressed."""

from __future__ import annotations

import base64
import binascii
import os
from typing import Any, cast
from urllib.parse import unquote_to_bytes

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.document import GltfDocument, extension, natural
from fsh3d_o3d.files.formats.gltf.meshopt import MESHOPT, decode_meshopt

# Bytes that compressed parts of a file may grow to, all together: far more than models have, and far less than a
# small file of zeros could ask for.
_MOST_DECOMPRESSED = 4 * 2**30


class GltfBuffers:
    """Bytes by buffer and by buffer view; each buffer is decoded or opened once."""

    def __init__(self, document: GltfDocument) -> None:
        self._document = document
        self._contents: dict[int, memoryview] = {}
        self._decompressed: dict[int, memoryview] = {}

    def view(self, index: object) -> tuple[memoryview, int | None]:
        """Return the bytes of a buffer view, decompressed, and the distance of its items where it states one."""
        entry = self._document.entry("bufferViews", index)
        number = cast(int, index)
        stride = natural(entry, "byteStride") if "byteStride" in entry else None
        for name in MESHOPT:
            compressed = extension(entry, name)
            if compressed is not None:
                if number not in self._decompressed:
                    self._decompressed[number] = self._decompress(name, compressed, natural(entry, "byteLength"))
                return self._decompressed[number], stride
        return self._part(entry, f"buffer view {number}"), stride

    def _part(self, entry: dict[str, Any], name: str) -> memoryview:
        content = self._buffer(entry.get("buffer"))
        begin, size = natural(entry, "byteOffset", 0), natural(entry, "byteLength")
        if begin + size > len(content):
            raise GeometryReadError(f"truncated or damaged: {name} exceeds its buffer of {len(content)} bytes")
        return content[begin : begin + size]

    def _decompress(self, name: str, entry: dict[str, Any], size: int) -> memoryview:
        data = bytes(self._part(entry, f"a part compressed by {name}"))
        if size + sum(map(len, self._decompressed.values())) > _MOST_DECOMPRESSED:
            raise GeometryReadError(f"compressed ({name}), and grows to more than {_MOST_DECOMPRESSED} bytes")
        try:
            count, stride = natural(entry, "count"), natural(entry, "byteStride")
            if count * stride != size:
                raise ValueError(f"{count} items of {stride} bytes, not the {size} announced")
            items = decode_meshopt(data, count, stride, entry.get("mode"), entry.get("filter", "NONE"))
        except (ValueError, GeometryReadError) as error:
            reason = str(error).removeprefix("damaged: ")
            raise GeometryReadError(f"compressed ({name}), and what is compressed is damaged: {reason}") from None
        return memoryview(cast(Any, items))

    def _buffer(self, index: object) -> memoryview:
        buffer = self._document.entry("buffers", index)
        number = cast(int, index)
        if number not in self._contents:
            content = self._content(number, buffer)
            needed = natural(buffer, "byteLength")
            if len(content) < needed:
                raise GeometryReadError(f"truncated: buffer {number} announces {needed} bytes and has {len(content)}")
            self._contents[number] = content[:needed]
        return self._contents[number]

    def _content(self, index: int, buffer: dict[str, Any]) -> memoryview:
        uri = buffer.get("uri")
        if uri is None:
            if index == 0 and self._document.binary is not None:
                return self._document.binary
            compression = [name for name in MESHOPT if name in self._document.required or extension(buffer, name)]
            named = f"compressed ({compression[0]}), and damaged" if compression else "damaged"
            raise GeometryReadError(f"{named}: buffer {index} has no content")
        if not isinstance(uri, str):
            raise GeometryReadError(f"damaged: the uri of buffer {index} is not text")
        if uri[:5].lower() == "data:":
            return memoryview(self._embedded(index, uri))
        try:
            # Percent signs are undone once; what they hide is then a plain name or refused.
            name = os.fsdecode(unquote_to_bytes(uri.removeprefix("./")))
            return memoryview(self._document.source.beside(name))
        except UnicodeEncodeError:
            raise GeometryReadError(f"damaged: the uri of buffer {index} is not text") from None
        except GeometryReadError as error:
            raise GeometryReadError(f"{error}; a .glb file holds all in one") from None

    def _embedded(self, index: int, uri: str) -> bytes:
        kind, _, payload = uri[5:].partition(",")
        try:
            if "%" in payload or not kind.lower().endswith(";base64"):
                payload_bytes = unquote_to_bytes(payload)
            else:
                payload_bytes = payload.encode("ascii")
            if not kind.lower().endswith(";base64"):
                return payload_bytes
            compact = b"".join(payload_bytes.split())
            if len(compact) % 4:
                self._document.source.note("the padding at the end of embedded base64 is missing")
                compact += b"=" * (-len(compact) % 4)
            return base64.b64decode(compact, validate=True)
        except (binascii.Error, ValueError):
            raise GeometryReadError(f"damaged: buffer {index} is not base64") from None
