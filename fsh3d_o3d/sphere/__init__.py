"""Functions on the sphere: grids, quadrature weights, harmonics, the transform and its coefficients.

NumPy, SciPy and ducc0 alone; Open3D is never imported here. ``rotation`` turns coefficients and finds rotations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
