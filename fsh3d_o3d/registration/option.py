"""Options of global alignment."""

from __future__ import annotations

from fsh3d_o3d import _validation as check
from fsh3d_o3d._value import value


@value(kw_only=True)
class SphericalRegistrationOption:
    """Options of ``registration_spherical``; checked when made.

    Example:
        >>> source, target = fsh.read_geometry("samples/gem_rotated.stl"), fsh.read_geometry("samples/gem.stl")
        >>> rigid = fsh.SphericalRegistrationOption(with_scaling=False)  # both in the same units
        >>> print(f"{fsh.registration_spherical(source, target, rigid).scale:.3f}")
        1.000
    """

    with_scaling: bool = True
    """Whether the source is also scaled; False: both are in the same units, and the result is rigid."""
    reflections: bool = False
    """Whether the source may also be mirrored, where that fits clearly better than turning it."""
    polish: bool = True
    """Whether the answer is brought closer by an iteration over closest points (ICP) of both surfaces."""
    max_correspondence_distance: float | None = None
    """Farthest that points count as corresponding in fitness and inlier RMSE, in units of the target. None: a tenth of
    the target's RMS radius, or twice the usual spacing of its points if that is more. Does not change the answer."""
    candidates: int = 6
    """Rotations that are compared: maxima of the correlation, best first."""
    bandwidth: int = 12
    """Degrees 0 … bandwidth − 1 of the functions that are correlated."""
    samples: int = 4096
    """Points on a mesh that stand for its area; of a cloud with more points as many are looked at."""

    def __post_init__(self) -> None:
        for name in ("with_scaling", "reflections", "polish"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name} must be True or False, got {getattr(self, name)!r}")
        if self.max_correspondence_distance is not None:
            check.number(self.max_correspondence_distance, "max_correspondence_distance", minimum=0, exclusive=True)
        check.integer(self.candidates, "candidates", minimum=1, maximum=60)
        check.integer(self.bandwidth, "bandwidth", minimum=4, maximum=32)
        check.integer(self.samples, "samples", minimum=256, maximum=10**6)
