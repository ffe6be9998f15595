"""Alignment of one shape onto another from any position, whether they are seen whole or in part."""

from __future__ import annotations

from fsh3d_o3d.registration.option import SphericalRegistrationOption
from fsh3d_o3d.registration.register import (
    SphericalRegistrationCandidate,
    SphericalRegistrationResult,
    registration_spherical,
)
from fsh3d_o3d.registration.scan_result import ScanPair, ScanRegistrationResult
from fsh3d_o3d.registration.scans import ScanRegistrationOption, register_scans
from fsh3d_o3d.registration.surface import plain_surface, resolved_surface, shell_coefficients
from fsh3d_o3d.registration.target import SphericalRegistrationTarget

__all__ = [
    "ScanPair",
    "ScanRegistrationOption",
    "ScanRegistrationResult",
    "SphericalRegistrationCandidate",
    "SphericalRegistrationOption",
    "SphericalRegistrationResult",
    "SphericalRegistrationTarget",
    "plain_surface",
    "register_scans",
    "registration_spherical",
    "resolved_surface",
    "shell_coefficients",
]
