"""VTK's formats: legacy .vtk, and XML .vtp and .vtu."""

from __future__ import annotations

from fsh3d_o3d.files.formats.vtk.legacy import parse_vtk
from fsh3d_o3d.files.formats.vtk.xml import parse_vtk_xml

__all__ = ["parse_vtk", "parse_vtk_xml"]
