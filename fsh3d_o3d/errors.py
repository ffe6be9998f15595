"""The package's own exceptions and warnings.

Everything wrong with an argument is a ``ValueError`` or ``TypeError``; the classes here exist so that a caller can
tell apart the cases that need a different reaction.
"""

from __future__ import annotations

__all__ = [
    "ConvergenceWarning",
    "CoverageError",
    "GeometryError",
    "GeometryReadError",
    "GeometryReadWarning",
    "MemoryEstimateError",
    "NotStarShapedError",
    "QuadratureWarning",
    "ReconstructionWarning",
]


class GeometryError(ValueError):
    """A mesh or point cloud that cannot be used: empty, not finite, zero area, indices out of range."""


class GeometryReadError(GeometryError):
    """A file that cannot be read as geometry: empty, truncated, malformed, wrong format, or a reader that died."""


class NotStarShapedError(GeometryError):
    """A surface that rays from the centre meet never or more than once."""


class CoverageError(GeometryError):
    """Samples that leave too much of the sphere empty for the fit that was asked for."""


class MemoryEstimateError(ValueError):
    """A request whose estimated memory exceeds the limit; refused before anything is allocated."""


class GeometryReadWarning(UserWarning):
    """A file that was read in spite of something; what, the message says."""


class ConvergenceWarning(UserWarning):
    """An iteration that ran out of steps before its tolerance."""


class QuadratureWarning(UserWarning):
    """Quadrature weights that miss the conditions of Eq. (8) by more than the tolerance."""


class ReconstructionWarning(UserWarning):
    """A surface that came back with a large error or other parts and handles; says what would help."""
