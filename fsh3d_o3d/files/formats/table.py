"""The formats that are read. A new one is an entry here, and a file beside this one that parses it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import cast

from fsh3d_o3d.files.formats.gltf import parse_glb, parse_gltf
from fsh3d_o3d.files.formats.obj import parse_obj
from fsh3d_o3d.files.formats.off import parse_off
from fsh3d_o3d.files.formats.pcd import parse_pcd
from fsh3d_o3d.files.formats.ply import parse_ply
from fsh3d_o3d.files.formats.points import parse_pts, parse_xyz, parse_xyzn, parse_xyzrgb
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.stl import parse_stl
from fsh3d_o3d.geometry import MeshArrays, PointArrays

Parser = Callable[[Source], MeshArrays | PointArrays]


def _when_met(module: str, function: str) -> Parser:
    """Return a parser that is loaded when the first file of its format is met: a process starts without it."""

    def parse(source: Source) -> MeshArrays | PointArrays:
        found = getattr(importlib.import_module(f"{__package__}.{module}"), function)
        return cast(Parser, found)(source)

    return parse


PARSERS: dict[str, Parser] = {
    ".off": parse_off,
    ".obj": parse_obj,
    ".ply": parse_ply,
    ".stl": parse_stl,
    ".glb": parse_glb,
    ".gltf": parse_gltf,
    ".xyz": parse_xyz,
    ".xyzn": parse_xyzn,
    ".xyzrgb": parse_xyzrgb,
    ".pts": parse_pts,
    ".pcd": parse_pcd,
    ".3mf": _when_met("threemf", "parse_3mf"),
    ".step": _when_met("cad", "parse_step"),
    ".stp": _when_met("cad", "parse_step"),
    ".iges": _when_met("cad", "parse_iges"),
    ".igs": _when_met("cad", "parse_iges"),
    ".e57": _when_met("e57", "parse_e57"),
    ".dae": _when_met("collada", "parse_dae"),
    ".x3d": _when_met("x3d", "parse_x3d"),
    ".fbx": _when_met("fbx", "parse_fbx"),
    ".vtk": _when_met("vtk", "parse_vtk"),
    ".vtp": _when_met("vtk", "parse_vtk_xml"),
    ".vtu": _when_met("vtk", "parse_vtk_xml"),
    ".nii": _when_met("nifti", "parse_nifti"),
    ".nrrd": _when_met("nrrd", "parse_nrrd"),
    ".nhdr": _when_met("nrrd", "parse_nrrd"),
    ".tif": _when_met("tiff", "parse_tiff"),
    ".tiff": _when_met("tiff", "parse_tiff"),
    ".npy": _when_met("npy", "parse_npy"),
    ".las": _when_met("las", "parse_las"),
    ".laz": _when_met("las", "parse_las"),
}
"""A file's extension, and what turns its content into arrays or raises ``GeometryError`` with the reason."""

NOT_TEXT: frozenset[str] = frozenset(
    {".glb", ".3mf", ".las", ".laz", ".e57", ".fbx", ".nii", ".nrrd", ".nhdr", ".tif", ".tiff", ".npy"}
)
"""Formats whose first bytes are never a mark of Unicode."""

PARSERS_ABOVE: dict[str, Parser] = {}
"""Extension and function of what folders above this one understand, such as the coefficients of a shape; they say so
when they are loaded (``files.parse_with``), and it is parsed in the caller's process."""
