"""A target that is aligned to many times: what does not depend on the source is found once."""

from __future__ import annotations

from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d.registration.prepared import Prepared


class SphericalRegistrationTarget:
    """A geometry prepared as the target of ``registration_spherical``.

    What the alignment needs of the target (its surface, its coefficients, local harmonics, search trees) is found with
    the first source that needs it and kept, so that a scan-to-CAD comparison of many scans pays for the model once.
    The answers are the same bytes as without it. It pickles, with all that is kept, for other processes.

    Args:
        geometry: What ``registration_spherical`` takes.
        samples: As in ``SphericalRegistrationOption``; options with another number are refused.

    Raises:
        TypeError: Not a geometry.
        GeometryError: Empty, without area or extent.

    Example:
        >>> target = fsh.SphericalRegistrationTarget(fsh.read_geometry("samples/gem.stl"))
        >>> scan = fsh.read_geometry("samples/gem_rotated.stl")
        >>> print(f"{fsh.registration_spherical(scan, target).fitness:.2f}")
        1.00
    """

    def __init__(self, geometry: Any, samples: int = 4096) -> None:
        check.integer(samples, "samples", minimum=256, maximum=10**6)
        self.samples = samples
        self._prepared = Prepared.of(geometry, samples, "target")

    @property
    def geometry(self) -> Any:
        """The geometry as arrays."""
        return self._prepared.geometry

    def __repr__(self) -> str:
        return f"SphericalRegistrationTarget({type(self.geometry).__name__}, {len(self._prepared.points)} points)"


def prepared_target(target: Any, samples: int) -> Prepared:
    """Return a target that was given, prepared or not, as alignment takes it.

    Raises:
        ValueError: Prepared with another number of samples.
    """
    if not isinstance(target, SphericalRegistrationTarget):
        return Prepared.of(target, samples, "target")
    if samples != target.samples:
        raise ValueError(f"the target was prepared with {target.samples} samples, the option has {samples}")
    return target._prepared
