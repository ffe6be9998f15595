"""Options of the spherical harmonic descriptor."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._value import value
from fsh3d_o3d.shells import Distance, Route, ShellFields
from fsh3d_o3d.sphere import SphericalGrid, checked_weights

_RECIPE = 1  # raised whenever the same option gives other numbers


@value(kw_only=True)
class SHDOption:
    """Options of the spherical harmonic descriptor; lengths in RMS radii of the shape. Equal options compare equal.

    The default is the energies of one field: ``Feature.data`` is (bandwidth, shells). ``best()`` retrieves best,
    ``published()`` is the descriptor of Kazhdan et al. (2003). Checked when made.

    Example:
        >>> option = fsh.SHDOption(bandwidth=8, shells=16)
        >>> option.feature_shape
        (8, 16)
        >>> fsh.SHDOption.published().feature_shape, fsh.SHDOption.best().feature_shape
        ((17, 32), (12, 300))
    """

    bandwidth: int = 16
    """b: degrees 0 … b − 1."""
    shells: int = 32
    """S: the shells' radii are (i + ½)/S of ``radius``, i = 0 … S − 1."""
    radius: float = 2.0
    """Outer radius about the area centroid; farther parts are left out."""
    grid: SphericalGrid | None = None
    """Directions on each shell; None: the Fibonacci grid of 6b² points."""
    weights: NDArray[np.float64] | None = None
    """(n,) quadrature weights of ``grid``, for example ``driscoll_healy_weights(b)`` with ``equiangular_grid(b)``;
    None: the analytic weights."""
    route: Route = "voxel"
    """``"voxel"``: fields on a grid, interpolated; fast. ``"exact"``: closest points on the triangles (Open3D), or
    nearest points of a cloud."""
    distance: Distance | None = None
    """``"soft"``: soft minimum over the whole area, without kinks; voxel route only. ``"nearest"``: distance to the
    closest point. None: what the route does best, soft on voxels and nearest on the exact route."""
    widths: tuple[float, ...] = (np.sqrt(2) / 8,)
    """σ of the fields exp(−d²/2σ²) of the distance; √2/8 is the published √8 of 32 voxels."""
    smoothing: float = 0.1
    """Width of the soft minimum; at least the edge of a voxel."""
    normal_width: float | None = None
    """σ of the field of normals, the mean of (n·r)² near the surface; None: no such field."""
    normal_smoothing: float = 0.2
    """Width of the average of the normals."""
    frames: tuple[float, ...] = (0.0,)
    """Powers a of the whitening C^(−a/2) by the covariance: 0 is the shape as it is, 1 with all axes alike. Each gives
    all fields once more."""
    flatness: float = 1e-3
    """Smallest eigenvalue of the covariance, relative to the largest, that whitening stretches."""
    voxels: int = 64
    """Voxels along each side of the grid, which spans twice the outer radius."""
    samples: int = 16384
    """Points on a mesh that stand for its area."""
    shell_scaling: Literal["none", "radius", "sqrt4pi"] = "sqrt4pi"
    """What the values on a shell of radius r are multiplied by: 1, r, or r√4π, the square root of its area."""
    bands: int | None = None
    """Neighbouring shells are averaged into this many; divides ``shells``. None: not averaged."""
    invariant: Literal["energies", "cross_shell"] = "energies"
    """``"energies"``: one number for each degree and shell. ``"cross_shell"``: ``power`` of the matrix of inner
    products of all shells, fields and frames, degree by degree; data is (bandwidth, R(R+1)/2) with R their number."""
    covariance: bool = False
    """Energies only: three eigenvalues instead of degrees 0 and 2; data has bandwidth + 1 rows (Kazhdan)."""
    power: float = 0.25
    """Exponent of the matrix of inner products; ½ has the units of an energy."""
    epsilon: float = 0.01
    """Singular values below this (fields have unit norm) are damped, so that noise is not."""
    metric: Literal["l1", "l2"] = "l1"
    """Norm of descriptor distances."""
    normalisation: Literal["none", "l1", "l2"] = "l2"
    """Norm of the whole feature that is made 1."""

    def __post_init__(self) -> None:
        b = check.bandwidth(self.bandwidth)
        object.__setattr__(self, "weights", checked_weights(self.grid, self.weights))
        for name in ("widths", "frames"):
            given = getattr(self, name)
            if isinstance(given, list):
                object.__setattr__(self, name, tuple(given))
        _ = self.shell_fields  # checks its part
        if not isinstance(self.frames, tuple) or not self.frames:
            raise ValueError(f"frames must be a tuple of at least one number, got {self.frames!r}")
        for power in self.frames:
            check.number(power, "frames", minimum=-1, maximum=1)
        check.number(self.flatness, "flatness", minimum=1e-6, maximum=1)
        check.integer(self.samples, "samples", minimum=256, maximum=10**7)
        if self.shells % check.integer(self.rows, "bands", minimum=1, maximum=self.shells):
            raise ValueError(f"bands must divide the {self.shells} shells, got {self.bands}")
        check.choice(self.shell_scaling, "shell_scaling", ("none", "radius", "sqrt4pi"))
        check.choice(self.invariant, "invariant", ("energies", "cross_shell"))
        check.choice(self.metric, "metric", ("l1", "l2"))
        check.choice(self.normalisation, "normalisation", ("none", "l1", "l2"))
        check.number(self.power, "power", minimum=0, maximum=2, exclusive=True)
        check.number(self.epsilon, "epsilon", minimum=0, maximum=1)
        if not isinstance(self.covariance, bool):
            raise TypeError(f"covariance must be True or False, got {self.covariance!r}")
        if self.covariance and (self.invariant != "energies" or b < 3):
            raise ValueError("covariance replaces degrees 0 and 2 of energies: it needs them, and a bandwidth >= 3")

    @classmethod
    def published(cls) -> SHDOption:
        """The descriptor of Kazhdan et al. (2003) with its covariance replacement, compared by L2: (17, 32).

        A 64³ raster, σ² = 8 voxels², 32 shells at (i + ½)/32, twice the RMS radius on half the grid, degrees < 16,
        shells times r√4π. Distances are to the surface within the nearest voxel, not to its centre.
        """
        return cls(distance="nearest", covariance=True, metric="l2")

    @classmethod
    def best(cls, *, route: Route = "voxel") -> SHDOption:
        """The options that retrieve best: cross-shell invariants of three fields in two frames, 3600 numbers, L1."""
        option = cls(
            bandwidth=12,
            shells=16,
            widths=(np.sqrt(2) / 8, 0.5),
            normal_width=0.5,
            frames=(0.0, 1.0),
            voxels=40,
            bands=4,
            invariant="cross_shell",
            normalisation="l1",
        )
        if check.choice(route, "route", ("voxel", "exact")) == "voxel":
            return option
        return dataclasses.replace(option, route="exact", voxels=64, samples=65536)

    @property
    def rows(self) -> int:
        """Rows of coefficients of one field in one frame: bands, or shells where they are not averaged."""
        return self.shells if self.bands is None else self.bands

    @property
    def feature_shape(self) -> tuple[int, int]:
        """Shape of ``Feature.data``."""
        functions = len(self.frames) * self.shell_fields.count * self.rows
        if self.invariant == "cross_shell":
            return self.bandwidth, functions * (functions + 1) // 2
        return self.bandwidth + self.covariance, functions

    @property
    def shell_fields(self) -> ShellFields:
        """What is sampled on the shells."""
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(ShellFields)}
        if self.distance is None:
            own["distance"] = "nearest" if self.route == "exact" else "soft"
        return ShellFields(**own)

    @functools.cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all options and the version of the recipe: features are comparable where it is the same."""
        text = [f"shd {_RECIPE}"]
        for field in dataclasses.fields(self):
            value = self.shell_fields.distance if field.name == "distance" else getattr(self, field.name)
            if isinstance(value, SphericalGrid):
                value = value.fingerprint
            elif isinstance(value, np.ndarray):
                value = hashlib.sha256(value.tobytes()).hexdigest()
            elif field.type.startswith(("int", "float", "tuple")) and value is not None:
                value = np.asarray(value, dtype=np.float64).tolist()  # 2, 2.0 and NumPy's are the same option
            text.append(f"{field.name}={value!r}")
        return hashlib.sha256("\n".join(text).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SHDOption) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)
