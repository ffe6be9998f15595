"""Sampling grids on the unit sphere: the five of the paper's Fig. 3, each a ``SphericalGrid``.

Colatitude θ ∈ [0, π] is measured from +z, longitude φ ∈ [0, 2π) from +x towards +y.
"""

from __future__ import annotations

import functools
import hashlib
from fractions import Fraction
from math import isqrt

import ducc0
import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.sphere.icosahedron import icosphere

__all__ = [
    "SphericalGrid",
    "cube_grid",
    "equiangular_grid",
    "fibonacci_grid",
    "grid_from_directions",
    "healpix_grid",
    "icosahedral_grid",
]

_MAXIMUM_POINTS = 10**8  # a choice: 4 GB of directions and angles


@value
class SphericalGrid:
    """Sampling directions on the unit sphere, in a fixed order. Nothing changes a grid."""

    directions: Float64Array
    """(n, 3) unit vectors; a copy each time, for Open3D's ``Vector3dVector`` takes no read-only array."""
    colatitude: Float64Array
    """(n,) θ in radians, [0, π]."""
    longitude: Float64Array
    """(n,) φ in radians, [0, 2π)."""
    name: str
    """What the grid is, for people and for cache keys: ``"fibonacci"``, ``"equiangular"``, …"""

    def __post_init__(self) -> None:
        n = len(locked_directions(self))
        for name, shape in (("directions", (n, 3)), ("colatitude", (n,)), ("longitude", (n,))):
            array = check.unmasked(vars(self)[name], name)
            if array.shape != shape or n == 0:
                raise ValueError(f"{name} must have shape {shape} with n >= 1, got {array.shape}")
            if array.flags.writeable:  # the caller's own: left writeable, and copied
                array = np.array(array, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        return f"SphericalGrid({self.name!r}, {len(self)} directions)"

    def __len__(self) -> int:
        """Number of directions."""
        return len(self.colatitude)

    @functools.cached_property
    def half_turn_symmetric(self) -> bool:
        """Whether reversing the order is the half turn about x: (x, y, z)[i] = (x, −y, −z)[n − 1 − i].

        Fibonacci and equiangular grids have this symmetry; transforms use it to halve their work.
        """
        directions = locked_directions(self)
        mirrored = directions[::-1] * np.array([1.0, -1.0, -1.0])
        # A few ulp, for grids that others built from angles.
        return bool(np.abs(mirrored - directions).max() <= 1e-15)

    @functools.cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the directions: equal grids have equal fingerprints."""
        return hashlib.sha256(np.ascontiguousarray(locked_directions(self)).tobytes()).hexdigest()


def locked_directions(grid: SphericalGrid) -> Float64Array:
    """Return the directions that a grid holds, read-only: no copy, for what only reads them."""
    directions: Float64Array = vars(grid)["directions"]
    return directions


def _directions(grid: SphericalGrid) -> Float64Array:
    return np.array(locked_directions(grid))


def _keep_directions(grid: SphericalGrid, value: Float64Array) -> None:
    vars(grid)["directions"] = value


# Grids are shared by all who ask for the same, so what they hold is locked; what they hand out is not.
SphericalGrid.directions = property(_directions, _keep_directions)  # type: ignore[assignment]


def grid_size(bandwidth: int, oversampling: float | None = None) -> int:
    """Number of Fibonacci points for a bandwidth b: 4b² times ``oversampling``, 6b² if not given.

    Counting the equations of Eq. (11) asks for 4b² points only, but there they are nearly dependent; from about 5.7b²
    on they are well conditioned (``docs/conventions.md``).
    """
    factor = 1.5 if oversampling is None else check.number(oversampling, "oversampling", minimum=1.0, maximum=1000.0)
    return int(np.ceil(4 * bandwidth**2 * factor))


def fibonacci_grid(n: int) -> SphericalGrid:
    """Return the spherical Fibonacci grid of the paper's Eq. (4).

    z_i = −2d/n and φ_i = 2π·frac(dτ) with d = (1−n)/2 + i and τ = (√5−1)/2, from the north pole to the south.
    Longitudes are correct to rounding for any n: dτ is formed in two parts, because in one it loses 1e-9 rad at
    four million points. The grid is exactly symmetric under the half turn about x, d → −d.

    Args:
        n: Number of points, 1 … 10⁸.

    Raises:
        ValueError: ``n`` is out of range.

    Example:
        >>> grid = fsh.fibonacci_grid(6 * 16**2)  # the default for bandwidth 16
        >>> grid.directions.shape
        (1536, 3)
        >>> np.allclose(np.linalg.norm(grid.directions, axis=1), 1)
        True
    """
    n = check.integer(n, "n", minimum=1, maximum=_MAXIMUM_POINTS)
    check.memory(200.0 * n, f"a Fibonacci grid of {n} points")
    return _fibonacci_grid(n)


@functools.lru_cache(maxsize=16)
def _fibonacci_grid(n: int) -> SphericalGrid:
    # Twice d, so that it is an integer for even n as well; the upper half of the sphere has d <= 0.
    half = (n + 1) // 2
    twice_d = np.arange(1 - n, 1 - n + 2 * half, 2, dtype=np.int64)
    z = -twice_d / n
    sine = np.sqrt((n + twice_d) / n * ((n - twice_d) / n))
    colatitude = np.arctan2(sine, z)
    turns = _fractional_golden(twice_d)
    x = sine * np.cos(2 * np.pi * turns)
    y = sine * np.sin(2 * np.pi * turns)
    z, y = z + 0.0, y + 0.0  # no negative zeros at the middle point of an odd grid
    directions = np.empty((n, 3))
    directions[:half] = np.stack([x, y, z], axis=1)
    directions[n - half :] = np.stack([x, -y + 0.0, -z + 0.0], axis=1)[::-1]
    mirrored_turns = np.where(turns == 0, 0.0, 1.0 - turns)
    return _grid(
        directions,
        np.concatenate([colatitude, (np.pi - colatitude[: n - half])[::-1]]),
        2 * np.pi * np.concatenate([turns, mirrored_turns[: n - half][::-1]]),
        "fibonacci",
    )


def equiangular_grid(bandwidth: int) -> SphericalGrid:
    """Return the equiangular 2b × 2b grid with half-step offsets, row by row from the north.

    θ_j = π(2j+1)/(4b), φ_k = π(2k+1)/(2b); n = 4b² points (Driscoll and Healy 1994, offset by half a step so that
    no point lies on a pole). Its weights are ``driscoll_healy_weights``.

    Raises:
        ValueError: ``bandwidth`` is out of range.

    Example:
        >>> grid = fsh.equiangular_grid(8)
        >>> transform = fsh.SphericalHarmonicTransform(8, grid=grid, weights=fsh.driscoll_healy_weights(8))
        >>> len(grid), transform.forward(np.ones(256)).shape
        (256, (64,))
    """
    b = check.bandwidth(bandwidth)
    check.memory(200.0 * 4 * b * b, f"an equiangular grid of {4 * b * b} points")
    return _equiangular_grid(b)


@functools.lru_cache(maxsize=8)
def _equiangular_grid(b: int) -> SphericalGrid:
    theta = np.pi * (2 * np.arange(2 * b) + 1) / (4 * b)
    phi = np.pi * (2 * np.arange(2 * b) + 1) / (2 * b)
    grid = _grid_from_angles(np.repeat(theta, 2 * b), np.tile(phi, 2 * b), "equiangular")
    # South of the equator the mirror image of the north, to the last bit: half-turn symmetric for every b.
    directions = grid.directions.copy()
    directions[2 * b * b :] = (directions[: 2 * b * b] * [1.0, -1.0, -1.0])[::-1]
    return _grid(directions, grid.colatitude, grid.longitude, grid.name)


def healpix_grid(nside: int) -> SphericalGrid:
    """Return the HEALPix pixel centres in ring order, n = 12·nside² (Górski et al. 2005).

    Any ``nside`` from 1 on is valid in ring order, not only powers of two.

    Example:
        >>> [len(fsh.healpix_grid(nside)) for nside in (1, 2, 4, 20)]
        [12, 48, 192, 4800]
    """
    nside = check.integer(nside, "nside", minimum=1, maximum=2048)
    check.memory(200.0 * 12 * nside * nside, f"a HEALPix grid of {12 * nside * nside} points")
    return _healpix_grid(nside)


@functools.lru_cache(maxsize=8)
def _healpix_grid(nside: int) -> SphericalGrid:
    base = ducc0.healpix.Healpix_Base(nside, "RING")
    angles = base.pix2ang(np.arange(12 * nside * nside))
    return _grid_from_angles(angles[:, 0], angles[:, 1] % (2 * np.pi), "healpix")


def icosahedral_grid(level: int) -> SphericalGrid:
    """Return the vertices of a geodesic icosahedron whose edges are split 3·2^k times, n = 90·4^k + 2.

    The paper's k = 3 gives its 5762 points.

    Example:
        >>> [len(fsh.icosahedral_grid(level)) for level in (0, 1, 2, 3)]
        [92, 362, 1442, 5762]
    """
    level = check.integer(level, "level", minimum=0, maximum=8)
    directions, _ = icosphere(3 * 2**level)
    return grid_from_directions(directions, name="icosahedral")


def cube_grid(k: int) -> SphericalGrid:
    """Return the cell centres of an equiangular cubed sphere, n = 6k² (gnomonic projection, equal angles).

    Example:
        >>> grid = fsh.cube_grid(28)
        >>> len(grid), grid.name
        (4704, 'cube')
    """
    k = check.integer(k, "k", minimum=1, maximum=4000)
    check.memory(300.0 * 6 * k * k, f"a cube grid of {6 * k * k} points")
    return _cube_grid(k)


@functools.lru_cache(maxsize=8)
def _cube_grid(k: int) -> SphericalGrid:
    tangent = np.tan(np.pi / 4 * ((2 * np.arange(k) + 1) / k - 1))
    u, v = (a.ravel() for a in np.meshgrid(tangent, tangent, indexing="ij"))
    face = np.stack([np.ones_like(u), u, v], axis=1)
    pair = np.concatenate([face, face * [-1.0, 1.0, 1.0]])
    faces = np.concatenate([np.roll(pair, axis, axis=1) for axis in range(3)])
    return grid_from_directions(faces / np.linalg.norm(faces, axis=1, keepdims=True), name="cube")


def grid_from_directions(directions: object, *, name: str = "scattered") -> SphericalGrid:
    """Return a grid of given unit vectors (n, 3), in their order.

    Raises:
        ValueError: Not of shape (n, 3), not finite, or not unit vectors.

    Example:
        >>> points = np.random.default_rng(0).normal(size=(500, 3))
        >>> grid = fsh.grid_from_directions(points / np.linalg.norm(points, axis=1, keepdims=True), name="scan")
        >>> fit = fsh.fit_coefficients(grid.directions[:, 2], grid, bandwidth=4)  # samples of z
        >>> np.allclose(fsh.evaluate(fit.coefficients, np.eye(3)), [0, 0, 1])
        True
    """
    vectors = check.directions(directions)
    colatitude = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
    longitude = np.arctan2(vectors[:, 1], vectors[:, 0]) % (2 * np.pi)
    # The remainder of a tiny negative angle rounds up to 2π itself.
    longitude[longitude >= 2 * np.pi] = 0.0
    return _grid(vectors, colatitude, longitude, name)


def require_grid(value: object, name: str = "grid") -> SphericalGrid:
    """Return ``value`` if it is a grid.

    Raises:
        TypeError: It is not; says how to make one.
    """
    if not isinstance(value, SphericalGrid):
        raise TypeError(f"{name} must be a SphericalGrid, got {type(value).__name__}; see grid_from_directions")
    return value


def _grid(directions: Float64Array, colatitude: Float64Array, longitude: Float64Array, name: str) -> SphericalGrid:
    """A grid that owns its arrays, without copying them."""
    for array in (directions, colatitude, longitude):
        array.setflags(write=False)
    return SphericalGrid(directions, colatitude, longitude, name)


def _grid_from_angles(colatitude: Float64Array, longitude: Float64Array, name: str) -> SphericalGrid:
    sine = np.sin(colatitude)
    directions = np.stack([sine * np.cos(longitude), sine * np.sin(longitude), np.cos(colatitude)], axis=1)
    return _grid(directions, colatitude, longitude, name)


def _fractional_golden(twice_d: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Float64Array:
    """frac(dτ) for half-integers d, in [0, 1), to rounding: τ/2 = high + low, twice_d·high exact."""
    scale = 2**24  # 24 bits times |2d| < 2^28 fits the 53 bits of a float64
    precise = Fraction(isqrt(5 * 10**80) - 10**40, 4 * 10**40)  # τ/2 to 40 digits
    high = Fraction(int(precise * scale), scale)
    low = float(precise - high)
    turns: Float64Array = np.mod(np.mod(twice_d * float(high), 1.0) + twice_d * low, 1.0)
    turns[turns >= 1.0] = 0.0
    return turns
