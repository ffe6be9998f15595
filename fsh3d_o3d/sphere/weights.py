"""Closed-form and geometric quadrature weights; every rule sums to 4π. See ``analytic_weights`` for the paper's."""

from __future__ import annotations

import numpy as np
from scipy.spatial import SphericalVoronoi

from fsh3d_o3d import _validation as check
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.sphere.grids import SphericalGrid, require_grid

__all__ = ["area_weights", "driscoll_healy_weights", "equal_weights"]


def equal_weights(grid: SphericalGrid) -> Float64Array:
    """Return the weight 4π/n for every point of a grid, (n,) (Swinbank and Purser 2006).

    Example:
        >>> grid = fsh.healpix_grid(2)
        >>> np.allclose(fsh.equal_weights(grid), 4 * np.pi / 48)
        True
    """
    return np.full(len(require_grid(grid)), 4 * np.pi / len(grid))


def area_weights(grid: SphericalGrid) -> Float64Array:
    """Return the area of every point's Voronoi cell on the unit sphere, (n,) (Ahmad et al. 2007).

    Raises:
        ValueError: Fewer than four points, duplicate points, or points that all lie on one circle.

    Example:
        >>> weights = fsh.area_weights(fsh.cube_grid(8))
        >>> print(f"{weights.sum():.4f}, {weights.max() / weights.min():.2f}")  # 4π; cells near corners are smaller
        12.5664, 1.32
    """
    require_grid(grid)
    try:
        areas = SphericalVoronoi(grid.directions, radius=1.0, threshold=1e-12).calculate_areas()
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"the {len(grid)} directions have no Voronoi cells: {error}") from None
    return np.asarray(areas * (4 * np.pi / areas.sum()), dtype=np.float64)


def driscoll_healy_weights(bandwidth: int) -> Float64Array:
    """Return the weights of the 2b × 2b ``equiangular_grid``, (4b²,), exact for degrees below 2b.

    w_j = (2π/2b)(2/b) sin θ_j Σ_{k<b} sin((2k+1)θ_j)/(2k+1), the same along each row (Driscoll and Healy 1994).

    Raises:
        ValueError: ``bandwidth`` is out of range.

    Example:
        >>> z = fsh.equiangular_grid(8).directions[:, 2]
        >>> np.allclose(fsh.driscoll_healy_weights(8) @ z**2, 4 * np.pi / 3)  # the integral of z² over the sphere
        True
    """
    b = check.bandwidth(bandwidth)
    theta = np.pi * (2 * np.arange(2 * b) + 1) / (4 * b)
    odd = 2 * np.arange(b) + 1
    rows = 2 / b * np.sin(theta) * (np.sin(np.outer(theta, odd)) / odd).sum(axis=1)
    rows = (rows + rows[::-1]) / 2  # north and south alike to the last bit
    return np.repeat(rows * (np.pi / b), 2 * b)


def checked_weights(grid: SphericalGrid | None, weights: object | None) -> Float64Array | None:
    """Return an option's weights as a read-only copy (n,) that fits its grid; None where there are none.

    Raises:
        TypeError: Not a grid.
        ValueError: Weights without a grid, or of another shape.
    """
    if grid is not None:
        require_grid(grid)
    elif weights is not None:
        raise ValueError("weights belong to a grid; give both")
    if grid is None or weights is None:
        return None
    own = np.array(check.values_on(weights, "weights", len(grid)), dtype=np.float64)
    if own.ndim != 1:
        raise ValueError(f"weights must have shape (n,) = ({len(grid)},), got {own.shape}")
    own.setflags(write=False)
    return own
