"""Functions on the sphere: grids, quadrature weights, harmonics, the transform and its coefficients.

NumPy, SciPy and ducc0 alone; Open3D is never imported here. ``rotation`` turns coefficients and finds rotations.
"""

from __future__ import annotations

from fsh3d_o3d.sphere.analytic_weights import analytic_weights
from fsh3d_o3d.sphere.coefficients import (
    degree_energies,
    filter_coefficients,
    heat_filter,
    ideal_filter,
    lanczos_filter,
    truncate,
)
from fsh3d_o3d.sphere.conventions import from_complex, from_packed, to_complex, to_packed
from fsh3d_o3d.sphere.engines import EnginePair
from fsh3d_o3d.sphere.grids import (
    SphericalGrid,
    cube_grid,
    equiangular_grid,
    fibonacci_grid,
    grid_from_directions,
    grid_size,
    healpix_grid,
    icosahedral_grid,
)
from fsh3d_o3d.sphere.harmonics import degrees_and_orders, spherical_harmonics
from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere.invariants import energies, gram_powers
from fsh3d_o3d.sphere.least_squares import LeastSquaresFit, fit_coefficients
from fsh3d_o3d.sphere.nufft_engine import NufftEngine
from fsh3d_o3d.sphere.rotation import (
    CanonicalPose,
    RotationEstimate,
    SymmetryAxis,
    SymmetryPlane,
    SymmetryReport,
    aligned_distance,
    canonical_pose,
    estimate_rotation,
    estimate_rotations,
    exponential,
    find_symmetries,
    parity,
    reflect_coefficients,
    rotate_coefficients,
    rotate_each,
)
from fsh3d_o3d.sphere.threads import resolve_threads, run_all, single_threaded_blas
from fsh3d_o3d.sphere.transform import SphericalHarmonicTransform, evaluate, evaluate_gradient
from fsh3d_o3d.sphere.weight_cache import clear_weight_cache, weight_cache_directory
from fsh3d_o3d.sphere.weight_solution import WeightSolution
from fsh3d_o3d.sphere.weights import area_weights, checked_weights, driscoll_healy_weights, equal_weights

__all__ = [
    "CanonicalPose",
    "EnginePair",
    "LeastSquaresFit",
    "NufftEngine",
    "RotationEstimate",
    "SphericalGrid",
    "SphericalHarmonicTransform",
    "SymmetryAxis",
    "SymmetryPlane",
    "SymmetryReport",
    "WeightSolution",
    "aligned_distance",
    "analytic_weights",
    "area_weights",
    "canonical_pose",
    "checked_weights",
    "clear_weight_cache",
    "cube_grid",
    "degree_energies",
    "degrees_and_orders",
    "driscoll_healy_weights",
    "energies",
    "equal_weights",
    "equiangular_grid",
    "estimate_rotation",
    "estimate_rotations",
    "evaluate",
    "evaluate_gradient",
    "exponential",
    "fibonacci_grid",
    "filter_coefficients",
    "find_symmetries",
    "fit_coefficients",
    "from_complex",
    "from_packed",
    "gram_powers",
    "grid_from_directions",
    "grid_size",
    "healpix_grid",
    "heat_filter",
    "icosahedral_grid",
    "icosphere",
    "ideal_filter",
    "lanczos_filter",
    "parity",
    "reflect_coefficients",
    "resolve_threads",
    "rotate_coefficients",
    "rotate_each",
    "run_all",
    "single_threaded_blas",
    "spherical_harmonics",
    "to_complex",
    "to_packed",
    "truncate",
    "weight_cache_directory",
]
