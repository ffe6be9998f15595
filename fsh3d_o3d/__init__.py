"""Point clouds and meshes as spherical harmonics, in Open3D.

>>> import fsh3d_o3d as fsh
>>> transform = fsh.SphericalHarmonicTransform(bandwidth=32)
>>> coefficients = transform.forward(transform.grid.directions[:, 2])
"""

from fsh3d_o3d._version import __version__
from fsh3d_o3d.closing.prepare_closed import Closing, prepare_closed
from fsh3d_o3d.descriptors.shd import SHDOption, compute_shd_feature, descriptor_distances, shd_descriptor
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
from fsh3d_o3d.evaluation.classification import read_classification
from fsh3d_o3d.evaluation.evaluation import evaluate_models
from fsh3d_o3d.evaluation.metrics import RetrievalMetrics, retrieval_metrics
from fsh3d_o3d.files.reading import read_geometry
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.surface_comparison import SurfaceError, surface_error, vertex_distances
from fsh3d_o3d.index.shape_index import Hit, ShapeIndex, ShapeIndexError
from fsh3d_o3d.jobs.descriptor_cache import clear_descriptor_cache
from fsh3d_o3d.registration.register import (
    SphericalRegistrationOption,
    SphericalRegistrationResult,
    registration_spherical,
)
from fsh3d_o3d.shapes.canonical import canonical_rotation
from fsh3d_o3d.shapes.conformal import ConformalShape
from fsh3d_o3d.shapes.cube import ShellVolume
from fsh3d_o3d.shapes.loading import load_shape
from fsh3d_o3d.shapes.radial import RadialShape
from fsh3d_o3d.shapes.shell import ShellShape
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
from fsh3d_o3d.sphere_map.conformal_map import ConformalMapOption, conformal_map
from fsh3d_o3d.sphere_map.spherical_map import SphericalMap

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
