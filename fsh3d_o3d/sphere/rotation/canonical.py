"""Canonical poses: rotations that bring functions on the sphere to the same pose however they were rotated."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.sphere.coefficients import degree_energies, truncate
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.rotation.rotation_search import estimate_rotation
from fsh3d_o3d.sphere.rotation.symmetry import SymmetryReport, find_symmetries

__all__ = ["CanonicalPose", "canonical_pose"]

_DEGREES = 8  # of the template, a choice: low degrees are sampled most exactly
_PROFILES = 4  # functions of the shell in the template, a choice; with more of them neighbouring shells differ more
_NORM_FLOOR = 0.1  # of the norm, a choice: degrees with less than about this much count for less
_MAXIMA = 12  # of the correlation to compare, a choice; twice as many are followed


@value
class CanonicalPose:
    """The rotation that takes functions to their canonical pose. NumPy takes it for the matrix ``rotation``."""

    rotation: Float64Array
    """(3, 3); if the input is rotated by Q, this becomes ``rotation`` Qᵀ. Read-only."""
    margin: float
    """How much better, relative to the best, it fits the template than the next best rotation; 0 where symmetry makes
    several fit alike. Below about 0.01, sampling may decide between two poses."""
    symmetries: SymmetryReport
    """Symmetries of the functions. Where there are any, ``rotation`` is one of several that lead to the same pose."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.rotation, dtype=dtype) if copy else np.asarray(self.rotation, dtype=dtype)


def canonical_pose(coefficients: object) -> CanonicalPose:
    """Find the rotation to a pose that does not depend on how the functions were rotated: (…, b²) → (3, 3).

    It maximises the correlation with a fixed template without symmetry. The template has as much of each degree as of
    any other, and so have the functions: what is nearly symmetric in its strong degrees is decided by its weak ones.

    Args:
        coefficients: (…, b²) of functions that are rotated together, b >= 2; the pose is comparable among inputs with
            the same number of functions, such as shells. Degrees >= 8 do not take part.

    Raises:
        ValueError: Wrong shape, not finite, or functions that are constant on the sphere: every pose is alike.
    """
    values, b = check.coefficients(coefficients)
    symmetries = find_symmetries(values)
    b = min(b, _DEGREES)
    rows = np.asarray(truncate(values, b), dtype=np.float64).reshape(-1, b * b)
    fit = estimate_rotation(_balanced(rows, b), _template(len(rows), b), maxima=_MAXIMA)
    margin = max(0.0, fit.margin / fit.correlation) if fit.correlation > 0 else 0.0
    return CanonicalPose(fit.rotation, min(margin, 1.0), symmetries)


def _balanced(rows: Float64Array, b: int) -> Float64Array:
    """Rows (S, b²) with degrees brought to equal norms, as far as they have any."""
    scale = np.abs(rows).max(initial=0.0)
    if scale == 0:
        return rows
    rows = rows / scale
    norms = np.linalg.norm(degree_energies(rows), axis=0)
    norms[0] = 0.0
    gain = 1 / np.maximum(norms + _NORM_FLOOR * np.linalg.norm(norms), np.finfo(float).tiny)
    gain[0] = 1.0 if norms.any() else 0.0
    return np.asarray(rows * gain[degrees_and_orders(b)[0]])


@functools.lru_cache(maxsize=8)
def _template(count: int, b: int) -> Float64Array:
    """(count, b²): smooth along the first axis, irregular along the second, of equal norm in each degree."""
    profile = np.cos(np.pi * np.arange(_PROFILES) * (np.arange(count)[:, None] + 0.5) / count)
    index = np.arange(_PROFILES * b * b, dtype=np.float64).reshape(_PROFILES, b * b)
    pattern = np.cos(np.pi * np.sqrt(2) * index**2)  # as good as random, and the same everywhere
    template = profile @ pattern
    norms = np.linalg.norm(degree_energies(template), axis=0)
    template = template / norms[degrees_and_orders(b)[0]]
    template.setflags(write=False)
    return np.asarray(template)
