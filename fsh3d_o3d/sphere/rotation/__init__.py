"""Rotations of coefficients, the search for the best one, symmetries and a pose of its own for every shape."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
