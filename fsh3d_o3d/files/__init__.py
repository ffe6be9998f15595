"""Geometry and bytes in files and in object storage: read without trusting them, written whole or not at all."""

from __future__ import annotations

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d.files.child_process import ChildProcess, end_after, fill_standard_descriptors
from fsh3d_o3d.files.formats import format_of, is_readable
from fsh3d_o3d.files.object_storage import (
    absolute,
    folder_names,
    is_uri,
    lance_options,
    list_objects,
    object_states,
    require_bucket,
    require_no_credentials,
    storage_error,
)
from fsh3d_o3d.files.parsing import file_content, parse_content
from fsh3d_o3d.files.reading import READABLE_FORMATS, read_geometry, read_geometry_arrays, read_geometry_file
from fsh3d_o3d.files.writing import WRITABLE_CLOUD_FORMATS, WRITABLE_MESH_FORMATS, write_geometry

__all__ = [
    "ChildProcess",
    "READABLE_FORMATS",
    "WRITABLE_CLOUD_FORMATS",
    "WRITABLE_MESH_FORMATS",
    "absolute",
    "atomic_write_bytes",
    "end_after",
    "file_content",
    "fill_standard_descriptors",
    "folder_names",
    "format_of",
    "is_readable",
    "is_uri",
    "lance_options",
    "list_objects",
    "object_states",
    "parse_content",
    "read_geometry",
    "read_geometry_arrays",
    "read_geometry_file",
    "require_bucket",
    "require_no_credentials",
    "storage_error",
    "write_geometry",
]
