"""The formats that are written. A new one is an entry here, and a function from ``Content`` to bytes."""

from __future__ import annotations

from collections.abc import Callable

from fsh3d_o3d.files.serialise import (
    Content,
    glb_bytes,
    obj_bytes,
    off_bytes,
    pcd_bytes,
    ply_bytes,
    stl_bytes,
    xyz_bytes,
)
from fsh3d_o3d.files.serialise_3mf import threemf_bytes
from fsh3d_o3d.files.serialise_las import las_bytes, laz_bytes
from fsh3d_o3d.files.serialise_vtp import vtp_bytes

MESH_WRITERS: dict[str, Callable[[Content], bytes]] = {
    ".ply": ply_bytes,
    ".obj": obj_bytes,
    ".off": off_bytes,
    ".stl": stl_bytes,
    ".glb": glb_bytes,
    ".3mf": threemf_bytes,
    ".vtp": vtp_bytes,
}
"""Extension and function for meshes."""

CLOUD_WRITERS: dict[str, Callable[[Content], bytes]] = {
    ".ply": ply_bytes,
    ".xyz": xyz_bytes,
    ".pcd": pcd_bytes,
    ".las": las_bytes,
    ".laz": laz_bytes,
    ".vtp": vtp_bytes,
}
"""Extension and function for point clouds."""
