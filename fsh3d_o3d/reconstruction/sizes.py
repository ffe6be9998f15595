"""How many numbers each kind of shape may have."""

from __future__ import annotations

from fsh3d_o3d import _validation as check
from fsh3d_o3d._value import value

_USUAL = 64  # degrees of a surface: 4,096 numbers radial, 12,288 conformal
_FEWEST_SHELLS = 8  # the spline along the radius needs a few; a choice


@value
class Sizes:
    """Bandwidths of the three kinds that go together."""

    surface: int
    """b of a radial and of a conformal shape."""
    shell: int
    """b of each shell: half of that, since a solid has shells besides."""
    shells: int
    """S."""

    @classmethod
    def of(cls, bandwidth: object | None) -> Sizes:
        """Return the sizes for a bandwidth, the usual ones if it is None."""
        b = _USUAL if bandwidth is None else check.bandwidth(bandwidth)
        return cls(b, max(2, b // 2), max(_FEWEST_SHELLS, b))
