"""Features of shapes that do not depend on pose, size or triangulation, and distances between them."""

from __future__ import annotations

from fsh3d_o3d.descriptors.key_points import LocalHarmonics, local_harmonics, typical_size
from fsh3d_o3d.descriptors.library import CPSHDDescriptor, SHDDescriptor, on_equiangular_grid
from fsh3d_o3d.descriptors.local_shd import LocalSHDOption, compute_local_shd_feature
from fsh3d_o3d.descriptors.shd import (
    CPSHDOption,
    ShapeSignature,
    SHDOption,
    compute_cpshd_feature,
    compute_shd_feature,
    compute_signature,
    descriptor_distances,
    shd_descriptor,
)
from fsh3d_o3d.descriptors.signature_distance import fits_only_mirrored, mixed_distances, signature_distances

__all__ = [
    "compute_cpshd_feature",
    "CPSHDDescriptor",
    "CPSHDOption",
    "LocalHarmonics",
    "LocalSHDOption",
    "SHDDescriptor",
    "SHDOption",
    "ShapeSignature",
    "signature_distances",
    "compute_local_shd_feature",
    "compute_shd_feature",
    "compute_signature",
    "descriptor_distances",
    "fits_only_mirrored",
    "local_harmonics",
    "mixed_distances",
    "on_equiangular_grid",
    "shd_descriptor",
    "typical_size",
]
