"""Fields on concentric shells around a shape, and surfaces of fields in space."""

from __future__ import annotations

from fsh3d_o3d.shells.iso_surface import without_specks, zero_surface
from fsh3d_o3d.shells.shell_fields import Distance, Route, ShellFields, ShellSampler
from fsh3d_o3d.shells.volume_fields import FIELDS, FieldName, volume_field
from fsh3d_o3d.shells.voxel_fields import VoxelGrid

__all__ = [
    "Distance",
    "FIELDS",
    "FieldName",
    "Route",
    "ShellFields",
    "ShellSampler",
    "VoxelGrid",
    "volume_field",
    "without_specks",
    "zero_surface",
]
