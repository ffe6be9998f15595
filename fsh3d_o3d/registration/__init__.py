"""Alignment of one shape onto another from any position."""

from __future__ import annotations

from fsh3d_o3d.registration.register import (
    SphericalRegistrationCandidate,
    SphericalRegistrationOption,
    SphericalRegistrationResult,
    registration_spherical,
)
from fsh3d_o3d.registration.scan_result import ScanPair, ScanRegistrationResult
from fsh3d_o3d.registration.scans import ScanRegistrationOption, register_scans
from fsh3d_o3d.registration.surface import plain_surface, resolved_surface, shell_coefficients

__all__ = [
    "ScanPair",
    "ScanRegistrationOption",
    "ScanRegistrationResult",
    "SphericalRegistrationCandidate",
    "SphericalRegistrationOption",
    "SphericalRegistrationResult",
    "plain_surface",
    "register_scans",
    "registration_spherical",
    "resolved_surface",
    "shell_coefficients",
]
