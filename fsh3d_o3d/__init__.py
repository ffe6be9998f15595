"""Point clouds and meshes as spherical harmonics, in Open3D.

>>> import fsh3d_o3d as fsh
>>> transform = fsh.SphericalHarmonicTransform(bandwidth=32)
>>> coefficients = transform.forward(transform.grid.directions[:, 2])
"""

from fsh3d_o3d._version import __version__
from fsh3d_o3d.closing import Closing, prepare_closed
from fsh3d_o3d.descriptors import SHDOption, compute_shd_feature, descriptor_distances, shd_descriptor
from fsh3d_o3d.errors import (
    ConvergenceWarning,
    CoverageError,
    GeometryError,
    GeometryReadError,
    GeometryReadWarning,
    MemoryEstimateError,
    NotStarShapedError,
    QuadratureWarning,
)
from fsh3d_o3d.evaluation import RetrievalMetrics, evaluate_models, read_classification, retrieval_metrics
from fsh3d_o3d.files import read_geometry, write_geometry
from fsh3d_o3d.geometry import SurfaceError, surface_error, vertex_distances
from fsh3d_o3d.index import Hit, ShapeIndex, ShapeIndexError
from fsh3d_o3d.jobs import clear_descriptor_cache
from fsh3d_o3d.registration import SphericalRegistrationOption, SphericalRegistrationResult, registration_spherical
from fsh3d_o3d.shapes import ConformalShape, RadialShape, Shape, ShellShape, ShellVolume, canonical_rotation, load_shape
from fsh3d_o3d.sphere import (
    CanonicalPose,
    LeastSquaresFit,
    RotationEstimate,
    SphericalGrid,
    SphericalHarmonicTransform,
    SymmetryAxis,
    SymmetryPlane,
    SymmetryReport,
    WeightSolution,
    aligned_distance,
    analytic_weights,
    area_weights,
    clear_weight_cache,
    cube_grid,
    degree_energies,
    degrees_and_orders,
    driscoll_healy_weights,
    equal_weights,
    equiangular_grid,
    estimate_rotation,
    estimate_rotations,
    evaluate,
    evaluate_gradient,
    fibonacci_grid,
    filter_coefficients,
    find_symmetries,
    fit_coefficients,
    from_complex,
    from_packed,
    grid_from_directions,
    healpix_grid,
    heat_filter,
    icosahedral_grid,
    icosphere,
    ideal_filter,
    lanczos_filter,
    reflect_coefficients,
    rotate_coefficients,
    spherical_harmonics,
    to_complex,
    to_packed,
    truncate,
    weight_cache_directory,
)
from fsh3d_o3d.sphere_map import ConformalMapOption, SphericalMap, conformal_map

__all__ = [
    "__version__",
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
    # shapes
    "ConformalShape",
    "RadialShape",
    "Shape",
    "ShellShape",
    "ShellVolume",
    "canonical_rotation",
    "load_shape",
    # descriptors
    "SHDOption",
    "compute_shd_feature",
    "descriptor_distances",
    "shd_descriptor",
    # registration
    "SphericalRegistrationOption",
    "SphericalRegistrationResult",
    "registration_spherical",
    # retrieval
    "Hit",
    "RetrievalMetrics",
    "ShapeIndex",
    "ShapeIndexError",
    "clear_descriptor_cache",
    "evaluate_models",
    "read_classification",
    "retrieval_metrics",
    # maps to the sphere
    "Closing",
    "ConformalMapOption",
    "SphericalMap",
    "conformal_map",
    "prepare_closed",
    # geometry
    "SurfaceError",
    "read_geometry",
    "surface_error",
    "vertex_distances",
    "write_geometry",
    # errors
    "ConvergenceWarning",
    "CoverageError",
    "GeometryError",
    "GeometryReadError",
    "GeometryReadWarning",
    "MemoryEstimateError",
    "NotStarShapedError",
    "QuadratureWarning",
]
