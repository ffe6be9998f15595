"""Point clouds and meshes as spherical harmonics, in Open3D.

>>> import fsh3d_o3d as fsh
>>> transform = fsh.SphericalHarmonicTransform(bandwidth=32)
>>> coefficients = transform.forward(transform.grid.directions[:, 2])
"""

from fsh3d_o3d._version import __version__
from fsh3d_o3d.adapters.closing import Closing, prepare_closed
from fsh3d_o3d.adapters.conformal import ConformalMapOption, SphericalMap, conformal_map
from fsh3d_o3d.adapters.reading import read_geometry
from fsh3d_o3d.adapters.surface_error import SurfaceError, surface_error, vertex_distances
from fsh3d_o3d.adapters.writing import write_geometry
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
from fsh3d_o3d.registration import (
    SphericalRegistrationOption,
    SphericalRegistrationResult,
    registration_spherical,
)
from fsh3d_o3d.retrieval import (
    Hit,
    RetrievalMetrics,
    ShapeIndex,
    ShapeIndexError,
    clear_descriptor_cache,
    evaluate_models,
    read_classification,
    retrieval_metrics,
)
from fsh3d_o3d.shapes import ConformalShape, RadialShape, ShellShape, ShellVolume, load_shape
from fsh3d_o3d.shapes.canonical import canonical_rotation
from fsh3d_o3d.sphere import *  # noqa: F403 - its __all__ is the list of public names
from fsh3d_o3d.sphere import __all__ as _sphere

__all__ = [
    "__version__",
    *_sphere,
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
