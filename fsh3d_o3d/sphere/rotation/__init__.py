"""Rotations of coefficients, the search for the best one, symmetries and a pose of its own for every shape."""

from __future__ import annotations

from fsh3d_o3d.sphere.rotation.aligned_distance import aligned_distance
from fsh3d_o3d.sphere.rotation.canonical import CanonicalPose, canonical_pose
from fsh3d_o3d.sphere.rotation.correlation import exponential
from fsh3d_o3d.sphere.rotation.rotation import parity, reflect_coefficients, rotate_coefficients
from fsh3d_o3d.sphere.rotation.rotation_matrices import rotate_each
from fsh3d_o3d.sphere.rotation.rotation_search import RotationEstimate, estimate_rotation, estimate_rotations
from fsh3d_o3d.sphere.rotation.symmetry import SymmetryAxis, SymmetryPlane, SymmetryReport, find_symmetries

__all__ = [
    "CanonicalPose",
    "RotationEstimate",
    "SymmetryAxis",
    "SymmetryPlane",
    "SymmetryReport",
    "aligned_distance",
    "canonical_pose",
    "estimate_rotation",
    "estimate_rotations",
    "exponential",
    "find_symmetries",
    "parity",
    "reflect_coefficients",
    "rotate_coefficients",
    "rotate_each",
]
