"""Meshes and clouds as arrays, Open3D in and out, and what can be computed of triangles and points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
