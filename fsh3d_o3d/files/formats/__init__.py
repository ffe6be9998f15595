"""One file a format: bytes into meshes and clouds, in Python and NumPy alone."""

from __future__ import annotations

from fsh3d_o3d.files.formats.encoding import check_not_a_pointer, plain_text
from fsh3d_o3d.files.formats.gltf import parse_glb, parse_gltf
from fsh3d_o3d.files.formats.obj import parse_obj
from fsh3d_o3d.files.formats.off import parse_off
from fsh3d_o3d.files.formats.pcd import parse_pcd
from fsh3d_o3d.files.formats.ply import parse_ply
from fsh3d_o3d.files.formats.points import parse_pts, parse_xyz, parse_xyzn, parse_xyzrgb
from fsh3d_o3d.files.formats.source import ReadFile, Source
from fsh3d_o3d.files.formats.stl import binary_stl_size, has_binary_header, parse_stl

__all__ = [
    "ReadFile",
    "Source",
    "binary_stl_size",
    "check_not_a_pointer",
    "has_binary_header",
    "parse_glb",
    "parse_gltf",
    "parse_obj",
    "parse_off",
    "parse_pcd",
    "parse_ply",
    "parse_pts",
    "parse_stl",
    "parse_xyz",
    "parse_xyzn",
    "parse_xyzrgb",
    "plain_text",
]
