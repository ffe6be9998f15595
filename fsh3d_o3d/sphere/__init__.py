"""Grids, weights, harmonics, transforms and coefficients on the sphere; no Open3D here."""

from fsh3d_o3d.sphere.analytic_weights import WeightSolution, analytic_weights
from fsh3d_o3d.sphere.coefficients import (
    degree_energies,
    filter_coefficients,
    heat_filter,
    ideal_filter,
    lanczos_filter,
    truncate,
)
from fsh3d_o3d.sphere.conventions import from_complex, from_packed, to_complex, to_packed
from fsh3d_o3d.sphere.grids import (
    SphericalGrid,
    cube_grid,
    equiangular_grid,
    fibonacci_grid,
    grid_from_directions,
    healpix_grid,
    icosahedral_grid,
)
from fsh3d_o3d.sphere.harmonics import degrees_and_orders, spherical_harmonics
from fsh3d_o3d.sphere.icosahedron import icosphere
from fsh3d_o3d.sphere.least_squares import LeastSquaresFit, fit_coefficients
from fsh3d_o3d.sphere.rotation.aligned_distance import aligned_distance
from fsh3d_o3d.sphere.rotation.canonical import CanonicalPose
from fsh3d_o3d.sphere.rotation.rotation import reflect_coefficients, rotate_coefficients
from fsh3d_o3d.sphere.rotation.rotation_search import RotationEstimate, estimate_rotation, estimate_rotations
from fsh3d_o3d.sphere.rotation.symmetry import SymmetryAxis, SymmetryPlane, SymmetryReport, find_symmetries
from fsh3d_o3d.sphere.transform import SphericalHarmonicTransform, evaluate, evaluate_gradient
from fsh3d_o3d.sphere.weight_cache import clear_weight_cache, weight_cache_directory
from fsh3d_o3d.sphere.weights import area_weights, driscoll_healy_weights, equal_weights

__all__ = [
    # grids
    "SphericalGrid",
    "cube_grid",
    "equiangular_grid",
    "fibonacci_grid",
    "grid_from_directions",
    "healpix_grid",
    "icosahedral_grid",
    "icosphere",
    # weights
    "WeightSolution",
    "analytic_weights",
    "area_weights",
    "clear_weight_cache",
    "driscoll_healy_weights",
    "equal_weights",
    "weight_cache_directory",
    # transform
    "LeastSquaresFit",
    "SphericalHarmonicTransform",
    "evaluate",
    "evaluate_gradient",
    "fit_coefficients",
    # rotation
    "CanonicalPose",
    "RotationEstimate",
    "aligned_distance",
    "SymmetryAxis",
    "SymmetryPlane",
    "SymmetryReport",
    "estimate_rotation",
    "estimate_rotations",
    "find_symmetries",
    "reflect_coefficients",
    "rotate_coefficients",
    # coefficients
    "degree_energies",
    "degrees_and_orders",
    "filter_coefficients",
    "from_complex",
    "from_packed",
    "heat_filter",
    "ideal_filter",
    "lanczos_filter",
    "spherical_harmonics",
    "to_complex",
    "to_packed",
    "truncate",
]
